"""How far a concealed effect stands out of the noise after projection off what the materials of the rig can absorb.

signal = min_theta || W (y(effect) - y - J theta) ||

with noise-free readings y, their differences J by one percent of each material, and W the inverse standard deviation of
the noise; slow parts of the noise (coloured wrenches, the shake of a whole picture) count with their level at low
frequency, so the figure errs to the low side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.proof.truths.noise import NoiseLevels

Array = np.ndarray

Readings = Sequence[tuple[Array, Array]]
"""Wrenches and pixels of each recording, as :func:`sysid.proof.truths.sensors.noise_free` gives them."""


def signal(effect: Readings, base: Readings, shifted: Sequence[Readings], levels: NoiseLevels) -> float:
    """The figure above; ``shifted``: readings with one material each a percent larger."""
    change = whitened(effect, base, levels)
    columns = np.column_stack([whitened(other, base, levels) for other in shifted])
    left = change - columns @ np.linalg.lstsq(columns, change, rcond=1e-9)[0]
    return float(np.linalg.norm(left))


def whitened(changed: Readings, base: Readings, levels: NoiseLevels) -> Array:
    """Difference of readings in standard deviations of the noise, one column."""
    slow = levels.force_slow**2 * (1.0 + levels.slow_rho) / (1.0 - levels.slow_rho)
    force = np.hypot(levels.force, np.sqrt(slow)) * np.repeat([1.0, levels.arm], 3)
    parts = []
    for (wrench, uv), (wrench_0, uv_0) in zip(changed, base, strict=True):
        parts.append(((wrench - wrench_0) / force).ravel())
        moved = np.nan_to_num(uv - uv_0)
        common = moved.mean(axis=1, keepdims=True)
        shake = levels.shake_px**2 * (1.0 + levels.shake_rho) / (1.0 - levels.shake_rho)
        parts.append(((moved - common) / levels.px).ravel())
        parts.append((common / np.sqrt(levels.px**2 / moved.shape[1] + shake)).ravel())
    return np.concatenate(parts)
