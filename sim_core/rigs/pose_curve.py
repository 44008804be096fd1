"""A smooth curve through, or near, time-stamped poses: twice continuously differentiable, so that steps shorter than
the interval between poses meet the acceleration that the motion had.

Positions and unit quaternions (as vectors of R^4, then normalised) follow cubic splines. A change of the base frame or
of the tool frame turns quaternions in R^4, so the curve does not depend on either, and between neighbouring samples it
differs from the geodesic spline by the order of the interpolation error itself.

Measured poses are smoothed: of all curves g, the one that minimises ``sum |y_k - g(t_k)|^2 + lambda int |g''|^2 dt``
(Reinsch 1967), with lambda by the discrepancy principle, ``RSS = sigma^2 (n - d(lambda))``. The degrees of freedom d
are those of Utreras (1981), ``2 + sum_k 1 / (1 + lambda h mu_k)``, ``mu_k = (pi (k - 1/2) / T)^4 / h^2``.

Where samples are no smooth motion at their sampling interval (steps of a command, jumps, gaps, sudden changes of
velocity) the curve has a corner: it is continuous there, and the splines on both sides do not see each other. Two
samples between two corners are joined by a straight line and the shortest turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from sim_core.rigs.fields import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline, PPoly

FEWEST = 5
"""Fewest samples in a row that a spline is put through; fewer are joined by straight lines."""

CORNER_SHARE = 0.15
"""A sample is a corner if the cubic through its four neighbours misses it by more than this share of the range of the
five. Motions that are resolved stay below 0.1; a step of a command reaches 0.5 to 0.7, a start at full speed 0.17."""

CORNER_SIGMAS = 8.0
"""... and by more than this many standard deviations of the noise."""

GAP = 3.5
"""An interval of more than this many median ones is a gap, which is bridged by a straight line."""

LARGEST_TURN_DEG = 60.0
"""Samples that are turned by more than this against each other are joined by the shortest turn."""


@dataclass(frozen=True)
class PoseCurve:
    """A curve of positions [m] and quaternions between the ``corners``, indices of samples. ``pieces``: one between
    two corners, of positions and quaternions; None where a straight line joins two samples."""

    times: FloatArray
    values: FloatArray
    corners: tuple[int, ...]
    pieces: tuple[PPoly | None, ...]

    def sample(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions [m] ``(k, 3)`` and unit quaternions ``(k, 4)`` at times [s] ``(k,)`` within the samples'."""
        from scipy.spatial.transform import Rotation, Slerp

        out = np.empty((len(times), 7))
        starts = self.times[list(self.corners[:-1])]
        piece = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, len(self.pieces) - 1)
        for index in np.unique(piece):
            mine, spline, first = piece == index, self.pieces[index], self.corners[index]
            if spline is not None:
                out[mine] = spline(times[mine])
                continue
            ends = slice(first, first + 2)
            share = (times[mine] - self.times[first]) / (self.times[first + 1] - self.times[first])
            before, after = self.values[ends, :3]
            out[mine, :3] = before + share[:, None] * (after - before)
            turn = Slerp([0.0, 1.0], Rotation.from_quat(self.values[ends, 3:]))(np.clip(share, 0.0, 1.0)).as_quat()
            sign = np.where(turn @ self.values[first, 3:] < 0.0, -1.0, 1.0)
            out[mine, 3:] = turn * sign[:, None]
        return out[:, :3], out[:, 3:] / np.linalg.norm(out[:, 3:], axis=1)[:, None]

    @property
    def inner_corners(self) -> FloatArray:
        """Times [s] of the corners between the ends."""
        return np.asarray(self.times[list(self.corners[1:-1])])


