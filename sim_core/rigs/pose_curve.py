"""A smooth curve through, or near, time-stamped poses: twice continuously differentiable, so that steps shorter than
the interval between poses meet the acceleration that the motion had.

Positions and unit quaternions (as vectors of R^4, then normalised) follow cubic splines. A change of the base frame or
of the tool frame turns quaternions in R^4, so the curve does not depend on either, and between neighbouring samples it
differs from the geodesic spline by the order of the interpolation error itself.

Measured poses are smoothed: of all curves g, the one that minimises ``sum |y_k - g(t_k)|^2 + lambda int |g''|^2 dt``
(Reinsch 1967), along each principal axis of their scatter, which turn with the frames, with a lambda of its own: a hand
that moves along one axis is at rest along others. It has the least expected error by the unbiased estimate
``RSS + 2 sigma^2 d(lambda)`` (Craven & Wahba, Numer. Math. 31, 1979), which depends little on how well the noise sigma
is known. The degrees of freedom d are those of Utreras (1981), ``2 + sum_k 1 / (1 + lambda h mu_k)``,
``mu_k = (pi (k - 1/2) / T)^4 / h^2``. Where the motion really was is then normal about the curve, at the samples with
the covariance ``sigma^2 (1 + lambda K)^-1``, where ``sum_k g_k (K g)_k = int |g''|^2 dt`` (Wahba, J. R. Stat. Soc. B
45, 1983). Where a hand rests along an axis it does not creep either (:mod:`sim_core.rigs.pose_rest`): the curve goes
through the mean of the samples of a rest, which weigh infinitely, and the others are smoothed.

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
from sim_core.rigs.pose_rest import rests

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

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


def pose_curve(
    times: FloatArray,
    positions: FloatArray,
    quaternions: FloatArray,
    noise: FloatArray,
    drawn: np.random.Generator | None = None,
    smooth: bool = False,
) -> PoseCurve:
    """The curve of samples ``(n,)``, ``(n, 3)``, ``(n, 4)``, n at least 2. ``noise``: standard deviations of their
    positions [m] and turns [rad], one axis, that are smoothed away; zero where the curve goes through the samples.
    ``drawn``: a curve along which the motion may have been as well is drawn about it, with the same corners.
    ``smooth``: the samples are a smooth motion, and the curve has no corners."""
    from scipy.interpolate import PPoly

    values = np.hstack([positions, quaternions])
    whole = smooth and len(times) >= FEWEST
    corners = [0, len(times) - 1] if whole else find_corners(times, values, noise)
    sigma = np.array([noise[0], 0.5 * noise[1]])  # a turn by a changes a quaternion by a / 2
    pieces: list[PPoly | None] = []
    ends = [0]
    for first, last in pairwise(corners):
        if last - first + 1 < FEWEST:
            ends.extend(range(first + 1, last + 1))
            pieces.extend([None] * (last - first))
            continue
        t, y = times[first : last + 1], values[first : last + 1]
        parts = [_spline(t, y[:, axes], s, drawn) for axes, s in ((slice(0, 3), sigma[0]), (slice(3, 7), sigma[1]))]
        pieces.append(PPoly(np.concatenate(parts, axis=2), t))
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


def _spline(times: FloatArray, values: FloatArray, sigma: float, drawn: np.random.Generator | None) -> FloatArray:
    """Coefficients ``(4, n - 1, m)`` of the cubic spline through samples ``(n, m)``, of positions or quaternions, or
    near those with noise ``sigma`` in each of three directions: where samples are many, with that which they show along
    each of their principal axes."""
    from scipy.interpolate import CubicSpline

    if sigma <= 0.0:
        return np.asarray(CubicSpline(times, values, bc_type="not-a-knot").c)
    _, _, axes = np.linalg.svd(values - values.mean(axis=0), full_matrices=False)
    parts = []
    for axis in axes:
        along = values @ axis
        # The noise of a quaternion is at right angles to it.
        across = 1.0 - float(np.mean(along**2)) if values.shape[1] == 4 else 1.0
        mine = sigma * np.sqrt(max(across, 0.0)) if len(along) < 4 * FEWEST else float(_noise_along(along[:, None])[0])
        near, weight = _smoothed(times, along, mine, drawn)
        parts.append(CubicSpline(times, near, bc_type="natural" if weight > 0.0 else "not-a-knot").c)
    return np.asarray(np.stack(parts, axis=-1) @ axes)


def _smoothed(
    times: FloatArray, values: FloatArray, sigma: float, drawn: np.random.Generator | None
) -> tuple[FloatArray, float]:
    """Samples ``(n,)`` of a smooth curve near those with noise ``sigma``, or of one that is drawn about it, and how
    much it is smoothed."""
    near, still = values.copy(), rests(values, sigma) if sigma > 0.0 else []
    open_ = np.ones(len(values))
    for span in still:
        near[span] = values[span].mean()
        open_[span] = 0.0
    smoothing = _Smoothing(times, open_)
    weight = smoothing.weight(near, sigma)
    near = near - smoothing.off(near, weight)
    if drawn is not None:
        away = smoothing.draw(weight, drawn)
        for span in still:
            away[span] = drawn.standard_normal() / np.sqrt(span.stop - span.start)
        near = near + sigma * (away - smoothing.off(away, weight))
    return near, weight


class _Smoothing:
    """Smoothing splines at samples: with the bands of Q and R, second differences and the products of hats (Reinsch
    1967), K = Q R^-1 Q^T. ``variance`` ``(n,)``: of each sample, 1, or 0 of one that the curve goes through."""

    def __init__(self, times: FloatArray, variance: FloatArray) -> None:
        steps = np.diff(times)
        self._steps, self._span, self._variance = steps, float(times[-1] - times[0]), variance
        self._inner, self._outer = 1.0 / steps[:-1], 1.0 / steps[1:]
        middle = self._middle = -(self._inner + self._outer)
        self._products = np.zeros((3, len(times) - 2))  # Q^T V Q, upper bands
        self._products[2] = variance[:-2] * self._inner**2 + variance[1:-1] * middle**2 + variance[2:] * self._outer**2
        self._products[1, 1:] = variance[1:-2] * middle[:-1] * self._inner[1:]
        self._products[1, 1:] += variance[2:-1] * self._outer[:-1] * middle[1:]
        self._products[0, 2:] = variance[2:-2] * self._outer[:-2] * self._inner[2:]
        self._moments = np.zeros((3, len(times) - 2))  # R
        self._moments[2] = (steps[:-1] + steps[1:]) / 3.0
        self._moments[1, 1:] = steps[1:-1] / 6.0

    def off(self, values: FloatArray, weight: float) -> FloatArray:
        """By how much the curve with a weight lambda is off the samples ``(n,)``."""
        from scipy.linalg import solveh_banded

        second = np.diff(np.diff(values) / self._steps)
        return weight * self._variance * self._back(solveh_banded(self._moments + weight * self._products, second))

    def _back(self, gamma: FloatArray) -> FloatArray:
        """Q gamma."""
        away = np.zeros(len(gamma) + 2)
        away[:-2] += self._inner * gamma
        away[1:-1] += self._middle * gamma
        away[2:] += self._outer * gamma
        return away

    def weight(self, values: FloatArray, sigma: float) -> float:
        """The weight lambda with the least expected error of samples ``(n,)`` with noise ``sigma``, 0 where they are
        best not smoothed at all. The degrees of freedom are those of the share of the samples that have noise."""
        from scipy.optimize import minimize_scalar

        n, share = len(values), float(self._variance.mean())
        mu = (np.pi * (np.arange(2, n) - 0.5) / self._span) ** 4 * (self._span / (n - 1))

        def risk(log_weight: float) -> float:
            """Expected sum of squared errors, but for a constant."""
            freedom = share * (2.0 + float((1.0 / (1.0 + 10.0**log_weight * mu)).sum()))
            return float((self.off(values, 10.0**log_weight) ** 2).sum()) + 2.0 * sigma**2 * freedom

        low, high = (float(np.log10(w / mu[end])) for w, end in ((1e-3, -1), (1e3, 0)))
        decades = np.linspace(low, high, int(np.ceil(high - low)) + 1)
        best = int(np.argmin([risk(at) for at in decades]))
        if best == 0:
            return 0.0
        around = (decades[best - 1], decades[min(best + 1, len(decades) - 1)])
        return float(10.0 ** minimize_scalar(risk, bounds=around, method="bounded", options={"xatol": 0.02}).x)

    def draw(self, weight: float, rng: np.random.Generator) -> FloatArray:
        """Samples ``(n,)`` near which the curve is a draw of the covariance (V^-1 + lambda K)^-1: with R = U^T U, V^1/2
        e + lambda^(1/2) V Q U^-1 z for normal e and z, of which the covariance is V + lambda V K V."""
        from scipy.linalg import cholesky_banded, solve_banded

        noise = rng.standard_normal(len(self._steps) + 1)
        normal = rng.standard_normal(len(self._steps) - 1)
        motion = self._back(solve_banded((0, 2), cholesky_banded(self._moments), normal))
        return np.asarray(self._variance * (noise + np.sqrt(weight) * motion))


def noise_of(times: FloatArray, positions: FloatArray, quaternions: FloatArray) -> FloatArray:
    """Standard deviations of the noise of samples: positions [m] and turns [rad] of one axis, ``(2,)``; of components
    that never change there is none."""
    if len(times) < 4 * FEWEST:
        return np.zeros(2)
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_quat(quaternions)
    relative = (turns[:-1].inv() * turns[1:]).as_rotvec()
    found = (_noise_along(positions), _noise_along(relative, 1))
    return np.array([np.sqrt(np.mean(sigma**2)) for sigma in found])


def _noise_along(values: FloatArray, differences: int = 0) -> FloatArray:
    """Standard deviation ``(m,)`` of the noise of samples ``(n, m)``, or of those of which they are ``differences``.

    From the median of the differences of fourth, sixth and eighth order, of which noise has an equal share (their sums
    of squared weights are 70, 924 and 12870) and motion ever less.
    """
    found = [
        np.median(np.abs(np.diff(values, n=order - differences, axis=0)), axis=0) / np.sqrt(weights)
        for order, weights in ((4, 70.0), (6, 924.0), (8, 12870.0))
    ]
    return np.asarray(1.4826 * np.min(found, axis=0))
