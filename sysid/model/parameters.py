"""What can be fitted: names, physical bounds, and the scale in which each parameter is fitted."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_core.effects import effect_by_name
from sim_core.errors import ConfigError
from sim_core.rigs import Rig, list_parameters, resolve_name, with_parameters
from sysid.observations.selection import recording_of
from sysid.settings.model import MODEL


@dataclass(frozen=True)
class Scale:
    """How a quantity is fitted. ``log``: as its logarithm; ``width``: plausible width in the fitted scale;
    ``lower``, ``upper``: bounds in its own unit that keep a fit away from singular values."""

    log: bool
    width: float
    lower: float
    upper: float


SCALES = {
    "E_pa": Scale(True, MODEL.plausible_log_sd, 1.0, 1e13),
    "nu": Scale(False, 0.2, -0.3, 0.495),
    "thickness_m": Scale(True, MODEL.plausible_log_sd, 1e-7, 0.02),
    "density_kg_m3": Scale(True, MODEL.plausible_log_sd, 1.0, 3e4),
    "mass_damping_per_s": Scale(False, 5.0, 0.0, 1e4),
    "stiffness_damping_s": Scale(False, 1e-2, 0.0, 10.0),
    "friction": Scale(False, 0.5, 0.0, 3.0),
    "stiffness_pa_per_m": Scale(True, MODEL.plausible_log_sd, 1.0, 1e15),
    "latency_s": Scale(False, 0.05, -10.0, 10.0),
    **{f"offset_{axis}_m": Scale(False, 5e-3, -0.1, 0.1) for axis in "xyz"},
    **{f"offset_r{axis}_deg": Scale(False, 5.0, -45.0, 45.0) for axis in "xyz"},
    "fx_px": Scale(True, 0.2, 1.0, 1e6),
    "fy_px": Scale(True, 0.2, 1.0, 1e6),
    "cx_px": Scale(False, 50.0, -1e6, 1e6),
    "cy_px": Scale(False, 50.0, -1e6, 1e6),
    "scale_m_per_px": Scale(True, 0.2, 1e-9, 1.0),
    "x_m_s2": Scale(False, 0.5, -100.0, 100.0),
    "y_m_s2": Scale(False, 0.5, -100.0, 100.0),
    "z_m_s2": Scale(False, 0.5, -100.0, 100.0),
    **{f"force_{axis}_n": Scale(False, 0.1, -1e6, 1e6) for axis in "xyz"},
    **{f"traction_{axis}_pa": Scale(False, 1e3, -1e10, 1e10) for axis in "xyz"},
    "pressure_pa": Scale(False, 1e3, -1e10, 1e10),
    "mass_kg": Scale(False, 0.01, 0.0, 1e5),
}
"""The quantities of a rig that can be fitted, in addition to the parameters of effects, which say it themselves."""


@dataclass(frozen=True)
class FitParameter:
    """``lower``, ``upper``: bounds in ``unit``; ``prior_sd``: plausible width in the fitted scale. ``nuisance``: not
    asked for, and pulled to the rig's value with ``prior_sd``; ``tied``: parameters of the rig that change in
    proportion; ``bag``: the recording or window that has it for itself, which the name then ends with in brackets;
    ``known_sd``: standard deviation of what is known of it beforehand, the rig's value, in the fitted scale."""

    name: str
    unit: str
    log: bool
    lower: float
    upper: float
    prior_sd: float
    words: str
    nuisance: bool = False
    tied: tuple[str, ...] = ()
    bag: str = ""
    known_sd: float | None = None

    @property
    def pulled(self) -> bool:
        """Something is known of it beforehand."""
        return self.nuisance or self.known_sd is not None

    @property
    def target(self) -> str:
        """Name of the parameter of the rig."""
        return self.name.removesuffix(f"[{self.bag}]") if self.bag else self.name

    def scaled(self, value: float) -> float:
        """Value in the fitted scale."""
        return float(np.log(value)) if self.log else float(value)

    def physical(self, scaled: float) -> float:
        """Value in ``unit``, within the bounds."""
        value = float(np.exp(np.clip(scaled, *self.scaled_bounds))) if self.log else float(scaled)
        return min(max(value, self.lower), self.upper)

    @property
    def scaled_bounds(self) -> tuple[float, float]:
        """Bounds in the fitted scale."""
        if self.log:
            return float(np.log(max(self.lower, 1e-300))), float(np.log(self.upper))
        return self.lower, self.upper

    @property
    def unit_step(self) -> float:
        """What a search counts steps by, in the fitted scale: the plausible width, at most a factor of e."""
        return min(self.prior_sd, 1.0) if self.log else self.prior_sd

    def width(self, scaled: float) -> float:
        """What a standard deviation at a value is judged by: the plausible width, or half the value if that is more."""
        return self.prior_sd if self.log else max(self.prior_sd, 0.5 * abs(scaled))

    def at_bound(self, scaled: float, sd: float) -> bool:
        """Whether a fitted value stands at a bound, as far as its standard deviation and range tell."""
        low, high = self.scaled_bounds
        return min(scaled - low, high - scaled) <= MODEL.at_bound_share * min(high - low, sd)


