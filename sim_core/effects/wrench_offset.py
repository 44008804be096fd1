"""Bias and drift of a wrench sensor: it reads a force that is not there, and that may grow."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.effects.effect import Effect, EffectParameter
from sim_core.rigs import Rig, WrenchSensor


class WrenchOffset(Effect):
    """Reading = truth + bias + drift * time since the start, on the three forces of every sensor."""

    name = "wrench_offset"
    title = "the force sensor has an offset"
    slot = "wrench sensor"
    words = (
        "The force readings carry an offset that has nothing to do with contact: a constant bias, a "
        "drift proportional to time, or both."
    )
    parameters = (
        *(
            EffectParameter(f"bias_{a}_n", "N", -100.0, 100.0, (0.0,), 0.0, False, 0.5, f"constant offset along {a}")
            for a in "xyz"
        ),
        *(
            EffectParameter(f"drift_{a}_n_per_s", "N/s", -10.0, 10.0, (0.0,), 0.0, False, 0.1, f"drift along {a}")
            for a in "xyz"
        ),
    )

    def applies(self, rig: Rig) -> bool:
        return any(isinstance(s, WrenchSensor) for s in rig.sensors.values())

    def added_to_output(
        self, rig: Rig, channel: str, kind: str, times: np.ndarray, given: Mapping[str, float]
    ) -> np.ndarray | float:
        if kind != "wrench":
            return 0.0
        added = np.zeros((len(times), 6))
        bias = np.array([given[f"bias_{a}_n"] for a in "xyz"])
        drift = np.array([given[f"drift_{a}_n_per_s"] for a in "xyz"])
        added[:, :3] = bias + drift * times[:, None]
        return added
