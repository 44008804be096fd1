"""Draws of the parameters that a fit leaves open, from its ``fit.json``.

The estimates are taken as jointly normal, in the scale in which they were fitted (logarithmic or not), with the
standard deviations and correlations that the fit gives; draws are kept within the bounds of the rig. Estimates without
a standard deviation stay at their values.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from sim_core.errors import ConfigError
from sim_core.optimise.evaluators import Parameters
from sim_core.rigs import Rig, list_parameters, resolve_name

EPSILON = 1e-9
"""Share by which draws stay within open bounds."""


def posterior_draws(path: Path, rig: Rig, count: int, seed: int) -> list[Parameters]:
    """So many sets of parameters of the rig. Raises ``ConfigError`` for what is no fit, and where a parameter of it is
    none of the rig's."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        estimates, correlation = data["estimates"], np.asarray(data["correlation"], dtype=float)
        names = [str(e["name"]) for e in estimates]
        values = np.array([float(e["value"]) for e in estimates])
        sds = np.array([_deviation(e) for e in estimates])
        logs = np.array([bool(e.get("log", False)) for e in estimates]) & (values > 0.0)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{path} is no result of a fit: {error}.", "Give the fit.json of a folder that 'thinshell fit' wrote."
        ) from None
    if correlation.shape != (len(names), len(names)):
        correlation = np.eye(len(names))
    known = {p.name: p for p in list_parameters(rig)}
    full = [resolve_name(rig, name) for name in names]
    covariance = np.where(np.isfinite(correlation), correlation, 0.0) * np.outer(sds, sds)
    np.fill_diagonal(covariance, sds**2)
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    rng = np.random.default_rng(seed)
    draws: list[Parameters] = []
    for _ in range(count):
        step = root @ rng.standard_normal(len(names))
        drawn = np.where(logs, values * np.exp(np.where(logs, step, 0.0)), values + step)
        low = [known[n].lower for n in full]
        high = [known[n].upper for n in full]
        draws.append({n: _within(float(v), a, b) for n, v, a, b in zip(full, drawn, low, high, strict=True)})
    return draws


def _deviation(estimate: dict[str, object]) -> float:
    sd = estimate.get("sd")
    return float(sd) if isinstance(sd, int | float) and math.isfinite(sd) else 0.0


def _within(value: float, low: float, high: float) -> float:
    """A value strictly within bounds, of which each may be infinite."""
    if math.isfinite(low):
        value = max(value, low + EPSILON * max(abs(low), 1e-6))
    if math.isfinite(high):
        value = min(value, high - EPSILON * max(abs(high), 1e-6))
    return value
