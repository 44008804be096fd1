"""Starts for a match: grow the layout outwards from a seed, each marker predicted by those already placed.

A marker pattern is nearly a lattice, so a match that looks only for near markers may be off by one row
over a part of the image. Growth cannot jump a row: it extrapolates the local deformation step by step. A
seed that is itself off by one row fails at the rim of the pattern, and the cost of the match shows it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sysid.vision.field import Points, pitch_of

_NEIGHBOURS = 12
_RING = 6


def grow(
    reference: Points, uv: Points, quality: NDArray[np.float64], seed: NDArray[np.intp], pitch: float
) -> NDArray[np.intp]:
    """Extend a partial assignment over the whole layout.

    ``seed`` is the detection of each reference marker or -1, shape ``(n,)``; so is the result. ``pitch``
    is the marker distance [px] of the reference.
    """
    index: NDArray[np.intp] = seed.copy()
    count = min(_NEIGHBOURS, len(reference) - 1)
    distance, near = cKDTree(reference).query(reference, k=count + 1)
    distance, near = distance[:, 1:], near[:, 1:]
    closeness = np.exp(-((distance / (1.5 * pitch)) ** 2)) * (distance < 2.6 * pitch)
    usable = np.flatnonzero(quality > 0.15)
    required = min(5, count)
    while required >= 3:
        placed = index >= 0
        support = np.sum(placed[near] & (closeness > 0), axis=1)
        rows = np.flatnonzero(~placed & (support >= required))
        free = usable[~np.isin(usable, index[placed])]
        new = 0
        if rows.size and free.size:
            predicted, spread = _extrapolate(
                reference, uv, index, rows, near[rows], closeness[rows] * placed[near[rows]]
            )
            tree = cKDTree(uv[free])
            gap, choice = tree.query(predicted)
            close = gap < 0.38 * np.minimum(spread, 1.3 * pitch)
            for candidate in np.argsort(gap):
                column = free[choice[candidate]]
                if close[candidate] and column >= 0:
                    index[rows[candidate]] = column
                    free[choice[candidate]] = -1
                    new += 1
        if new == 0:
            required -= 1
    return index


def _extrapolate(
    reference: Points,
    uv: Points,
    index: NDArray[np.intp],
    rows: NDArray[np.intp],
    near: NDArray[np.intp],
    weight: NDArray[np.float64],
) -> tuple[Points, NDArray[np.float64]]:
    """Return predicted places [px] of ``rows`` by a local affine fit, and the local pitch [px] there."""
    offset = reference[near] - reference[rows][:, None, :]
    target = uv[np.maximum(index[near], 0)]
    total = weight.sum(axis=1)
    mean_offset = np.einsum("nk,nki->ni", weight, offset) / total[:, None]
    mean_target = np.einsum("nk,nki->ni", weight, target) / total[:, None]
    centred = offset - mean_offset[:, None, :]
    moved = target - mean_target[:, None, :] - centred
    gram = np.einsum("nk,nki,nkj->nij", weight, centred, centred)
    size = np.trace(gram, axis1=1, axis2=2)
    gram = gram + (0.01 * size + 1e-9)[:, None, None] * np.eye(2)
    slope = np.linalg.solve(gram, np.einsum("nk,nki,nkj->nij", weight, centred, moved)) + np.eye(2)
    predicted = mean_target - np.einsum("ni,nij->nj", mean_offset, slope)
    stretch = np.sqrt(np.abs(np.linalg.det(slope)))
    pitch = pitch_of(reference)
    return predicted, pitch * np.clip(stretch, 0.5, 1.6)


def seeds_at(
    reference: Points, uv: Points, quality: NDArray[np.float64], pitch: float, *, reach: float
) -> list[NDArray[np.intp]]:
    """Return partial assignments of the ring around the central reference marker.

    The central marker is put on every sharp detection within ``reach`` [pitch] in turn, and its ring on
    the detections around that one, whatever the local stretch.
    """
    sharp = np.flatnonzero(quality > 0.5)
    if len(sharp) < _RING + 1 or len(reference) < _RING + 1:
        return []
    centre = int(np.argmin(np.linalg.norm(reference - reference.mean(axis=0), axis=1)))
    _, ring = cKDTree(reference).query(reference[centre], k=_RING + 1)
    tree = cKDTree(uv[sharp])
    spacing = np.mean(tree.query(uv[sharp], k=_RING + 1)[0][:, 1:], axis=1)
    offset = reference[ring] - reference[centre]
    size = float(np.mean(np.linalg.norm(offset[1:], axis=1)))
    seeds = []
    gap = np.linalg.norm(uv[sharp] - reference[centre], axis=1)
    for candidate in np.argsort(gap):
        if gap[candidate] > reach * pitch:
            break
        stretch = float(spacing[candidate]) / size
        distance, choice = tree.query(uv[sharp[candidate]] + stretch * offset)
        ok = distance < 0.45 * stretch * pitch
        if ok.sum() < 5 or len(set(choice[ok])) < ok.sum():
            continue
        seed = np.full(len(reference), -1, dtype=np.intp)
        seed[ring[ok]] = sharp[choice[ok]]
        seeds.append(seed)
    return seeds
