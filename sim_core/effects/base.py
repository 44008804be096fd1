"""What an effect is: a piece of physics that a baseline model leaves out, written in one file.

An effect says everything that a hypothesis is: the words, the parameters with units, bounds and priors, what it can act
on in a rig (its scope), where it belongs (slot and the factor that it follows), and its law, through one of the
interfaces of :mod:`sim_core.effects.hooks`. At the vanishing value of its amplitude it does nothing, bit for bit, so
every amended model contains the baseline. The simulator runs any set of effects that a rig names; identification and
diagnosis read the same registry (:mod:`sim_core.effects.registry`).

A rig names effects by keys ``effect``, ``effect@target`` and ``effect@target#label``: on everything that the effect can
act on, on one target, and as one of several instances (two relaxation branches of one gel).

    effects:
      static_friction: {excess: 0.2}
      viscoelastic_gel@pad#fast: {share: 0.1, tau_s: 0.05}
      viscoelastic_gel@pad#slow: {share: 0.2, tau_s: 2.0}

This module imports nothing of rigs or scenes.
"""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

if TYPE_CHECKING:
    from sim_core.effects.scopes import Scope
    from sim_core.rigs import Rig

Values = Mapping[str, float]
"""Parameters of one instance of an effect by name, in their units."""

Factor = Literal["sensor", "object", "robot", "session", "environment"]
"""What an effect stays with when recordings are compared: it follows the sensor, the object, the robot, or it changes
from one session to the next; the environment is common to all."""


@dataclass(frozen=True)
class RecordingScales:
    """Scales of a set of recordings, by which priors and starting values are made to fit.

    ``duration_s``: length of the longest recording; ``sampling_s``: median interval of the slowest channel;
    ``force_n``, ``torque_nm``: largest measured magnitudes; ``speed_m_s``: largest speed of an end effector.
    """

    duration_s: float
    sampling_s: float
    force_n: float
    torque_nm: float
    speed_m_s: float


Scale = Literal["duration_s", "sampling_s", "force_n", "torque_nm", "speed_m_s"]


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect.

    ``vanishing``: the value at which the effect does nothing (None: a shape parameter that has none). ``lower``,
    ``upper``: physical bounds in ``unit``. ``typical``: starting values worth trying. ``log``: fitted as its natural
    logarithm. ``prior_sd``: standard deviation of the prior, in the fitted scale. Where recordings are at hand whose
    ``scale`` is known, ``scaled_typical`` and ``scaled_sd`` times that scale (per duration for rates) take the place of
    ``typical`` and ``prior_sd``.
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
    scale: Scale | None = None
    scaled_typical: tuple[float, ...] = ()
    scaled_sd: float | None = None
    per_duration: bool = False

    def __post_init__(self) -> None:
        if not self.lower <= self.upper:
            raise ValueError(f"The bounds of the parameter {self.name} are {self.lower:g} and {self.upper:g}.")
        if self.prior_sd <= 0.0:
            raise ValueError(f"The prior of the parameter {self.name} has the standard deviation {self.prior_sd:g}.")

    def fitted_to(self, scales: RecordingScales | None) -> EffectParameter:
        """The same with starting values and prior for recordings of these scales (None: as written)."""
        if scales is None or self.scale is None:
            return self
        factor = getattr(scales, self.scale) / (scales.duration_s if self.per_duration else 1.0)
        if not 0.0 < factor < float("inf"):
            return self
        scaled = tuple(min(max(factor * t, self.lower), self.upper) for t in self.scaled_typical)
        width = self.prior_sd if self.scaled_sd is None else factor * self.scaled_sd
        return replace(self, typical=scaled or self.typical, prior_sd=width)


NuisanceKind = Literal["time", "bias", "camera", "pose"]
"""Groups of nuisance parameters, as users switch them on and off: clocks, offsets of wrench sensors, cameras, tools."""


