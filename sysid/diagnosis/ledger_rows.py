"""Whitened rows of recordings, and what a ledger has beside a look at effects: closures and named approximations.

The error of mesh, time step, contact and poses are columns of a ledger, with priors; of errors that are eliminated
beforehand only that is left which careful models differ in without a name (:mod:`sysid.diagnosis.model_tolerance`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.comparison import ledger
from sysid.diagnosis.closures import Closure
from sysid.discretisation.approximations import POSES, Approximation, Approximations, principal
from sysid.model.predictor import Prediction
from sysid.solve.discretisation_basis import MODEL
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


@dataclass(frozen=True)
class Rows:
    """Of one recording: ``jacobian`` ``(n, c)``, ``residual`` ``(n,)``, instants ``times`` [s] ``(n,)``, and which rows
    are ``readings`` ``(n,)`` rather than coefficients of an error that was eliminated."""

    jacobian: np.ndarray
    residual: np.ndarray
    times: np.ndarray
    readings: np.ndarray


@dataclass(frozen=True)
class Free:
    """What a ledger has that a screening has not. ``closures``, ``approximations``: its last columns; ``blocks``: by
    recording and time."""

    closures: tuple[Closure, ...]
    approximations: tuple[Approximation, ...]
    blocks: tuple[ledger.Block, ...]

    @property
    def columns(self) -> list[ledger.Column]:
        """The last columns of the ledger."""
        found = [
            ledger.Column(
                "closure", f"{c.slot.place} {c.slot.name}", c.slot.place, c.slot.words, {}, c.name, "1", 0.0, 1.0,
                False, 0.0, c.sd, False, -np.inf, np.inf,
            )
            for c in self.closures
        ]  # fmt: skip
        found += [
            ledger.Column(
                "approximation", b.owner, "", "", {}, b.name, "1", 0.0, 1.0, False, b.mean, b.sd, False, -np.inf, np.inf
            )
            for b in self.approximations
        ]
        return found


def rows_of(
    problem: Problem,
    base: Fitted,
    predictions: Sequence[Prediction],
    index: np.ndarray,
    further: Sequence[Mapping[str, np.ndarray]],
) -> list[Rows]:
    """Rows of the recordings of a problem. ``index``: of the derivatives that are wanted; ``further``: columns
    ``(n, m, k)`` after these, by recording and channel."""
    beside = []
    for run, p, more in zip(problem.runs, predictions, further, strict=True):
        derivatives = {}
        for m in run.measured:
            out = np.concatenate([p.derivatives[m.channel][..., index], more[m.channel]], axis=-1)
            derivatives[m.channel] = np.where(np.isnan(p.values[m.channel])[..., None], 0.0, np.nan_to_num(out))
        beside.append(Prediction(p.values, derivatives, p.trace))
    width = next(iter(beside[0].derivatives.values())).shape[-1]
    assembled = problem.assemble(beside, [str(k) for k in range(width)], base.scaled)
    owner = np.concatenate([np.full(len(times), i) for i, _, times in assembled.labels])
    instants = np.concatenate([times for _, _, times in assembled.labels])
    # The rows of a channel are its readings, then the coefficients of what was eliminated.
    readings = np.concatenate(
        [np.arange(len(times)) < base.compared[(i, channel)].there.sum() for i, channel, times in assembled.labels]
    )
    masks = [owner == i for i in range(len(problem.runs))]
    return [Rows(assembled.jacobian[m], assembled.residual[m], instants[m], readings[m]) for m in masks]


def free_of(
    problem: Problem,
    base: Fitted,
    predictions: Sequence[Prediction],
    index: np.ndarray,
    drawn: np.ndarray,
    closures: Sequence[Closure],
    approximations: Approximations,
) -> Free:
    """Closures, approximations and blocks of the ledger of a problem. ``index``: of the derivatives by parameters,
    effects and closures; ``drawn``: of those by motions that the noise of poses leaves open."""
    unnamed = [d for d in problem.error_shapes if d.label == MODEL]
    plain = Problem(problem.runs, problem.noise, problem.engine, unnamed, prior=True)
    rows = rows_of(plain, base, predictions, np.concatenate([index, drawn]), approximations.shapes)
    first, last = len(index), len(index) + len(drawn)
    poses = [principal(r.jacobian[:, first:last]) for r in rows]
    named = list(approximations.columns)
    for run, open_ in zip(problem.runs, poses, strict=True):
        named += [Approximation(POSES, f"{run.name}, direction {k + 1}", 0.0, 1.0) for k in range(open_.shape[1])]
    ends, blocks = np.cumsum([0, *(p.shape[1] for p in poses)]), []
    for k, (run, r) in enumerate(zip(problem.runs, rows, strict=True)):
        own = np.zeros((len(r.residual), ends[-1]))
        own[:, ends[k] : ends[k + 1]] = poses[k]
        table = np.column_stack([r.jacobian[:, :first], r.jacobian[:, last:], own, r.residual])
        blocks += ledger.blocks_of(run.name, run.end, r.times, r.readings, table)
    return Free(tuple(closures), tuple(named), tuple(blocks))
