"""What can be fitted: names, physical bounds, and the scale in which each parameter is fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.effects import effect_by_name
from sim_core.errors import ConfigError
from sim_core.rigs import Rig, list_parameters, resolve_name, with_parameters

LINEAR = ("nu", "latency_s", "cx_px", "cy_px", "friction")
"""Quantities fitted as they are; all other positive ones are fitted as their logarithm."""

PRIOR_SD_LOG = 2.0
"""Width of the plausible range of a logarithm: a factor of e^2 either way."""


@dataclass(frozen=True)
class FitParameter:
    """``lower``, ``upper``: bounds in ``unit``; ``prior_sd``: plausible width in the fitted scale."""

    name: str
    unit: str
    log: bool
    lower: float
    upper: float
    prior_sd: float
    words: str

    def scaled(self, value: float) -> float:
        """Value in the fitted scale."""
        return float(np.log(value)) if self.log else float(value)

    def physical(self, scaled: float) -> float:
        """Value in ``unit``, within the bounds."""
        value = float(np.exp(scaled)) if self.log else float(scaled)
        return min(max(value, self.lower), self.upper)

    @property
    def scaled_bounds(self) -> tuple[float, float]:
        if self.log:
            return float(np.log(max(self.lower, 1e-300))), float(np.log(self.upper))
        return self.lower, self.upper


def fit_parameters(rig: Rig, names: Sequence[str]) -> list[FitParameter]:
    """Look the parameters up by the names that a user writes. Raises ``ConfigError``."""
    known = {p.name: p for p in list_parameters(rig)}
    found = []
    for name in names:
        full = resolve_name(rig, name)
        parameter = known[full]
        if parameter.value is None:
            raise ConfigError(
                f"The parameter {full} has no value in the rig {rig.name!r}, so a fit has no start.",
                "Write a value into the rig file.",
            )
        if full.startswith("effects."):
            _, effect, key = full.split(".")
            p = next(p for p in effect_by_name(effect).parameters if p.name == key)
            found.append(FitParameter(full, p.unit, p.log, p.lower, p.upper, p.prior_sd, p.words))
            continue
        quantity = full.rsplit(".", 1)[1]
        lower, upper = _physical(quantity, parameter.lower, parameter.upper)
        log = quantity not in LINEAR and lower > 0.0
        width = PRIOR_SD_LOG if log else {"nu": 0.2, "friction": 0.5}.get(quantity, 1.0)
        found.append(FitParameter(full, parameter.unit, log, lower, upper, width, parameter.description))
    names_found = [p.name for p in found]
    for name in names_found:
        if names_found.count(name) > 1:
            raise ConfigError(f"The parameter {name} is to be fitted twice.", "Name it once.")
    return found


def _physical(quantity: str, lower: float, upper: float) -> tuple[float, float]:
    """Bounds that keep a fit away from singular values."""
    if quantity == "nu":
        return -0.3, 0.495
    if quantity == "friction":
        return 0.0, 3.0
    if not np.isfinite(lower):
        lower = -10.0
    if not np.isfinite(upper):
        upper = 1e15
    return lower, upper


def rig_at(rig: Rig, parameters: Sequence[FitParameter], scaled: np.ndarray) -> Rig:
    """The rig with the parameters at scaled values."""
    values: Mapping[str, float] = {p.name: p.physical(s) for p, s in zip(parameters, scaled, strict=True)}
    return with_parameters(rig, values)


def start_of(rig: Rig, parameters: Sequence[FitParameter]) -> np.ndarray:
    """Scaled values that the rig has now."""
    known = {p.name: p.value for p in list_parameters(rig)}
    out = []
    for p in parameters:
        value = known[p.name]
        assert value is not None
        out.append(p.scaled(min(max(value, p.lower), p.upper)))
    return np.asarray(out)
