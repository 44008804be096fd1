"""Which effects are concealed, and how strong they may be.

The amplitudes are random within ranges in which the effect stands out from the noise on this bench
(``MIN_SIGNAL``), by physics and noise alone: see :mod:`sysid.proof.generator.signal`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

MIN_SIGNAL = 12.0
"""Least norm of an effect's whitened trace, projected off the parameters; weaker draws are redrawn."""

Amplitudes = dict[str, float]


def _between(low: float, high: float) -> Callable[[np.random.Generator], float]:
    return lambda rng: float(rng.uniform(low, high))


def _log_between(low: float, high: float) -> Callable[[np.random.Generator], float]:
    return lambda rng: float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _relaxation(rng: np.random.Generator) -> Amplitudes:
    return {"share": _between(0.06, 0.4)(rng), "tau_s": _log_between(0.04, 0.4)(rng)}


def _orthotropy(rng: np.random.Generator) -> Amplitudes:
    ratio = _log_between(1.6, 4.0)(rng)
    return {
        "modulus_ratio": ratio if rng.random() < 0.5 else 1.0 / ratio,
        "grain_angle_rad": _between(-0.75, 0.75)(rng),
    }


def _plasticity(rng: np.random.Generator) -> Amplitudes:
    return {"yield_curvature_per_m": _log_between(5.0, 12.0)(rng), "hardening_ratio": _between(0.1, 0.6)(rng)}


def _drag(rng: np.random.Generator) -> Amplitudes:
    return {"drag_coefficient": _between(0.6, 2.0)(rng)}


def _stiction(rng: np.random.Generator) -> Amplitudes:
    return {"excess": _between(0.15, 0.8)(rng)}


def _compliance(rng: np.random.Generator) -> Amplitudes:
    return {"compliance_m_per_n": _log_between(2e-5, 3e-4)(rng)}


def _offset(rng: np.random.Generator) -> Amplitudes:
    """A bias, a drift, or both, in random directions."""
    kind = rng.integers(3)
    bias = _direction(rng) * _between(0.05, 0.15)(rng) if kind != 1 else np.zeros(3)
    drift = _direction(rng) * _between(0.06, 0.2)(rng) if kind != 0 else np.zeros(3)
    return {
        **{f"bias_{a}_n": float(b) for a, b in zip("xyz", bias, strict=True)},
        **{f"drift_{a}_n_per_s": float(d) for a, d in zip("xyz", drift, strict=True)},
        **{name.format(a): 0.0 for name in ("torque_bias_{}_nm", "torque_drift_{}_nm_per_s") for a in "xyz"},
    }


def _delay(rng: np.random.Generator) -> Amplitudes:
    """Force or vision late (or, the other clock being late, early)."""
    stream, most = [("wrench_s", 0.03), ("vision_s", 0.015)][rng.integers(2)]
    late = _log_between(0.2 * most, most)(rng) * rng.choice([-1.0, 1.0], p=[0.3, 0.7])
    return {"wrench_s": 0.0, "vision_s": 0.0, stream: float(late)}


DRAWS: dict[str, Callable[[np.random.Generator], Amplitudes]] = {
    "gel_relaxation": _relaxation,
    "sheet_orthotropy": _orthotropy,
    "bending_plasticity": _plasticity,
    "air_drag": _drag,
    "static_friction": _stiction,
    "end_effector_compliance": _compliance,
    "wrench_offset": _offset,
    "stream_delay": _delay,
}


def draw_amplitudes(rng: np.random.Generator, effect: str) -> Amplitudes:
    """Random parameters of one effect, in the units of its registry entry."""
    return DRAWS[effect](rng)


def _direction(rng: np.random.Generator) -> np.ndarray:
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))
