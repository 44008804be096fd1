"""How much noise the markers of a picture have in common, from rests.

A shift, a turn and a scale of the whole picture (:func:`sysid.noise.common_mode.modes`) that are seen while nothing
moves are the markers' own noise, or noise of the camera.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.common_mode import KINDS, CommonMode, modes
from sysid.noise.mixture import COLOURS, prior_loss
from sysid.noise.sampling_interval import in_sampling_intervals
from sysid.noise.scatter import Stretch, scatter_of
from sysid.noise.whitening import Whitening
from sysid.settings.noise import NOISE


def common_mode(stretches: Sequence[tuple[np.ndarray, np.ndarray]]) -> CommonMode | None:
    """What markers have in common in stretches of pictures in which nothing moves, each ``(n, m)`` at times ``(n,)``;
    None where it is negligible compared with their own noise, or where there are no such stretches."""
    left: list[Stretch] = []
    shown: list[tuple[np.ndarray, np.ndarray]] = []
    columns = 0
    for values, t in stretches:
        columns = values.shape[1]
        parts = _split(values)
        rest = None if parts is None else scatter_of(parts[1], in_sampling_intervals(t))
        if parts is not None and rest is not None:
            left.append(rest)
            shown.append((parts[0], t))
    if not left:
        return None
    # Where something still swings, markers have other things in common than the noise of the picture.
    calm = NOISE.restless_ratio * min(s.level for s in left)
    kept = [k for k, s in enumerate(left) if s.level <= calm]
    own_level, own_rho = _pooled([left[k] for k in kept])
    if own_level <= 0.0:
        return None
    excess = np.zeros(4)
    for kind in KINDS:
        excess[list(kind)] = _excess([(shown[k][0][:, list(kind)], shown[k][1]) for k in kept], own_level, own_rho)
    excess[excess < NOISE.common_mode_least_excess] = 0.0
    if not excess.any():
        return None
    return CommonMode(np.full(columns, own_level), np.full(columns, own_rho), 1.0 / np.sqrt(1.0 + excess))


def _excess(coefficients: Sequence[tuple[np.ndarray, np.ndarray]], level: float, rho: float) -> float:
    """By how much the variance of means of a mode's coefficients exceeds what the markers' own noise makes of it, in
    units of that; geometric mean of 1 + excess over the posterior. ``coefficients``: ``(n, k)`` and times [s] ``(n,)``
    of each stretch; ``level``, ``rho``: of the own noise.

    In units of the own noise's innovations the coefficients of a stretch have the covariance I + v W R W^T, with R the
    correlation of first-order autoregressive noise. Apart from the mean of each stretch, with the eigenvalues e of what
    is left of W R W^T and coefficients z along its eigenvectors, -2 log L = sum log(1 + v e) + z^2 / (1 + v e). A rest
    of half a second hardly shows how slow a shake is: its most probable size is too small on average, and the mean of
    its variance is that of the slowest noise that is possible. Its standard deviation is half-Cauchy beforehand, in
    units of the own noise (Gelman, Bayesian Analysis 1, 2006), and that there is no such noise is as probable as that
    there is.
    """
    colours = np.concatenate([[0.0], COLOURS])
    some = np.geomspace(*NOISE.common_mode_sizes, NOISE.common_mode_size_count)
    sizes = np.concatenate([[0.0], some])
    loss = np.zeros((len(colours), len(sizes)))
    own = ChannelNoise(np.array([level]), np.array([rho]), "")
    for values, t in coefficients:
        for first in range(0, len(t), NOISE.longest_exact_samples):
            part = slice(first, first + NOISE.longest_exact_samples)
            seen = np.isfinite(values[part]).all(axis=1)
            c, at = values[part][seen], t[part][seen]
            if len(at) < NOISE.min_rest_samples:
                continue
            white = Whitening(own, np.ones((len(at), 1), dtype=bool), at)
            both = white(np.column_stack([c, np.ones(len(at)), np.eye(len(at))])[:, None])[:, 0]
            k = c.shape[1]
            free = np.linalg.qr(both[:, k : k + 1], mode="complete")[0][:, 1:]
            left, made = free.T @ both[:, :k], level * free.T @ both[:, k + 1 :]
            counted = in_sampling_intervals(at)
            apart = np.abs(np.subtract.outer(counted, counted))
            for row, colour in zip(loss, colours, strict=True):
                e, vectors = np.linalg.eigh(made @ (colour**apart) @ made.T)
                variance = 1.0 + sizes[:, None] * np.maximum(e, 0.0)
                row += k * np.log(variance).sum(axis=1) + (1.0 / variance) @ ((vectors.T @ left) ** 2).sum(axis=1)
    loss += np.concatenate([[0.0], prior_loss(COLOURS)])[:, None]
    half_cauchy = np.sqrt(some) / (1.0 + some)
    of_sizes = np.concatenate([[1.0], half_cauchy / np.sum(half_cauchy)])
    weight = np.exp(-0.5 * (loss - loss.min())) * of_sizes
    slow = np.outer((1.0 + colours) / (1.0 - colours), sizes) * (1.0 - rho) / (1.0 + rho)
    return float(np.expm1(np.sum(weight * np.log1p(slow)) / np.sum(weight)))


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
