"""Whitened rows of recordings, and what a ledger has besides a look at effects: closures and named approximations.

The error of mesh, time step, contact and poses are columns of a ledger, with the priors that they have in fits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.comparison import ledger
from sysid.diagnosis.closures import Closure
from sysid.discretisation.approximations import Approximations, of_instants, of_rollouts, of_stamps, principal
from sysid.model.predictor import Prediction
from sysid.model.responses import Modulated
from sysid.solve.named_errors import NamedError, NamedErrors
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
    approximations: tuple[NamedError, ...]
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
    amended = []
    for run, p, more in zip(problem.runs, predictions, further, strict=True):
        derivatives = {}
        for m in run.measured:
            out = np.concatenate([p.derivatives[m.channel][..., index], more[m.channel]], axis=-1)
            derivatives[m.channel] = np.where(np.isnan(p.values[m.channel])[..., None], 0.0, np.nan_to_num(out))
        amended.append(Prediction(p.values, derivatives, p.trace))
    width = next(iter(amended[0].derivatives.values())).shape[-1]
    assembled = problem.assemble(amended, [str(k) for k in range(width)], base.scaled)
    owner = np.concatenate([np.full(len(times), i) for i, _, times in assembled.labels])
    instants = np.concatenate([times for _, _, times in assembled.labels])
    # The rows of a channel are its readings, then the coefficients of what was eliminated.
    readings = np.concatenate(
        [np.arange(len(times)) < base.compared[(i, channel)].there.sum() for i, channel, times in assembled.labels]
    )
    masks = [owner == i for i in range(len(problem.runs))]
    return [Rows(assembled.jacobian[m], assembled.residual[m], instants[m], readings[m]) for m in masks]


def named_errors(
    problem: Problem,
    base: Fitted,
    predictions: Sequence[Prediction],
    drawn: np.ndarray,
    shifted: np.ndarray,
    motions: Sequence[Sequence[Modulated]],
    along: Sequence[Sequence[Prediction]],
    approximations: Approximations,
) -> NamedErrors:
    """All named errors of a problem, those of its poses among them, where a model is fitted. ``drawn``, ``shifted``:
    numbers of the derivatives by motions that the noise of poses leaves open, and by offsets of the hands that stay;
    ``motions``: the former, by recording; ``along``: rollouts along
    the motion that was measured and the first of these."""
    none = [{m.channel: np.zeros((*m.values.shape, 0)) for m in run.measured} for run in problem.runs]
    rows = rows_of(Problem(problem.runs, problem.noise, problem.engine, prior=True), base, predictions, drawn, none)
    kept = [principal(r.jacobian) for r in rows]
    open_, instant = [], []
    for run, p, directions, moved, rolled, jumps in zip(
        problem.runs, predictions, kept, motions, along, approximations.jumps, strict=True
    ):
        found = {m.channel: np.nan_to_num(p.derivatives[m.channel]) for m in run.measured}
        open_.append({c: d[..., drawn] @ directions for c, d in found.items()})
        own = {m.channel: [of_stamps(m.t, p.values[m.channel]), jumps[m.channel]] for m in run.measured}
        if moved:
            for m in run.measured:
                own[m.channel].append(of_instants(m.t, moved, found[m.channel][..., shifted]))
                there = [r.values[m.channel] for r in rolled]
                own[m.channel].append(of_rollouts(found[m.channel][..., drawn], there))
        instant.append({c: np.concatenate(parts, axis=1) for c, parts in own.items()})
    return approximations.with_motions(problem.runs, open_, [d.shape[1] for d in kept], instant)


def free_of(
    problem: Problem,
    base: Fitted,
    predictions: Sequence[Prediction],
    index: np.ndarray,
    closures: Sequence[Closure],
) -> Free:
    """Closures, approximations and blocks of the ledger of a problem. ``index``: of the derivatives by parameters,
    effects and closures."""
    named, blocks = problem.named, []
    assert named is not None
    plain = Problem(problem.runs, problem.noise, problem.engine, prior=True, named=named.instant_alone)
    rows = rows_of(plain, base, predictions, index, named.shapes)
    for run, r in zip(problem.runs, rows, strict=True):
        table = np.column_stack([r.jacobian, r.residual])
        blocks += ledger.blocks_of(run.name, run.end, r.times, r.readings, table)
    return Free(tuple(closures), named.columns, tuple(blocks))
