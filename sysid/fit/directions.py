"""The simulator's own error as known shapes of uncertain size, which fits carry as nuisance parameters.

A refinement of the mesh (or of the time step) shows the shape d(t) of the discretisation error of every
reading, but only estimates its size, and the estimate need not be equally good all the time: while a body
rolls over an element edge or starts to slip it is off by more than during a hold. The error is therefore
taken to be, in column j of a channel,

    e_j(t) = d_j(t) (mean + sd (g(t) + g_j(t))) + ROUGH D(t) n_j(t),
    g(t) = c_0 + sum_l a_l sum_k c_lk h_lk(t),    c, n ~ N(0, 1),

with h_lk the hat functions of the equidistant instants of level l of :data:`LEVELS`, ever finer and ever
weaker (a_l), so that the size drifts like a random walk; g is common to all columns of a quantity (the
forces, the torques, the markers), g_j is each column's own. Where d passes through zero or two refinements
act on each other the error is not a multiple of d at all; the last part stands for that, independent from
sample to sample, with D(t) the largest rms of d over the columns of a quantity about t. The coefficients are
eliminated from the least-squares problem and the last part weighs samples down, so intervals and evidence
are those with the error integrated out (the discrepancy of Kennedy & O'Hagan 2001 with a basis from the
solver instead of a stationary kernel).

A wrench sensor that was not tared adds a constant to each of its readings. Such a bias is one more coefficient
that a column has for itself, and is eliminated with the others.

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
"""Standard deviation of the constant part of the size of a direction, and of its drift in time."""

LEVELS = ((6, 2**-0.5), (12, 0.5), (24, 8**-0.5))
"""Instants of a run between which the size of a direction is interpolated, and how strong each level is."""

ROUGH = 0.25
"""Part of the error that follows no shape, in units of the largest error thereabouts."""


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
    for itself; ``common_times``, ``own_times`` [s]: to which instant a coefficient belongs; ``rough``
    ``(n, m)``: standard deviation of what follows no shape, measured units; ``weight`` ``(n, m)``: the factor
    on whitened samples that accounts for it.
    """

    expected: np.ndarray
    slopes: np.ndarray
    at: np.ndarray
    common: np.ndarray
    own: np.ndarray
    common_times: np.ndarray
    own_times: np.ndarray
    rough: np.ndarray
    weight: np.ndarray

    def whitened(self, noise: ChannelNoise) -> Basis:
        """The same in units of the noise; what is not finite has no part in it."""
        # What is independent from sample to sample comes out of whitening that much larger.
        coloured = (1.0 + noise.rho**2) / (1.0 - noise.rho**2)
        weight = 1.0 / np.sqrt(1.0 + coloured * (self.rough / noise.sigma) ** 2)
        parts = {}
        for name in ("expected", "slopes", "common", "own"):
            white = np.nan_to_num(whiten(getattr(self, name), noise))
            parts[name] = white * weight.reshape(*weight.shape, *(1,) * (white.ndim - 2))
        return replace(self, weight=weight, **parts)

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
        by_column, transposed = own.transpose(1, 0, 2), own.transpose(1, 2, 0)
        gram = np.eye(own.shape[2]) + transposed @ by_column
        c = np.linalg.solve(gram, transposed @ v.transpose(1, 0, 2))
        v = v - (by_column @ c).transpose(1, 0, 2)
        rows = np.concatenate([v[good], -c.reshape(-1, c.shape[2])])
        root, rows = rows[:, count:], rows[:, :count]
        both = np.linalg.solve(np.eye(shared) + root.T @ root, root.T @ rows)
        sizes = Sizes(both[:, 0], c[:, :, 0] - c[:, :, count:] @ both[:, 0])
        times = np.concatenate([np.tile(self.own_times, good.shape[1]), self.common_times])
        return np.concatenate([rows - root @ both, -both]), sizes, times


def basis_of(
    directions: list[Direction], index: int, run: Run, measured: Measured, bias: np.ndarray | None = None
) -> Basis:
    """The basis of one channel of run number ``index``.

    ``bias`` ``(m,)``: standard deviation of a constant added to each column; its coefficient is then the last of the
    column's own.
    """
    t = measured.t
    drift, instants = _drift(t, run.end)
    expected = np.zeros(measured.values.shape)
    rough = np.zeros(expected.shape)
    at = next((d.at for d in directions if d.at is not None), np.zeros(0))
    slopes = np.zeros((*expected.shape, len(at)))
    common, own = [np.zeros((*expected.shape, 0))], [np.zeros((*expected.shape, 0))]
    own_times = [np.zeros(0)]
    for direction in directions:
        shape = direction.shapes[index].get(measured.channel)
        if shape is None:
            continue
        expected += direction.mean * shape
        if direction.slopes:
            slopes += direction.mean * direction.slopes[index][measured.channel]
        own.append(direction.sd * shape[:, :, None] * drift[:, None, :])
        own_times.append(instants)
        for group in column_groups(measured):
            part = np.zeros(own[-1].shape)
            part[:, group] = own[-1][:, group]
            common.append(part)
            rough[:, group] += (ROUGH * _largest(shape[:, group], t, run.end))[:, None] ** 2
    if bias is not None:
        own.append(np.tile(bias[:, None], (len(t), 1, 1)))
        own_times.append(np.array([0.5 * run.end]))
    return Basis(
        expected,
        slopes,
        at,
        np.concatenate(common, axis=2),
        np.concatenate(own, axis=2),
        np.tile(instants, len(common) - 1),
        np.concatenate(own_times),
        np.sqrt(rough),
        np.ones(expected.shape),
    )


def _hats(t: np.ndarray, end: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Hat functions at the times ``(n, count)``, and their instants [s] ``(count,)``."""
    knots = np.linspace(0.0, max(end, 1e-9), count)
    return np.clip(1.0 - np.abs(t[:, None] - knots) / (knots[1] - knots[0]), 0.0, None), knots


def _drift(t: np.ndarray, end: float) -> tuple[np.ndarray, np.ndarray]:
    """The functions of time that the size of a direction is made of ``(n, l)``, and their instants [s]."""
    functions, instants = [np.ones((len(t), 1))], [np.array([0.5 * end])]
    for count, strength in LEVELS:
        hats, knots = _hats(t, end, count)
        functions.append(strength * hats)
        instants.append(knots)
    return np.concatenate(functions, axis=1), np.concatenate(instants)


def _largest(shape: np.ndarray, t: np.ndarray, end: float) -> np.ndarray:
    """Largest rms over the columns about each time, in windows of the finest level ``(n,)``."""
    hats, _ = _hats(t, end, LEVELS[-1][0])
    rms = np.sqrt(np.mean(shape**2, axis=1))
    return np.asarray(hats @ np.max(np.where(hats > 0.0, rms[:, None], 0.0), axis=0))
