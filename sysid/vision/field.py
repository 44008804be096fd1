"""Smooth displacement fields over a marker layout: thin-plate splines, and prediction from neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

Points = NDArray[np.float64]
"""Image points [px], shape ``(n, 2)``."""


def pitch_of(points: Points) -> float:
    """Return the median distance [px] from a point to its nearest neighbour; 0 for fewer than 2 points."""
    if len(points) < 2:
        return 0.0
    distance, _ = cKDTree(points).query(points, k=2)
    return float(np.median(distance[:, 1]))


def affine_map(source: Points, target: Points, at: Points, *, stiffness: float = 1e-3) -> Points:
    """Fit ``target = A source + b`` by least squares and apply it to ``at``; ``A`` is drawn to identity."""
    centre = source.mean(axis=0)
    shifted = source - centre
    scale = max(float(np.mean(np.sum(shifted**2, axis=1))), 1e-12)
    gram = shifted.T @ shifted / len(source) + stiffness * scale * np.eye(2)
    moved = target - source
    slope = np.linalg.solve(gram, shifted.T @ (moved - moved.mean(axis=0)) / len(source))
    return np.asarray(at + moved.mean(axis=0) + (at - centre) @ slope, dtype=float)


def thin_plate_map(source: Points, target: Points, at: Points, *, pitch: float, smoothing: float) -> Points:
    """Fit a smoothing thin-plate spline to the displacements and apply it to ``at``.

    Lengths are scaled by ``pitch`` [px], so ``smoothing`` is a pure number: 0 interpolates, a large value
    leaves an affine map. With fewer than 6 points the affine map is used.
    """
    if len(source) < 6:
        return affine_map(source, target, at)
    spline = RBFInterpolator(source / pitch, (target - source) / pitch, kernel="thin_plate_spline", smoothing=smoothing)
    return np.asarray(at + pitch * spline(at / pitch), dtype=float)


def neighbour_residual(source: Points, target: Points, *, pitch: float, neighbours: int = 8) -> Points:
    """Return how far [px] each target is from where its neighbours say it should be, shape ``(n,)``.

    Each point is left out; its nearest ``neighbours`` in ``source`` give an affine map, fitted twice: the
    second time without those that fit worst, so that one wrong neighbour does not blame a right point.
    """
    count = len(source)
    used = min(neighbours, count - 1)
    if used < 4:
        return np.zeros(count)
    _, index = cKDTree(source).query(source, k=used + 1)
    index = index[:, 1:]
    offset = (source[index] - source[:, None, :]) / pitch
    moved = (target[index] - source[index]) / pitch
    own = (target - source) / pitch
    basis = np.concatenate([np.ones((count, used, 1)), offset], axis=2)
    ridge = np.diag([1e-9, 0.02, 0.02])
    weight = np.ones((count, used))
    for _ in range(3):
        weighted = basis * weight[:, :, None]
        gram = np.einsum("nki,nkj->nij", weighted, basis) + ridge
        coefficients = np.linalg.solve(gram, np.einsum("nki,nkj->nij", weighted, moved))
        misfit = np.linalg.norm(moved - np.einsum("nki,nij->nkj", basis, coefficients), axis=2)
        spread = np.maximum(np.median(misfit, axis=1, keepdims=True), 0.02)
        weight = 1.0 / (1.0 + (misfit / (2.0 * spread)) ** 2) ** 2
    return np.asarray(pitch * np.linalg.norm(own - coefficients[:, 0, :], axis=1), dtype=float)