def fit_parameters(rig: Rig, names: Sequence[str]) -> list[FitParameter]:
    """Look the parameters up by the names that a user writes, with what the rig says of how well they are known. Raises
    ``ConfigError``."""
    known = {p.name: p for p in list_parameters(rig)}
    beliefs = {resolve_name(rig, name): belief for name, belief in rig.known.items()}
    found = []
    for name in names:
        full = resolve_name(rig, name)
        parameter = known[full]
        if parameter.value is None:
            raise ConfigError(
                f"The parameter {full} has no value in the rig {rig.name!r}, so a fit has no start.",
                "Write a value into the rig file.",
            )
        quantity = full.rsplit(".", 1)[1]
        if full.startswith("effects."):
            p = next(p for p in effect_by_name(full.split(".")[1]).parameters if p.name == quantity)
            fitted = FitParameter(full, p.unit, p.log, p.lower, p.upper, p.prior_sd, p.words)
        else:
            scale = SCALES[quantity]
            lower, upper = max(scale.lower, parameter.lower), min(scale.upper, parameter.upper)
            fitted = FitParameter(full, parameter.unit, scale.log, lower, upper, scale.width, parameter.description)
        if full in beliefs:
            sd = beliefs[full].of(parameter.value)
            fitted = replace(fitted, known_sd=sd / parameter.value if fitted.log else sd)
        found.append(_within(fitted, rig, parameter.value))
    names_found = [p.name for p in found]
    for name in names_found:
        if names_found.count(name) > 1:
            raise ConfigError(f"The parameter {name} is to be fitted twice.", "Name it once.")
    return found


def asked_for(
    rig: Rig,
    names: Sequence[str],
    *,
    priors: Mapping[str, tuple[float, float]],
    bounds: Mapping[str, tuple[float, float]],
    per_bag: Collection[str],
    bags: Sequence[str],
) -> tuple[list[FitParameter], Rig]:
    """What a fit of ``names`` determines with all that is said of them, and the rig where it starts. Raises
    ``ConfigError``."""
    known, start = known_before(fit_parameters(rig, names), rig, priors)
    return with_bags(within_bounds(known, start, bounds), per_bag, bags, start), start


def _by_full_name(rig: Rig, given: Mapping[str, tuple[float, float]], twice: str) -> dict[str, tuple[float, float]]:
    """Pairs by the full names of parameters. Raises ``ConfigError``, which begins with ``twice``, for one that is there
    by two names."""
    found: dict[str, tuple[float, float]] = {}
    for name, pair in given.items():
        full = resolve_name(rig, name)
        if full in found:
            raise ConfigError(f"{twice} {full}.", "Keep one of the two.")
        found[full] = pair
    return found


def within_bounds(
    parameters: Sequence[FitParameter], rig: Rig, bounds: Mapping[str, tuple[float, float]]
) -> list[FitParameter]:
    """The parameters with narrower bounds, in their own units, where ``bounds`` names them. Raises ``ConfigError``."""
    asked = _by_full_name(rig, bounds, "There are two pairs of bounds of")
    values = {p.name: p.value for p in list_parameters(rig)}
    found = []
    for p in parameters:
        given = asked.pop(p.name, (p.lower, p.upper))
        low, high = max(given[0], p.lower), min(given[1], p.upper)
        if not low < high:
            raise ConfigError(
                f"The bounds of {p.name} leave nothing between {low:g} and {high:g}: given were {given[0]:g} .. "
                f"{given[1]:g}, and its own limits are {_limits(p)}.",
                f"Give a lower bound below the upper one, both within {p.lower:g} and {p.upper:g}.",
            )
        value = values[p.name]
        assert value is not None
        whose = "of a fit" if (low, high) == (p.lower, p.upper) else "that was given"
        found.append(_within(replace(p, lower=low, upper=high), rig, value, whose))
    if asked:
        raise ConfigError(f"There are bounds of {', '.join(asked)}, which is not fitted.", "Leave them out.")
    return found


def bounds_cut(rig: Rig, names: Sequence[str], bounds: Mapping[str, tuple[float, float]]) -> list[str]:
    """A sentence for each bound of the parameters ``names`` that is beyond their own limits, which hold instead. An
    infinite one asks for no other bound. Raises ``ConfigError``."""
    asked = _by_full_name(rig, bounds, "There are two pairs of bounds of")
    said = []
    for p in fit_parameters(rig, names):
        low, high = asked.get(p.name, (-np.inf, np.inf))
        used = replace(p, lower=max(low, p.lower), upper=min(high, p.upper))
        if not used.lower < used.upper:
            continue  # nothing is left, which is an error of its own
        beyond = [("lower", low, p.lower)] if -np.inf < low < p.lower else []
        beyond += [("upper", high, p.upper)] if p.upper < high < np.inf else []
        said += [
            f"The {side} bound of {p.name}, {bound:g}, is beyond its own limit, {limit:g}: it is fitted within "
            f"{_limits(used)}. Give a bound within its limits to be rid of this."
            for side, bound, limit in beyond
        ]
    return said


