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

from dataclasses import dataclass

import numpy as np

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
