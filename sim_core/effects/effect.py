"""What an effect is: a nested amendment of the baseline physics.

An effect adds one law to one place (``slot``). At the vanishing value of its amplitude it does nothing,
bit for bit, so every amended model contains the baseline. The simulator runs any set of effects named in
a rig; the diagnosis reads the same registry to ask what is missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sim_core.energies.term import Term
from sim_core.rigs import Rig

if TYPE_CHECKING:
    from sim_core.scene.scene import Scene, Values


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect.

    ``vanishing``: the value at which the effect does nothing (None: a shape parameter that has none).
    ``lower``, ``upper``: physical bounds in ``unit``. ``typical``: starting values worth trying.
    ``log``: fitted as its logarithm. ``prior_sd``: width of the plausible range, in the fitted scale.
    """

    name: str
    unit: str
    lower: float
    upper: float
    typical: tuple[float, ...]
    vanishing: float | None
    log: bool
    prior_sd: float
    words: str


class Effect:
    """Base of all effects; a subclass overrides the one hook that its law needs."""

    name: str = ""
    title: str = ""
    slot: str = ""
    words: str = ""
    parameters: tuple[EffectParameter, ...] = ()

    def applies(self, rig: Rig) -> bool:
        """Whether the rig has what the effect acts on."""
        raise NotImplementedError

    def variants(self, rig: Rig) -> tuple[Mapping[str, tuple[float, ...]], ...]:
        """Sets of starting values to try on this rig, by parameter; empty when it does not apply."""
        return ({p.name: p.typical for p in self.parameters},) if self.applies(rig) else ()

    def equivalents(self, given: Mapping[str, float]) -> tuple[Mapping[str, float], ...]:
        """Other values of the parameters that describe the very same law."""
        return ()

    def amend_values(self, rig: Rig, values: Values, given: Mapping[str, float]) -> None:
        """Change what the terms of the scene are configured with."""

    def terms(self, scene: Scene, given: Mapping[str, float]) -> list[Term]:
        """Terms that the effect adds to the scene."""
        return []

    def added_to_output(
        self, rig: Rig, channel: str, kind: str, times: np.ndarray, given: Mapping[str, float]
    ) -> np.ndarray | float:
        """What a sensor reports beside the truth at times ``(n,)`` [s], ``(n, ...)`` as its readings. ``kind``:
        'wrench', 'markers' or 'tracks'. It does not see the readings, of which derivatives therefore pass a sensor as
        they are (:func:`sysid.model.sensor_streams.predicted_derivatives`, ``predicted_back``); a law with a gain, a
        bound or a memory of them would need its slope there."""
        return 0.0

    def delay(self, rig: Rig, channel: str, kind: str, given: Mapping[str, float]) -> float:
        """Delay [s] that the effect adds to the stamps of a channel."""
        return 0.0