def _limits(parameter: FitParameter) -> str:
    """Its bounds, in words."""
    return f"{parameter.lower:g} .. {parameter.upper:g} {parameter.unit}".rstrip()


def known_before(
    parameters: Sequence[FitParameter], rig: Rig, priors: Mapping[str, tuple[float, float]]
) -> tuple[list[FitParameter], Rig]:
    """The parameters with what is known of them beforehand, value and standard deviation in their own units, and the
    rig at these values. Raises ``ConfigError``."""
    known = _by_full_name(rig, priors, "Two different things are said to be known of")
    unasked = sorted(known.keys() - {p.name for p in parameters})
    if unasked:
        raise ConfigError(
            f"Something is said to be known of {unasked[0]}, which is not fitted.",
            "Name it among the parameters as well, or write its value into the rig.",
        )
    try:
        at = with_parameters(rig, {name: value for name, (value, _) in known.items()})
    except ConfigError as error:
        said = " and ".join(f"{name} = {value:g}" for name, (value, _) in known.items())
        raise ConfigError(f"What is known beforehand, {said}, cannot be: {error.problem}", error.remedy) from error
    found = []
    for p in parameters:
        if p.name in known:
            value, sd = known[p.name]
            p = replace(_within(p, at, value), known_sd=sd / value if p.log else sd)
        found.append(p)
    return found, at


def _within(parameter: FitParameter, rig: Rig, value: float, whose: str = "of a fit") -> FitParameter:
    """The parameter, if a fit can start at ``value``. Raises ``ConfigError``, which says ``whose`` the bound is."""
    low, high = parameter.lower, parameter.upper
    if low <= value <= high:
        return parameter
    unit = f" {parameter.unit}" if parameter.unit else ""
    side, bound = ("below", low) if value < low else ("above", high)
    raise ConfigError(
        f"{parameter.name} is {value:g}{unit} in the rig {rig.name!r}, {side} {bound:g}{unit}, the bound {whose}.",
        f"Write a value between {low:g} and {high:g}{unit} into the rig, or "
        + ("give wider bounds." if whose == "that was given" else "leave the parameter out of the fit."),
    )


def with_bags(
    parameters: Sequence[FitParameter], names: Collection[str], bags: Sequence[str], rig: Rig
) -> list[FitParameter]:
    """The parameters with those of ``names`` once for each of the ``bags``. Raises ``ConfigError``."""
    wanted = {resolve_name(rig, name) for name in names}
    unknown = sorted(wanted - {p.name for p in parameters})
    if unknown:
        raise ConfigError(
            f"{unknown[0]} is to have a value for each bag, but is not fitted.", "Name it among the parameters as well."
        )
    if wanted and len(bags) < 2:
        raise ConfigError(
            f"{min(wanted)} is to have a value for each bag, but there is only one.",
            "Give several recordings, or one value for all.",
        )
    return [
        q
        for p in parameters
        for q in ([replace(p, name=f"{p.name}[{bag}]", bag=bag) for bag in bags] if p.name in wanted else [p])
    ]


def acting_in(parameters: Sequence[FitParameter], bag: str) -> list[int]:
    """Numbers of the parameters that a recording, or a window of one, depends on."""
    return [k for k, p in enumerate(parameters) if p.bag in ("", bag, recording_of(bag))]


def rig_in(rig: Rig, parameters: Sequence[FitParameter], scaled: np.ndarray, bag: str) -> Rig:
    """The rig with the parameters at scaled values, as in one recording."""
    own = acting_in(parameters, bag)
    return rig_at(rig, [parameters[k] for k in own], scaled[own])


def rig_at(rig: Rig, parameters: Sequence[FitParameter], scaled: np.ndarray) -> Rig:
    """The rig with the parameters at scaled values; those that each recording has for itself at their mean."""
    shared: dict[str, list[float]] = {}
    for p, s in zip(parameters, scaled, strict=True):
        shared.setdefault(p.target, []).append(s)
    values = {p.target: p.physical(float(np.mean(shared[p.target]))) for p in parameters}
    if any(p.tied for p in parameters):
        now = {p.name: p.value for p in list_parameters(rig) if p.value is not None}
        values |= {t: now[t] * values[p.name] / now[p.name] for p in parameters for t in p.tied}
    return with_parameters(rig, values)


def start_of(rig: Rig, parameters: Sequence[FitParameter]) -> np.ndarray:
    """Scaled values that the rig has now."""
    known = {p.name: p.value for p in list_parameters(rig)}
    out = []
    for p in parameters:
        value = known[p.target]
        assert value is not None
        out.append(_within(p, rig, value).scaled(value))
    return np.asarray(out)
