"""The simulator's own error as known shapes of uncertain size, which fits carry as nuisance parameters.

A refinement of the mesh (or of the time step) shows the shape d(t) of the discretisation error of every
reading, but only estimates its size, and the estimate need not be equally good all the time: while a body
rolls over an element edge or starts to slip it is off by more than during a hold. The error is therefore
taken to be, in column j of a channel,

    e_j(t) = d_j(t) (mean + sd (g(t) + g_j(t))),    g(t) = c_0 + sum_k c_k h_k(t),    c ~ N(0, 1),

with h_k the hat functions of :data:`KNOTS` equidistant instants of the run; g is common to all columns of a
quantity (the forces, the torques, the markers), g_j is each column's own. The coefficients are eliminated
from the least-squares problem, so intervals and evidence are those with the error integrated out (the
discrepancy of Kennedy & O'Hagan 2001 with a basis from the solver instead of a stationary kernel).

The expected size lies between that of a recording made by this very simulator (none of the error) and that
of reality (all of it).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sysid.fit.noise import ChannelNoise, column_groups, whiten
from sysid.fit.runs import Measured, Run

EXPECTED = 0.5
"""Expected size of a direction, in units of the extrapolated error."""

RIGHT_SD = 0.5
"""Standard deviation of the size of a direction about its expected value, and of its change in time."""

KNOTS = 6
"""Instants of a run between which the size of a direction is interpolated."""


@dataclass(frozen=True)
class Direction:
    """A known shape of error for each run and channel, with an uncertain size that may drift.

    ``shapes[run index][channel]``: ``(n, m)`` in measured units, as measured at the scaled parameters
    ``at`` ``(p,)``; ``slopes``: their derivatives by the parameters ``(n, m, p)``, where they are known.
    Size: normal with ``mean`` and ``sd``.
    """

    label: str
    shapes: tuple[dict[str, np.ndarray], ...]
    mean: float = EXPECTED
    sd: float = RIGHT_SD
    slopes: tuple[dict[str, np.ndarray], ...] = ()
    at: np.ndarray | None = None


class Sizes(NamedTuple):
    """Most probable coefficients in one channel of one run: ``common`` ``(k,)``, ``own`` ``(m, l)``."""

    common: np.ndarray
    own: np.ndarray

    @property
    def number(self) -> int:
        return int(self.common.size + self.own.size)


@dataclass(frozen=True)
class Basis:
    """Directions of one channel of one run, in measured units or whitened.

    ``expected`` ``(n, m)``: the error with the expected sizes, at the parameters ``at``; ``slopes``
    ``(n, m, p)``: its derivatives by them (``p`` = 0: not known); ``common`` ``(n, m, k)`` and ``own``
    ``(n, m, l)``: its changes for coefficients of unit variance that all columns share, and that each has
    for itself; ``common_times``, ``own_times`` [s]: to which instant a coefficient belongs.
    """

    expected: np.ndarray
    slopes: np.ndarray
    at: np.ndarray
    common: np.ndarray
    own: np.ndarray
    common_times: np.ndarray
    own_times: np.ndarray

    def whitened(self, noise: ChannelNoise) -> Basis:
        """The same in units of the noise; what is not finite has no part in it."""
        parts = {k: np.nan_to_num(whiten(getattr(self, k), noise)) for k in ("expected", "slopes", "common", "own")}
        return replace(self, **parts)

    def mean_error(self, scaled: np.ndarray) -> np.ndarray:
        """Expected error ``(n, m)`` at scaled parameters, of which the first are those of ``at``."""
        return np.asarray(self.expected + self.slopes @ (scaled[: len(self.at)] - self.at))

    def error(self, scaled: np.ndarray, sizes: Sizes) -> np.ndarray:
        """The error ``(n, m)`` with given coefficients."""
        own = np.einsum("njl,jl->nj", self.own, sizes.own)
        return np.asarray(self.mean_error(scaled) + self.common @ sizes.common + own)

    def eliminate(self, vectors: np.ndarray, good: np.ndarray) -> tuple[np.ndarray, Sizes, np.ndarray]:
        """Take the coefficients out of whitened vectors ``(n, m, q)``; ``good`` ``(n, m)``: which samples count.

        Returns rows ``(good + coefficients, q)`` whose inner products are v^T (I + R R^T)^-1 w with R the
        columns of the basis, the coefficients that explain the first vector, and the times of the rows of
        coefficients. By Woodbury's identity the map v -> (v - R c, -c), c = (I + R^T R)^-1 R^T v, does this,
        first for each column's own coefficients, then for the common ones.
        """
        count, shared = vectors.shape[2], self.common.shape[2]
        v = np.where(good[:, :, None], np.concatenate([vectors, self.common], axis=2), 0.0)
        own = np.where(good[:, :, None], self.own, 0.0)
        gram = np.eye(own.shape[2]) + np.einsum("njl,njk->jlk", own, own)
        c = np.linalg.solve(gram, np.einsum("njl,njq->jlq", own, v))
        v = v - np.einsum("njl,jlq->njq", own, c)
        rows = np.concatenate([v[good], -c.reshape(-1, c.shape[2])])
        root, rows = rows[:, count:], rows[:, :count]
        both = np.linalg.solve(np.eye(shared) + root.T @ root, root.T @ rows)
        sizes = Sizes(both[:, 0], c[:, :, 0] - c[:, :, count:] @ both[:, 0])
        times = np.concatenate([np.tile(self.own_times, good.shape[1]), self.common_times])
        return np.concatenate([rows - root @ both, -both]), sizes, times


def basis_of(directions: list[Direction], index: int, run: Run, measured: Measured) -> Basis:
    """The basis of one channel of run number ``index``."""
    t = measured.t
    knots = np.linspace(0.0, max(run.end, 1e-9), KNOTS)
    hats = np.clip(1.0 - np.abs(t[:, None] - knots) / (knots[1] - knots[0]), 0.0, None)
    drift = np.column_stack([np.ones(len(t)), hats])
    instants = np.concatenate([[0.5 * run.end], knots])
    expected = np.zeros(measured.values.shape)
    at = next((d.at for d in directions if d.at is not None), np.zeros(0))
    slopes = np.zeros((*expected.shape, len(at)))
    common, own = [np.zeros((*expected.shape, 0))], [np.zeros((*expected.shape, 0))]
    for direction in directions:
        shape = direction.shapes[index].get(measured.channel)
        if shape is None:
            continue
        expected += direction.mean * shape
        if direction.slopes:
            slopes += direction.mean * direction.slopes[index][measured.channel]
        own.append(direction.sd * shape[:, :, None] * drift[:, None, :])
        for group in column_groups(measured):
            part = np.zeros(own[-1].shape)
            part[:, group] = own[-1][:, group]
            common.append(part)
    return Basis(
        expected,
        slopes,
        at,
        np.concatenate(common, axis=2),
        np.concatenate(own, axis=2),
        np.tile(instants, len(common) - 1),
        np.tile(instants, len(own) - 1),
    )
