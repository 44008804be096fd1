"""The discretisation error as known shapes of uncertain size, which fits carry as nuisance parameters.

A refinement of the mesh (or of the time step) shows the shape d(t) of the discretisation error of every
reading, but only estimates its size, and the estimate need not be equally good all the time: while a body
rolls over an element edge or starts to slip it is off by more than during a hold. The error is therefore
taken to be, in column j of a channel,

    e_j(t) = d_j(t) (mean + sd g(t) + sd g_j(t)) + sd sum_p A_p(t) v_pj g_p(t) + rho D(t) r_j(t) + R(t) n_j(t),
    g(t) = c_0 + sum_l a_l sum_k c_lk h_lk(t),    c, n ~ N(0, 1),    R(t)^2 = (rho D(t))^2 + U(t)^2,

with h_lk the hat functions of the equidistant instants of level l of ``SOLVE.error_course_levels``, ever finer and ever
weaker (a_l), so that the size drifts like a random walk. g is common to all columns of a quantity (the forces, the
torques, the markers); g_j, g_p and r_j are made like g, and each column has a g_j and an r_j of its own. Where a body
starts to slip a little earlier the error has the patterns of d, but not their course: v_p are the strongest principal
components of d over the columns of a quantity, d(t) = sum_p a_p(t) v_p, and A_p(t) is the largest |a_p| about t. Where
two refinements act on each other, and where one refinement does not show what a second one would, the error is not made
of d at all: a share rho (``SOLVE.rough_error_share``) is left for that. D(t), the largest rms of d over the columns of
a quantity about t, stands for that twice: with r_j for what stays as long as the motion does (a marker that is off by
the same all through a hold, whose every sample must not count as a new witness: intervals would shrink with the rate of
the sensor), in R for what is new with every sample. U(t) is that of what came unforeseen, between two places where the
error and its slopes were measured: where a gel snaps over, it does so with other parameters a moment later or not at
all, and nobody knows which of both the real one does.

The coefficients are eliminated from the least-squares problem and the last part weighs samples down, so intervals and
evidence are those with the error integrated out (the discrepancy of Kennedy & O'Hagan 2001 with a basis from the solver
instead of a stationary kernel).

A wrench sensor that was not tared adds a constant to each of its readings. Such a bias is one more coefficient
that a column has for itself, and is eliminated with the others.

The expected size lies between that of a recording made by this very simulator (none of the error) and that
of reality (all of it).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import column_groups
from sysid.observations.observations import Measured, Run
from sysid.settings.solve import SOLVE


@dataclass(frozen=True)
class ErrorShape:
    """A known shape of error for each run and channel, with an uncertain size that may drift.

    ``shapes[run index][channel]``: ``(n, m)`` in measured units, as measured at the scaled parameters
    ``at`` ``(p,)``; ``slopes``: their derivatives by the parameters ``(n, m, p)``, where they are known, used up to
    ``reach`` ``(p,)`` to either side, scaled; empty: however far. Size: normal with ``mean`` and ``sd``.
    ``sight``: which readings were in sight in all that was measured, bool ``(n, m)``; empty: all. ``unforeseen``:
    largest changes ``(n, m)`` from one measurement to the next that slopes did not tell, where known.
    """

    label: str
    shapes: tuple[dict[str, np.ndarray], ...]
    mean: float = SOLVE.expected_error_size
    sd: float = SOLVE.error_size_sd
    slopes: tuple[dict[str, np.ndarray], ...] = ()
    at: np.ndarray | None = None
    reach: np.ndarray | None = None
    sight: tuple[dict[str, np.ndarray], ...] = ()
    unforeseen: tuple[dict[str, np.ndarray], ...] = ()

    def following(self, before: ErrorShape, scaled: np.ndarray) -> ErrorShape:
        """This direction, measured at ``scaled`` ``(p,)`` after another one ``before``, with what that did not foresee;
        beyond its reach nothing was foreseen, and what was known stays."""
        known = before.unforeseen
        if before.at is not None and before.slopes:
            away = scaled - before.at
            if before.reach is None or np.all(np.abs(away) <= before.reach):
                missed = [
                    {c: np.abs(shape - then[c] - slopes[c] @ away) for c, shape in now.items()}
                    for now, then, slopes in zip(self.shapes, before.shapes, before.slopes, strict=True)
                ]
                for sight in (self.sight, before.sight):
                    for run, there in zip(missed, sight, strict=False):
                        for c, seen in there.items():
                            run[c][~seen] = 0.0
                old = known or [{c: 0.0 * m for c, m in run.items()} for run in missed]
                both = zip(missed, old, strict=True)
                known = tuple({c: np.maximum(m, there[c]) for c, m in run.items()} for run, there in both)
        return replace(self, unforeseen=known)


class Sizes(NamedTuple):
    """Most probable coefficients in one channel of one run: ``common`` ``(k,)``, ``own`` ``(m, l)``."""

    common: np.ndarray
    own: np.ndarray

    @property
    def number(self) -> int:
        return int(self.common.size + self.own.size)


@dataclass(frozen=True)
class Changes:
    """What coefficients of unit variance add to the columns of a channel, measured units.

    Coefficient ``l`` adds ``shape[:, j] * functions[:, l]`` to column ``j``, with ``shape`` ``(n, m)`` and
    ``functions`` ``(n, l)``; ``instants`` [s] ``(l,)``: where it belongs.
    """

    shape: np.ndarray
    functions: np.ndarray
    instants: np.ndarray


@dataclass(frozen=True)
class Basis:
    """Directions of one channel of one run, in measured units.

    ``expected`` ``(n, m)``: the error with the expected sizes, at the parameters ``at``; ``slopes``
    ``(n, m, p)``: its derivatives by them (``p`` = 0: not known), up to ``reach`` ``(p,)`` to either side; ``common``
    and ``own``, at least one each: its changes for coefficients that all columns share, and for those that each has
    for itself; ``rough`` ``(n, m)``: standard deviation of what follows no shape; ``largest`` ``(n, m)``: the error
    thereabouts, largest rms over the columns of a quantity; ``unforeseen``: the same of what came unforeseen.
    """

    expected: np.ndarray
    slopes: np.ndarray
    at: np.ndarray
    reach: np.ndarray
    common: tuple[Changes, ...]
    own: tuple[Changes, ...]
    rough: np.ndarray
    largest: np.ndarray
    unforeseen: np.ndarray

    def doubtful(self, noise: ChannelNoise) -> np.ndarray:
        """Samples ``(n, m)`` that count little, since what came unforeseen is above noise and the rest of the error:
        they cannot tell either whether something is missing."""
        return np.asarray(self.unforeseen > np.maximum(noise.sigma, SOLVE.rough_error_share * self.largest))

    def weights(self, noise: ChannelNoise) -> np.ndarray:
        """Factors on whitened samples ``(n, m)`` that account for what follows no shape."""
        # What is independent from sample to sample comes out of whitening that much larger.
        return np.asarray(1.0 / np.sqrt(1.0 + noise.whitening_gain * (self.rough / noise.sigma) ** 2))

    def mean_error(self, scaled: np.ndarray) -> np.ndarray:
        """Expected error ``(n, m)`` at scaled parameters, of which the first are those of ``at``; ``(0,)``: there."""
        if not len(scaled):
            return self.expected
        away = np.clip(scaled[: len(self.at)] - self.at, -self.reach, self.reach)
        return np.asarray(self.expected + self.slopes @ away)

    def in_reach(self, scaled: np.ndarray) -> np.ndarray:
        """1 for each parameter of ``slopes`` with which the expected error changes at scaled parameters, 0 beyond its
        reach ``(p,)``."""
        return np.asarray((np.abs(scaled[: len(self.at)] - self.at) <= self.reach).astype(float))

    def error(self, scaled: np.ndarray, sizes: Sizes) -> np.ndarray:
        """The error ``(n, m)`` with given coefficients."""
        common = added(self.common, sizes.common[:, None, None])
        return np.asarray(self.mean_error(scaled) + (common + added(self.own, sizes.own.T[:, :, None]))[:, :, 0])


def added(parts: Sequence[Changes], coefficients: np.ndarray) -> np.ndarray:
    """What is added ``(n, m, q)`` for coefficients of all parts ``(l, m, q)``, or ``(l, 1, q)`` that columns share."""
    ends = np.cumsum([len(p.instants) for p in parts])
    each = zip(parts, np.split(coefficients, ends[:-1]), strict=True)
    return np.asarray(sum(p.shape[:, :, None] * np.tensordot(p.functions, c, 1) for p, c in each))


def added_transpose(parts: Sequence[Changes], values: np.ndarray, shared: bool) -> np.ndarray:
    """The transpose of :func:`added`: values ``(n, m, q)`` times what each coefficient adds ``(l, m or 1, q)``."""
    found = []
    for p in parts:
        product = np.einsum("nm,nmq->nq", p.shape, values)[:, None] if shared else p.shape[:, :, None] * values
        found.append(np.tensordot(p.functions.T, product, 1))
    return np.concatenate(found)


def basis_of(
    directions: list[ErrorShape], index: int, run: Run, measured: Measured, bias: np.ndarray | None = None
) -> Basis:
    """The basis of one channel of run number ``index``.

    ``bias`` ``(m,)``: standard deviation of a constant added to each column; its coefficient is then the last of the
    column's own.
    """
    t = measured.t
    drift, instants = _drift(t, run.end)
    expected = np.zeros(measured.values.shape)
    largest, unforeseen = np.zeros(expected.shape), np.zeros(expected.shape)
    at, reach = next(((d.at, d.reach) for d in directions if d.at is not None), (np.zeros(0), None))
    slopes = np.zeros((*expected.shape, len(at)))
    nothing = Changes(np.zeros(expected.shape), np.zeros((len(t), 0)), np.zeros(0))
    common, own = [nothing], [nothing]
    for direction in directions:
        shape = direction.shapes[index].get(measured.channel)
        if shape is None:
            continue
        expected += direction.mean * shape
        if direction.slopes:
            slopes += direction.mean * direction.slopes[index][measured.channel]
        for quantity in column_groups(measured):
            group = quantity[np.isfinite(measured.values[:, quantity]).any(axis=0)]
            if not len(group):
                continue
            for part in (Changes(shape[:, group], drift, instants), *_patterns(shape[:, group], t, run.end)):
                wide = np.zeros(shape.shape)
                wide[:, group] = direction.sd * part.shape
                common.append(replace(part, shape=wide))
            largest[:, group] += _largest(_rms(shape[:, group]), t, run.end)[:, None] ** 2
            if direction.unforeseen:
                missed = direction.unforeseen[index][measured.channel][:, group]
                unforeseen[:, group] += _largest(_rms(missed), t, run.end)[:, None] ** 2
        own.append(Changes(direction.sd * shape, drift, instants))
    if directions:
        own.append(Changes(SOLVE.rough_error_share * np.sqrt(largest), drift, instants))
    if bias is not None:
        always = np.ones((len(t), 1))
        own.append(Changes(bias * always, always, np.array([0.5 * run.end])))
    reach = np.full(len(at), np.inf) if reach is None else reach
    rough = np.sqrt(SOLVE.rough_error_share**2 * largest + unforeseen)
    sizes = np.sqrt(largest), np.sqrt(unforeseen)
    return Basis(expected, slopes, at, reach, tuple(common), tuple(own), rough, *sizes)


def credible_error(taken: np.ndarray, basis: Basis, measured: Measured) -> np.ndarray:
    """Of what the most probable coefficients take for the discretisation error of a channel ``(n, m)``, without a bias,
    as much as may be: in no quantity more than ``SOLVE.allowed_error_factor`` times the largest thereabouts, rms over
    the columns.

    Thousands of samples can afford any coefficient, and missing physics that happens to have a shape of the error
    would be taken for it.
    """
    out: np.ndarray = taken.copy()
    for quantity in column_groups(measured):
        group = quantity[np.isfinite(measured.values[:, quantity]).any(axis=0)]
        if len(group):
            size = _rms(np.nan_to_num(taken[:, group]))
            most = SOLVE.allowed_error_factor * basis.largest[:, group[0]]
            out[:, quantity] *= np.minimum(1.0, most / np.maximum(size, np.finfo(float).tiny))[:, None]
    return out


def _hats(t: np.ndarray, end: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Hat functions at the times ``(n, count)``, and their instants [s] ``(count,)``."""
    knots = np.linspace(0.0, max(end, 1e-9), count)
    return np.clip(1.0 - np.abs(t[:, None] - knots) / (knots[1] - knots[0]), 0.0, None), knots