def pose_curve(times: FloatArray, positions: FloatArray, quaternions: FloatArray, noise: FloatArray) -> PoseCurve:
    """The curve of samples ``(n,)``, ``(n, 3)``, ``(n, 4)``, n at least 2. ``noise``: standard deviations of their
    positions [m] and turns [rad], one axis, that are smoothed away; zero where the curve goes through the samples."""
    from scipy.interpolate import PPoly

    values = np.hstack([positions, quaternions])
    corners = find_corners(times, values, noise)
    sigma = np.array([noise[0], 0.5 * noise[1]])  # a turn by a changes a quaternion by a / 2
    pieces: list[PPoly | None] = []
    ends = [0]
    for first, last in pairwise(corners):
        if last - first + 1 < FEWEST:
            ends.extend(range(first + 1, last + 1))
            pieces.extend([None] * (last - first))
            continue
        t, y = times[first : last + 1], values[first : last + 1]
        parts = [_spline(t, y[:, axes], s) for axes, s in ((slice(0, 3), sigma[0]), (slice(3, 7), sigma[1]))]
        pieces.append(PPoly(np.concatenate([p.c for p in parts], axis=2), t))
        ends.append(last)
    values = values.copy()
    for index, spline in enumerate(pieces):  # what is straight joins what is smoothed
        if spline is not None:
            values[[ends[index], ends[index + 1]]] = spline(times[[ends[index], ends[index + 1]]])
    return PoseCurve(times, values, tuple(ends), tuple(pieces))


def find_corners(times: FloatArray, values: FloatArray, noise: FloatArray) -> list[int]:
    """Indices of the samples at which the motion is not smooth at its sampling interval, both ends included.
    ``values``: positions [m] and quaternions ``(n, 7)``."""
    n = len(times)
    steps = np.diff(times)
    found = np.zeros(n, dtype=bool)
    found[[0, -1]] = True
    if n < FEWEST:
        return list(range(n))
    cosines = np.abs((values[1:, 3:] * values[:-1, 3:]).sum(axis=1))
    apart = (steps > GAP * np.median(steps)) | (cosines < np.cos(0.5 * np.radians(LARGEST_TURN_DEG)))
    found[:-1] |= apart
    found[1:] |= apart
    middle = np.arange(2, n - 2)
    error, size = _misses(times, values, middle, np.array([-2, -1, 1, 2]))
    floor = np.array([noise[0], 0.5 * noise[1]])
    if len(middle) >= FEWEST:
        floor = np.maximum(floor, 1.4826 * np.median(error, axis=0))
    round_off = 1e-12 * np.array([max(float(np.abs(values[:, :3]).max()), 1e-3), 1.0])
    limit = np.maximum(CORNER_SIGMAS * floor, round_off)
    found[middle] |= ((error > CORNER_SHARE * size) & (error > limit)).any(axis=1)
    for at, others in ((1, np.array([-1, 1, 2])), (n - 2, np.array([-2, -1, 1]))):
        error, size = _misses(times, values, np.array([at]), others)
        found[at] |= bool(((error > 2.0 * CORNER_SHARE * size) & (error > limit)).any())
    return [int(k) for k in np.flatnonzero(found)]


