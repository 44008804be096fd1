"""Sensors and clocks between a simulated truth and a bag: faults that may be concealed, noise, and the bag itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter

from sysid.proof.truths.camera import Pinhole
from sysid.proof.truths.noise import NoiseLevels, spoil_tracks, stamps, wrench_noise
from sysid.recording import RecordingWriter

Array = np.ndarray

START_NS = 1_700_000_000_000_000_000
"""Stamp of the beginning of a recording."""

POSE_RATE_HZ = WRENCH_RATE_HZ = 100.0
CAMERA_RATE_HZ = 30.0
WINDOW_S = 0.01
"""A wrench is the mean over this time around its stamp."""

Poses = Callable[[Array], tuple[Array, Array]]
"""Positions [m] ``(k, 3)`` and quaternions x y z w ``(k, 4)`` at times [s]."""


@dataclass(frozen=True)
class WrenchFaults:
    """``matrix``: gain and cross-talk, readings = matrix @ wrench; ``bias``, ``drift``: N and N m (per second of a
    recording); ``filter_s``: time constant of a first-order low pass."""

    matrix: Array = field(default_factory=lambda: np.eye(6))
    bias: Array = field(default_factory=lambda: np.zeros(6))
    drift: Array = field(default_factory=lambda: np.zeros(6))
    filter_s: float = 0.0

    def read(self, t: Array, wrench: Array) -> Array:
        """Readings at evenly spaced times [s], shape ``(k, 6)``."""
        out = wrench @ self.matrix.T
        if self.filter_s:
            keep = float(np.exp(-(t[1] - t[0]) / self.filter_s))
            out = lfilter([1.0 - keep], [1.0, -keep], out, axis=0, zi=keep * out[:1])[0]
        return np.asarray(out + self.bias + self.drift * t[:, None])


@dataclass(frozen=True)
class ClockFaults:
    """Stamps of a stream are ``late`` by so much [s] and gain ``drift`` seconds a second."""

    wrench_s: float = 0.0
    vision_s: float = 0.0
    vision_drift: float = 0.0


@dataclass(frozen=True)
class Clean:
    """What happened in one recording, without noise: evenly spaced times [s] ``(k,)``, wrench on the sensor in its
    frame [N, N m] ``(k, 6)``, markers in the base frame [m] ``(k, m, 3)``; commanded and measured poses."""

    t: Array
    wrench: Array
    markers: Array
    commanded: Poses
    measured: Poses


@dataclass(frozen=True)
class Streams:
    """Names in the bag: topics, frames, numbers of the markers."""

    topics: Mapping[str, str]
    base_frame: str
    wrench_frame: str
    camera_frame: str
    ids: Array


def write_bag(
    out: Path,
    clean: Clean,
    streams: Streams,
    camera: Pinhole,
    nominal: Pinhole,
    levels: NoiseLevels,
    rng: np.random.Generator,
    *,
    wrench: WrenchFaults | None = None,
    clocks: ClockFaults | None = None,
) -> None:
    """Write one recording by the bag contract. ``camera`` is the true one, ``nominal`` what its calibration says."""
    wrench, clocks = wrench or WrenchFaults(), clocks or ClockFaults()
    end = float(clean.t[-1])
    names = streams.topics
    with RecordingWriter(out) as bag:
        for topic, poses, noisy in (("target_pose", clean.commanded, 0.0), ("current_pose", clean.measured, 1.0)):
            t = stamps(rng, levels, POSE_RATE_HZ, end)
            positions, quaternions = poses(t)
            positions = positions + noisy * levels.pose_m * rng.standard_normal(positions.shape)
            turned = _turn(quaternions, noisy * levels.pose_rad * rng.standard_normal(positions.shape))
            for at, p, q in zip(t, positions, turned, strict=True):
                bag.pose(names[topic], _ns(at), p, q, streams.base_frame)
        t = stamps(rng, levels, WRENCH_RATE_HZ, end, drops=0.2 * levels.dropped)
        values = _mean(clean.t, wrench.read(clean.t, clean.wrench), t) + wrench_noise(rng, levels, len(t))
        for at, row in zip(t + clocks.wrench_s, values, strict=True):
            bag.wrench(names["wrench"], _ns(max(at, 0.0)), row[:3], row[3:], streams.wrench_frame)
        t = stamps(rng, levels, CAMERA_RATE_HZ, end, drops=levels.dropped)
        uv = spoil_tracks(rng, levels, _seen(clean, camera, t), np.asarray(camera.centre))
        for at, frame in zip(t * (1.0 + clocks.vision_drift) + clocks.vision_s, uv, strict=True):
            seen = np.isfinite(frame).all(axis=1)
            trust = np.ones(int(seen.sum()))
            bag.tracks(
                names["marker_tracks"], _ns(max(at, 0.0)), frame[seen], streams.ids[seen], trust, streams.camera_frame
            )
        matrix = [[nominal.focal, 0.0, nominal.centre[0]], [0.0, nominal.focal, nominal.centre[1]], [0.0, 0.0, 1.0]]
        bag.camera_info(
            names["camera_info"], START_NS, matrix, nominal.distortion, "plumb_bob", *nominal.size, streams.camera_frame
        )


def noise_free(clean: Clean, camera: Pinhole, wrench: WrenchFaults, clocks: ClockFaults) -> tuple[Array, Array]:
    """Wrenches ``(n, 6)`` and pixels ``(k, m, 2)`` at even stamps, as a bag without noise would have them."""
    end = float(clean.t[-1])
    t = np.arange(0.0, end, 1.0 / WRENCH_RATE_HZ)
    read = _mean(clean.t, wrench.read(clean.t, clean.wrench), t - clocks.wrench_s)
    t = np.arange(0.0, end, 1.0 / CAMERA_RATE_HZ)
    return read, _seen(clean, camera, (t - clocks.vision_s) / (1.0 + clocks.vision_drift))


def _mean(t: Array, values: Array, at: Array) -> Array:
    """Mean over the window around each stamp."""
    total = cumulative_trapezoid(values, t, axis=0, initial=0.0)
    low, high = np.clip(at - WINDOW_S / 2, t[0], t[-1]), np.clip(at + WINDOW_S / 2, t[0], t[-1])
    span = np.maximum(high - low, 1e-9)[:, None]
    columns = range(values.shape[1])
    return np.column_stack([np.interp(high, t, total[:, k]) - np.interp(low, t, total[:, k]) for k in columns]) / span


def _seen(clean: Clean, camera: Pinhole, at: Array) -> Array:
    """Pixels of the markers at the stamps; with a rolling shutter each row at its own time."""
    uv = camera.project(_interpolate(clean.t, clean.markers, at[:, None]))
    if camera.line_s:
        late = (uv[..., 1] - camera.size[1] / 2) * camera.line_s
        uv = camera.project(_interpolate(clean.t, clean.markers, at[:, None] + np.nan_to_num(late)))
    return uv


def _interpolate(t: Array, points: Array, at: Array) -> Array:
    """Positions at times ``(n, 1)`` or ``(n, m)`` by straight lines between close instants."""
    at = np.broadcast_to(at, (len(at), points.shape[1]))
    k = np.clip(np.searchsorted(t, at) - 1, 0, len(t) - 2)
    share = np.clip((at - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0)[..., None]
    column = np.arange(points.shape[1])
    return np.asarray((1.0 - share) * points[k, column] + share * points[k + 1, column])


def _turn(quaternions: Array, vectors: Array) -> Array:
    """Quaternions turned by small rotation vectors [rad]."""
    x, y, z, w = quaternions.T
    a, b, c = 0.5 * vectors.T
    turned = np.column_stack([
        x + w * a + b * z - c * y, y + w * b + c * x - a * z, z + w * c + a * y - b * x, w - a * x - b * y - c * z,
    ])  # fmt: skip
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def _ns(t: float) -> int:
    return START_NS + round(float(t) * 1e9)
