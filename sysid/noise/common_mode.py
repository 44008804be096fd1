"""Noise that all markers of a picture have in common: the camera shakes.

A shift, a turn and a scale of the whole picture move N markers together. Taken for noise of each they would be N
witnesses of what is one. While nothing moves, the displacements d of the markers at places p about their middle are
therefore split by the orthonormal modes of a picture,

    h_u = (1, 0, 1, 0, ...) / sqrt(N),  h_v alike,  h_turn ~ (-p_v, p_u),  h_scale ~ (p_u, p_v),

and what is left. The mean over n samples of white or first-order autoregressive noise of variance s^2 and correlation
rho has the variance s^2 (1 + rho) / (n (1 - rho)). Where that of a mode's coefficient is larger than what the markers'
own noise makes of it, the mode has noise of its own; the ratio of the two,

    share_k^2 = [s^2 (1 + rho) / (1 - rho)]_left / [s^2 (1 + rho) / (1 - rho)]_k,

gives its variance in units of the markers' own innovations. The whitened readings w of one picture, each weighted by a
factor a_j that accounts for further independent noise, then have the covariance

    cov(a w) = I + G^T G,    G_kj = a_j h_kj (1 / share_k^2 - 1)^(1/2) for markers that are seen, else 0,

of rank four over the identity. :class:`CommonWhitening` applies its inverse symmetric root, by Woodbury's identity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.noise.sampling_interval import in_sampling_intervals
from sysid.noise.scatter import Stretch, scatter_of
from sysid.settings.noise import NOISE

KINDS = ((0, 1), (2,), (3,))
"""Modes that share one level: both shifts, the turn, the scale."""


@dataclass(frozen=True)
class CommonMode:
    """``sigma``, ``rho`` ``(m,)``: standard deviation of what each column has for itself, and its correlation over the
    usual interval of samples; ``shares`` ``(4,)``: of modes, shifts along u and v, turn, and scale, that are kept."""

    sigma: np.ndarray
    rho: np.ndarray
    shares: np.ndarray

    def deviations(self, places: np.ndarray, seen: np.ndarray, weights: np.ndarray | float = 1.0) -> np.ndarray:
        """What modes of unit variance add to the whitened readings of each picture ``(n, r, m)``, of those ``r`` modes
        that have noise of their own. ``places`` ``(m,)``: of the markers; ``seen`` ``(n, m)``: which of them count;
        ``weights`` ``(n, m)``: factors on whitened readings."""
        kept = np.flatnonzero(self.shares < 1.0)
        whole = modes(places, np.isfinite(places)[None])[0, kept]
        sizes = np.sqrt(self.shares[kept] ** -2 - 1.0)
        return np.asarray((sizes[:, None] * whole) * (weights * seen)[:, None])


class CommonWhitening:
    """The map (I + G^T G)^(-1/2), picture by picture, of whitened readings whose common modes have the
    ``deviations`` G ``(n, r, m)`` (:meth:`CommonMode.deviations`)."""

    def __init__(self, deviations: np.ndarray) -> None:
        values, vectors = np.linalg.eigh(np.einsum("nrm,nsm->nrs", deviations, deviations))
        values = np.maximum(values, 0.0)
        # (1 - (1 + x)^(-1/2)) / x, without the cancellation at small x.
        root = np.sqrt(1.0 + values)
        self._factor = np.einsum("nri,ni,nsi->nrs", vectors, 1.0 / (root * (1.0 + root)), vectors)
        self._deviations = deviations

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Readings ``(n, m, ...)``, 0 where they do not count."""
        flat = values.reshape(*values.shape[:2], -1)
        taken = self._factor @ (self._deviations @ flat)
        return np.asarray(values - (self._deviations.transpose(0, 2, 1) @ taken).reshape(values.shape))