def _misses(times: FloatArray, values: FloatArray, at: np.ndarray, others: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """By how much the polynomial through neighbours misses samples, and the range of the samples: each of positions and
    quaternions ``(k, 2)``."""
    near = at[:, None] + others
    t, own = times[near], times[at]
    weights = np.ones(t.shape)
    for j in range(len(others)):
        for m in range(len(others)):
            if m != j:
                weights[:, j] *= (own - t[:, m]) / (t[:, j] - t[:, m])
    missed = values[at] - (weights[..., None] * values[near]).sum(axis=1)
    five = np.concatenate([values[near], values[at][:, None]], axis=1)
    extent = np.ptp(five, axis=1)
    split = (slice(0, 3), slice(3, 7))
    scale = np.sqrt((weights**2).sum(axis=1) + 1.0)[:, None] / np.sqrt(1.0 + 34.0 / 36.0)
    return (
        np.column_stack([np.linalg.norm(missed[:, s], axis=1) for s in split]) / np.maximum(scale, 1.0),
        np.column_stack([np.linalg.norm(extent[:, s], axis=1) for s in split]),
    )


def _spline(times: FloatArray, values: FloatArray, sigma: float) -> CubicSpline:
    """The cubic spline through samples ``(n, m)``, or near those with noise ``sigma`` in each of three directions."""
    from scipy.interpolate import CubicSpline

    near = values if sigma <= 0.0 else _smoothed(times, values, sigma)
    return CubicSpline(times, near, bc_type="not-a-knot" if near is values else "natural")


def _smoothed(times: FloatArray, values: FloatArray, sigma: float) -> FloatArray:
    """Values ``(n, m)`` of the smoothing spline at the samples; the samples themselves where they have less noise."""
    from scipy.linalg import solveh_banded
    from scipy.optimize import brentq

    n, steps = len(times), np.diff(times)
    span = float(times[-1] - times[0])
    mu = (np.pi * (np.arange(2, n) - 0.5) / span) ** 4 * (span / (n - 1))
    second = np.diff(np.diff(values, axis=0) / steps[:, None], axis=0)
    inner, outer = 1.0 / steps[:-1], 1.0 / steps[1:]
    middle = -(inner + outer)
    products = np.zeros((3, n - 2))  # Q^T Q, upper bands
    products[2] = inner**2 + middle**2 + outer**2
    products[1, 1:] = middle[:-1] * inner[1:] + outer[:-1] * middle[1:]
    products[0, 2:] = outer[:-2] * inner[2:]
    moments = np.zeros((3, n - 2))  # R
    moments[2] = (steps[:-1] + steps[1:]) / 3.0
    moments[1, 1:] = steps[1:-1] / 6.0

    def off(log_weight: float) -> FloatArray:
        """By how much the curve is off the samples."""
        weight = 10.0**log_weight
        gamma = solveh_banded(moments + weight * products, second)
        away = np.zeros_like(values)
        away[:-2] += inner[:, None] * gamma
        away[1:-1] += middle[:, None] * gamma
        away[2:] += outer[:, None] * gamma
        return np.asarray(weight * away)

    def excess(log_weight: float) -> float:
        """Of the residual over what the noise leaves of it."""
        freedom = 2.0 + float((1.0 / (1.0 + 10.0**log_weight * mu)).sum())
        return float((off(log_weight) ** 2).sum()) / 3.0 - sigma**2 * (n - freedom)

    low, high = (float(np.log10(w / mu[end])) for w, end in ((1e-3, -1), (1e3, 0)))
    if excess(low) >= 0.0:
        return values
    if excess(high) <= 0.0:
        return np.asarray(values - off(high))
    return np.asarray(values - off(brentq(excess, low, high, xtol=0.02)))


def noise_of(times: FloatArray, positions: FloatArray, quaternions: FloatArray) -> FloatArray:
    """Standard deviations of the noise of samples: positions [m] and turns [rad] of one axis, ``(2,)``.

    From the median of the differences of fourth, sixth and eighth order, of which noise has an equal share (their sums
    of squared weights are 70, 924 and 12870) and motion ever less; of components that never change there is none.
    """
    if len(times) < 4 * FEWEST:
        return np.zeros(2)
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_quat(quaternions)
    relative = (turns[:-1].inv() * turns[1:]).as_rotvec()
    sigma = np.full(2, np.inf)
    for order, weights in ((4, 70.0), (6, 924.0), (8, 12870.0)):
        parts = (np.diff(positions, n=order, axis=0), np.diff(relative, n=order - 1, axis=0))
        medians = [np.sqrt(np.mean(np.median(np.abs(d), axis=0) ** 2)) for d in parts]
        sigma = np.minimum(sigma, 1.4826 * np.array(medians) / np.sqrt(weights))
    return sigma