@dataclass(frozen=True)
class Nuisance:
    """An effect within its prior, which every fit estimates jointly with the parameters it is asked for.

    ``owner``: name of the channel, camera or end effector; ``parameter``: full name of the number of the rig that
    stands for it (None: a constant for each component, which fits eliminate); ``sd``: standard deviation of its prior,
    in the fitted scale, 0 where it is known exactly (None: by the size of what was measured); ``same_as``: the effect's
    own parameters that describe the same thing, in whose presence it is left out; ``tied``: further numbers of the rig
    that change in proportion; ``per_recording``: each recording has a value of its own.
    """

    kind: NuisanceKind
    owner: str
    parameter: str | None
    sd: float | None
    same_as: tuple[str, ...]
    tied: tuple[str, ...] = ()
    per_recording: bool = False


class Effect(ABC):
    """Base of all effects. A subclass is one law: it fills the words in, says on what it acts, and implements one of
    the interfaces of :mod:`sim_core.effects.hooks`, whose values and derivatives are abstract: a class that lacks one
    cannot be made."""

    name: ClassVar[str] = ""
    title: ClassVar[str] = ""
    """Short clause with a subject, for headlines."""
    words: ClassVar[str] = ""
    """What it is, in one or two sentences."""
    signature: ClassVar[str] = ""
    """What recordings look like where a model leaves it out, in one sentence."""
    source: ClassVar[str] = ""
    """Where the law is from: paper and equation."""
    slot: ClassVar[str] = ""
    """Which equation or sensor it amends."""
    follows: ClassVar[Factor] = "object"
    passive: ClassVar[bool] = False
    """Whether it can only store or take up energy, never give any that was not put in."""
    scope: ClassVar[Scope]
    """What it can act on, and what a rig must have for it."""
    share_of_one: ClassVar[str] = ""
    """The parameter of which all instances on one target together have less than 1, if there is one."""
    lasting: ClassVar[tuple[str, ...]] = ()
    """Internal variables that a body keeps as they are while it is left alone, from one recording to the next."""
    twins: ClassVar[tuple[str, ...]] = ()
    """Names of effects that it is easily mistaken for."""
    separated_by: ClassVar[str] = ""
    """The experiment that tells it from its twins, in one sentence."""
    parameters: ClassVar[tuple[EffectParameter, ...]] = ()
    example: ClassVar[Values] = {}
    """Values of all parameters at which it shows in a quick press of a card, for tests and demonstrations."""

    def targets(self, rig: Rig) -> tuple[str, ...]:
        """Names of all that the effect can act on in a rig, in the rig's order; none: it does not apply."""
        return self.scope.names(rig)

    def applies(self, rig: Rig) -> bool:
        """Whether the rig has what the effect acts on."""
        return bool(self.targets(rig))

    def variants(self, rig: Rig, scales: RecordingScales | None = None) -> tuple[Mapping[str, tuple[float, ...]], ...]:
        """Sets of starting values to try on a rig, by parameter; empty where the effect does not apply. ``scales``: of
        the recordings, if there are any."""
        if not self.applies(rig):
            return ()
        return ({p.name: p.fitted_to(scales).typical for p in self.parameters},)

    def nuisances(self, rig: Rig) -> tuple[Nuisance, ...]:
        """In what form every fit allows for the effect within its prior; none: it is a hypothesis alone."""
        del rig
        return ()

    def equivalents(self, values: Values) -> tuple[Values, ...]:
        """Other values of the parameters that describe the very same law."""
        del values
        return ()

    def vanishes(self, values: Values) -> bool:
        """Whether the effect does nothing at these values: every amplitude is at its vanishing value."""
        amplitudes = [p for p in self.parameters if p.vanishing is not None]
        return bool(amplitudes) and all(values[p.name] == p.vanishing for p in amplitudes)


@dataclass(frozen=True)
class Instance:
    """One effect as a rig names it. ``key``: in the rig; ``targets``: what it acts on; ``values``: its parameters."""

    key: str
    effect: Any
    targets: tuple[str, ...]
    values: Values

    @property
    def label(self) -> str:
        """The key as a part of a name of a term, which may have no dots."""
        return self.key.replace(".", "_")


def split_key(key: str) -> tuple[str, str | None, str | None]:
    """Name, target and label of a key ``name@target#label``; None where the key has none."""
    rest, _, label = key.partition("#")
    name, _, target = rest.partition("@")
    return name, target or None, label or None


def joined_key(name: str, target: str | None = None, label: str | None = None) -> str:
    """The inverse of :func:`split_key`."""
    return name + (f"@{target}" if target else "") + (f"#{label}" if label else "")