def modes(places: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Orthonormal modes ``(n, 4, m)`` of pictures in which markers at ``places`` ``(m,)`` are ``seen`` ``(n, m)``; 0
    where there are too few of them."""
    there = (seen.reshape(len(seen), -1, 2).all(axis=2) & np.isfinite(places.reshape(-1, 2)).all(axis=1)).astype(float)
    points = np.nan_to_num(places.reshape(-1, 2))
    count = np.maximum(there.sum(axis=1), 1.0)
    about = (points - (there @ points / count[:, None])[:, None]) * there[..., None]
    zero = np.zeros_like(there)
    shapes = np.stack(
        [
            np.stack([there, zero], axis=2),
            np.stack([zero, there], axis=2),
            np.stack([-about[..., 1], about[..., 0]], axis=2),
            about,
        ],
        axis=1,
    ).reshape(len(seen), 4, -1)
    size = np.linalg.norm(shapes, axis=2, keepdims=True)
    enough = (there.sum(axis=1) >= NOISE.common_mode_markers)[:, None, None]
    return np.where(enough & (size > 0.0), shapes / np.maximum(size, 1e-300), 0.0)


def common_mode(stretches: Sequence[tuple[np.ndarray, np.ndarray]]) -> CommonMode | None:
    """What markers have in common in stretches of pictures in which nothing moves, each ``(n, m)`` at times ``(n,)``;
    None where it is what chance makes of their own noise, or where there are no such stretches."""
    left: list[Stretch] = []
    found: list[list[Stretch]] = [[] for _ in KINDS]
    columns = 0
    for values, t in stretches:
        columns = values.shape[1]
        parts = _split(values)
        if parts is None:
            continue
        coefficients, own = parts
        at = in_sampling_intervals(t)
        rest = scatter_of(own, at)
        shown = [scatter_of(coefficients[:, list(kind)], at) for kind in KINDS]
        if rest is not None and all(s is not None for s in shown):
            left.append(rest)
            for of_kind, s in zip(found, shown, strict=True):
                of_kind.append(s)  # type: ignore[arg-type]
    if not left:
        return None
    # Where something still swings, markers have other things in common than the noise of the picture.
    calm = NOISE.restless_ratio * min(s.level for s in left)
    kept = [k for k, s in enumerate(left) if s.level <= calm]
    left, found = [left[k] for k in kept], [[of_kind[k] for k in kept] for of_kind in found]
    own_level, own_rho = _pooled(left)
    shares = np.ones(4)
    for kind, of_kind in zip(KINDS, found, strict=True):
        level, rho = _pooled(of_kind)
        if level**2 > NOISE.common_mode_variance_ratio * own_level**2:
            shares[list(kind)] = min(1.0, np.sqrt(_of_means(own_level, own_rho) / _of_means(level, rho)))
    if (shares == 1.0).all() or own_level <= 0.0:
        return None
    return CommonMode(np.full(columns, own_level), np.full(columns, own_rho), shares)


def _of_means(level: float, rho: float) -> float:
    """Variance of means of many samples, times their number."""
    return level**2 * (1.0 + rho) / (1.0 - rho)


def _pooled(stretches: Sequence[Stretch]) -> tuple[float, float]:
    """Level and correlation of noise over stretches."""
    size = [s.size for s in stretches]
    rho = min(float(np.average([s.rho for s in stretches], weights=size)), NOISE.largest_correlation)
    level = float(np.sqrt(np.average(np.square([s.level for s in stretches]), weights=size)))
    return level, rho if rho > NOISE.white_correlation else 0.0


def _split(values: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Coefficients of the modes ``(n, 4)`` of pictures ``(n, m)``, as of pictures in which all markers are seen, and
    what is left of the displacements ``(n, m)``; None with too few pictures or markers. What is a mistake counts for
    neither."""
    if values.shape[1] < 2 * NOISE.common_mode_markers:
        return None
    whole = np.isfinite(values).sum(axis=0) >= NOISE.min_rest_samples
    if whole.reshape(-1, 2).all(axis=1).sum() < NOISE.common_mode_markers:
        return None
    places = np.where(whole, np.nanmedian(np.where(whole, values, 0.0), axis=0), np.nan)
    away = values - places
    seen = np.isfinite(away)
    # A shift by the median first: mistakes stand out from it, however many markers they draw along in a mean.
    points = np.where(seen, away, np.nan).reshape(len(values), -1, 2)
    lost = ~np.isfinite(points).any(axis=(1, 2))
    points[lost] = 0.0
    rough = points - np.nanmedian(points, axis=1, keepdims=True)
    scale = 1.4826 * float(np.nanmedian(np.abs(rough)))
    near = (np.abs(rough) <= NOISE.common_mode_outlier_sd * scale).all(axis=2)
    seen &= np.repeat(near, 2, axis=1)
    h = modes(places, seen)
    displaced = np.where(seen, away, 0.0)
    coefficients = np.einsum("nkm,nm->nk", h, displaced)
    # Four of the 2 N coordinates of a picture are in its modes.
    free = np.sqrt(1.0 - 4.0 / np.maximum(seen.sum(axis=1, keepdims=True), 5.0))
    own = np.where(seen, (displaced - np.einsum("nkm,nk->nm", h, coefficients)) / free, np.nan)
    full = modes(places, np.isfinite(places)[None])[0]
    # Of a mode that moves all markers alike, a picture with fewer of them shows a smaller coefficient.
    share = np.einsum("nkm,km->nk", h, full)
    return np.where(share > 0.0, coefficients / np.maximum(share, 1e-300), np.nan), own
