"""What the profile likelihood of a parameter says (:mod:`sysid.uncertainty.profiler` finds it)."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.model.parameters import FitParameter
from sysid.settings.uncertainty import UNCERTAINTY

STOPPED = {
    "failed": "nothing could be simulated beyond {}",
    "unfinished": "the points allowed ended at {}",
    "interrupted": "Ctrl-C ended it at {}",
}
"""Why an end was not found, by the kind of the :class:`End`."""


@dataclass(frozen=True)
class End:
    """One end of an interval, in the fitted scale. ``kind``: 'found'; 'open', the deviance stays below its limit as far
    as ``at``; 'failed', nothing could be simulated beyond ``at``; 'unfinished', the points allowed ended at ``at``;
    'interrupted', by Ctrl-C, at ``at``."""

    at: float
    kind: str


@dataclass(frozen=True)
class Profile:
    """Deviance against one parameter. ``values`` and ``ci95``: in its own unit; ``ends``: what each end of ``ci95`` is
    (:class:`End`); ``sentence``: what the quadratic interval does not say, empty where the two agree."""

    name: str
    unit: str
    log: bool
    value: float
    values: tuple[float, ...]
    deviance: tuple[float, ...]
    ci95: tuple[float, float]
    ends: tuple[str, str]
    quadratic: tuple[float, float]
    sentence: str

    @property
    def limited(self) -> bool:
        """How far the data limit the parameter is known on both sides: an end was found, or the data set none."""
        return set(self.ends) <= {"found", "open"}

    @property
    def undetermined(self) -> bool:
        """The data set no limit on one side at least."""
        return "open" in self.ends

    def text(self) -> str:
        """The interval in words."""
        words = ["" if kind == "found" else f" ({kind})" for kind in self.ends]
        return f"{self.ci95[0]:.5g}{words[0]} .. {self.ci95[1]:.5g}{words[1]}"


def in_words(
    parameter: FitParameter, ci95: tuple[float, float], ends: tuple[str, str], quadratic: tuple[float, float]
) -> str:
    """What the profile of a parameter says and its quadratic interval does not; empty where they agree."""
    name, unit = parameter.name, f" {parameter.unit}".rstrip(" -")
    low, high = (f"{v:.3g}{unit}" for v in ci95)
    if ends == ("open", "open"):
        return f"The data do not determine {name}: anything from {low} to {high} fits as well."
    stopped = [STOPPED[kind].format(v) for v, kind in zip((low, high), ends, strict=True) if kind in STOPPED]
    if "open" in ends:
        side, other, most = ("lower", "an upper", low) if ends[0] == "open" else ("upper", "a lower", high)
        if stopped:
            return (
                f"The data set no {side} limit to {name} as far as {most}; whether they set {other} one is not "
                f"known, since {stopped[0]}."
            )
        if side == "lower":
            return f"{name} is at most {high}; anything below, as far as {low}, fits as well."
        why = " A contact that sticks sets friction no upper limit." if parameter.target.endswith(".friction") else ""
        return f"{name} is at least {low}; anything above, as far as {high}, fits as well.{why}"
    if stopped:
        return f"The interval of {name} may reach further: {', and '.join(stopped)}."
    scaled, parabola = ([parameter.scaled(v) for v in pair] for pair in (ci95, quadratic))
    half = 0.5 * (parabola[1] - parabola[0])
    if (
        max(abs(a - b) for a, b in zip(scaled, parabola, strict=True))
        > (1.0 - UNCERTAINTY.accepted_roots[0] / UNCERTAINTY.deviance_root) * half
    ):
        return (
            f"The misfit is not a parabola in {name}: its 95 % interval is {low} to {high}, where the quadratic one is "
            f"{quadratic[0]:.3g} to {quadratic[1]:.3g}{unit}."
        )
    return ""
