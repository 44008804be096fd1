"""Noise of recordings as they are: coloured, common to all markers, with outliers, losses, jitter and noisy poses."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

Array = np.ndarray


@dataclass(frozen=True)
class NoiseLevels:
    """Standard deviations and rates.

    ``force``, ``force_slow`` [N]: white noise, and first-order coloured noise with the correlation ``slow_rho`` between
    samples; torques have ``arm`` [m] times as much. ``px``: white noise of each marker; ``shake_px``, ``turn_rad``,
    ``scale``: shift, turn and scale of a whole picture about its middle, with the correlation ``shake_rho`` between
    frames. ``outlier``: share of readings that lie off by ``outlier_px`` (Student's t, 3 degrees of freedom);
    ``lost``: share of markers missing in a frame; ``dropped``: share of frames and 0.2 times as many wrenches missing.
    ``jitter_s``: of stamps. ``pose_m``, ``pose_rad``: of measured poses.
    """

    force: float
    arm: float
    force_slow: float = 0.0
    slow_rho: float = 0.95
    px: float = 0.08
    shake_px: float = 0.0
    turn_rad: float = 0.0
    scale: float = 0.0
    shake_rho: float = 0.8
    outlier: float = 0.0
    outlier_px: float = 6.0
    lost: float = 0.0
    dropped: float = 0.0
    jitter_s: float = 0.0
    pose_m: float = 1e-6
    pose_rad: float = 1e-6

    def as_dict(self) -> dict[str, Any]:
        """For the sealed truth."""
        return asdict(self)


def white(force: float, arm: float, px: float) -> NoiseLevels:
    """Independent normal noise only."""
    return NoiseLevels(force, arm, px=px)


def nasty(force: float, arm: float, px: float, pose_m: float = 1e-5) -> NoiseLevels:
    """What recordings have by default."""
    return replace(
        white(force, arm, px), force_slow=1.5 * force, shake_px=1.8 * px, turn_rad=1e-4, scale=1e-4, outlier=0.02,
        lost=0.02, dropped=0.05, jitter_s=0.0015, pose_m=pose_m, pose_rad=5.0 * pose_m,
    )  # fmt: skip


def coloured(rng: np.random.Generator, n: int, columns: int, rho: float) -> Array:
    """Unit first-order autoregressive noise, shape ``(n, columns)``."""
    drive = rng.standard_normal((n, columns))
    drive[1:] *= np.sqrt(1.0 - rho * rho)
    return np.asarray(lfilter([1.0], [1.0, -rho], drive, axis=0))


def stamps(rng: np.random.Generator, levels: NoiseLevels, rate_hz: float, end: float, *, drops: float = 0.0) -> Array:
    """Times of samples [s]: from a random phase on, with jitter of the instants, some missing."""
    t = np.arange(rng.uniform(0.0, 1.0 / rate_hz), end, 1.0 / rate_hz)
    jitter = np.clip(levels.jitter_s * rng.standard_normal(len(t)), -0.3 / rate_hz, 0.3 / rate_hz)
    kept = rng.random(len(t)) >= drops
    kept[:3] = kept[-3:] = True
    return np.maximum((t + jitter)[kept], 0.0)


def wrench_noise(rng: np.random.Generator, levels: NoiseLevels, n: int) -> Array:
    """Force [N] and torque [N m], shape ``(n, 6)``."""
    unit = levels.force * rng.standard_normal((n, 6)) + levels.force_slow * coloured(rng, n, 6, levels.slow_rho)
    return np.asarray(unit * np.repeat([1.0, levels.arm], 3))


def spoil_tracks(rng: np.random.Generator, levels: NoiseLevels, uv: Array, centre: Array) -> Array:
    """Tracks ``(n, m, 2)`` [px] with noise; markers that are lost are NaN."""
    n, m, _ = uv.shape
    common = coloured(rng, n, 4, levels.shake_rho) * [
        levels.shake_px, levels.shake_px, levels.turn_rad, levels.scale,
    ]  # fmt: skip
    arm = uv - centre
    turned = np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    out = uv + common[:, None, :2] + common[:, None, 2:3] * turned + common[:, None, 3:] * arm
    out += levels.px * rng.standard_normal(uv.shape)
    wrong = rng.random((n, m)) < levels.outlier
    out[wrong] += levels.outlier_px * rng.standard_t(3, (int(wrong.sum()), 2))
    out[rng.random((n, m)) < levels.lost] = np.nan
    return np.asarray(out)