def _drift(t: np.ndarray, end: float, levels: int = len(SOLVE.error_course_levels)) -> tuple[np.ndarray, np.ndarray]:
    """The functions of time that the size of a direction is made of ``(n, l)``, and their instants [s]."""
    functions, instants = [np.ones((len(t), 1))], [np.array([0.5 * end])]
    for count, strength in SOLVE.error_course_levels[:levels]:
        hats, knots = _hats(t, end, count)
        functions.append(strength * hats)
        instants.append(knots)
    return np.concatenate(functions, axis=1), np.concatenate(instants)


def _patterns(shape: np.ndarray, t: np.ndarray, end: float) -> list[Changes]:
    """Changes of an error of a given shape ``(n, m)`` that has its patterns at other times, as large as the largest of
    these thereabouts."""
    drift, instants = _drift(t, end, SOLVE.pattern_levels)
    courses, strengths, components = np.linalg.svd(shape, full_matrices=False)
    kept = np.flatnonzero(
        strengths[: SOLVE.error_patterns] > SOLVE.faint_pattern_share * max(strengths[0], np.finfo(float).tiny)
    )
    sizes = [_largest(np.abs(courses[:, p] * strengths[p]), t, end) for p in kept]
    return [Changes(a[:, None] * components[p], drift, instants) for p, a in zip(kept, sizes, strict=True)]


def _rms(values: np.ndarray) -> np.ndarray:
    """Over the columns ``(n,)``."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=1)))


def _largest(size: np.ndarray, t: np.ndarray, end: float) -> np.ndarray:
    """Largest of positive values ``(n,)`` about each time, in windows of the finest level ``(n,)``."""
    hats, _ = _hats(t, end, SOLVE.error_course_levels[-1][0])
    return np.asarray(hats @ np.max(np.where(hats > 0.0, size[:, None], 0.0), axis=0))
