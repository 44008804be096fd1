"""A look at all effects at once: one rollout a recording, then dense linear algebra.

The responses of the readings to every hypothesis (:meth:`sysid.model.predictor.SerialPredictor.predict_responses`) are
whitened together with the residual, its derivatives by the parameters, and the columns of closures and of named
approximations. The products of all of these are the ledger (:mod:`sysid.comparison.ledger`) of the place where a model
is fitted: of the rig alone, or of the rig with a set of effects, whose parameters are parameters like the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from sim_core.errors import ThinshellError
from sysid.comparison.evidence import PLAIN
from sysid.comparison.ledger import AMPLITUDE, SHAPE, Column, Ledger
from sysid.diagnosis.candidates import Hypothesis
from sysid.diagnosis.closures import Closure, Closures
from sysid.diagnosis.ledger_rows import Free, free_of, named_errors
from sysid.diagnosis.slots import place_of
from sysid.discretisation.approximations import Approximations
from sysid.model.parameters import FitParameter
from sysid.model.prediction_source import Responding
from sysid.model.predictor import Prediction
from sysid.solve.named_errors import NamedErrors
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


@dataclass(frozen=True)
class Look:
    """``hypotheses``: those that could be simulated, by effect and label; ``failed``: why others could not be, by
    effect."""

    hypotheses: dict[tuple[str, str], Hypothesis]
    ledger: Ledger
    failed: dict[str, str]

    def start(self, chosen: Sequence[tuple[str, str]], temper: float) -> tuple[list[np.ndarray], np.ndarray]:
        """Factors of the amplitudes of some hypotheses, by effect and label, and the shift ``(p,)`` of the fitted
        parameters, that are most probable within their bounds. ``temper``: divides the weight of the readings."""
        columns, n = self.ledger.columns, len(self.ledger.columns)
        base = [k for k, c in enumerate(columns) if c.kind in PLAIN]
        own = [[k for k, c in enumerate(columns) if (c.owner, c.hypothesis) == pair] for pair in chosen]
        index = np.array([*base, *(k for ks in own for k in ks)])
        sd = np.array([columns[k].prior_sd for k in index])
        mean = np.array([columns[k].prior_mean if columns[k].kind in PLAIN else 0.0 for k in index])
        gram = self.ledger.gram / temper
        quadratic = gram[np.ix_(index, index)] + np.diag(sd**-2.0)
        slope = mean / sd**2 - gram[index, n]
        root = np.linalg.cholesky(quadratic * np.outer(sd, sd)).T
        low = np.array([min(columns[k].lower, -1e-12) for k in index]) / sd
        high = np.array([max(columns[k].upper, 1e-12) for k in index]) / sd
        target = np.linalg.solve(root.T, slope * sd)
        best = lsq_linear(root, target, bounds=(low, high), method="trf").x * sd
        shared = sum(c.kind == "parameter" for c in columns)
        ends = len(base) + np.cumsum([len(ks) for ks in own])
        return np.split(best, [len(base), *ends])[1:-1], best[:shared]


def label_of(hypothesis: Hypothesis, among: Sequence[Hypothesis]) -> str:
    """How a ledger calls the shape of an effect: sizes that are looked at apart are shapes as well, of laws that are
    not linear in them."""
    alike = [x for x in among if (x.effect, x.shape) == (hypothesis.effect, hypothesis.shape)]
    sizes = {a.parameter.name: a.typical for a in hypothesis.amplitudes} if len(alike) > 1 else {}
    return ", ".join([hypothesis.key, *(f"{n} {v:.4g}" for n, v in {**hypothesis.shape, **sizes}.items())])


@dataclass(frozen=True)
class Responses:
    """What a look has found where the baseline stands: ``predictions`` of the recordings whose derivatives are those by
    the parameters ``(shared)``, by the amplitudes of the hypotheses ``kept`` and by closures, at numbers ``own`` and
    ``closed``; ``named``: errors of approximations; ``failed``: why hypotheses could not be simulated, by effect.

    Columns other than those by parameters are taken for the same wherever a model is fitted afterwards."""

    predictions: list[Prediction]
    shared: int
    kept: tuple[Hypothesis, ...]
    own: np.ndarray
    closed: np.ndarray
    closures: tuple[Closure, ...]
    named: NamedErrors
    failed: dict[str, str]

    def look_at(self, problem: Problem, fitted: Fitted, amended: Sequence[Hypothesis] = ()) -> Look:
        """The look from where a model of a problem is fitted, which has the effects of ``amended`` beyond the rig."""
        mine = {h.effect.name for h in amended}
        kept = [h for h in self.kept if h.effect.name not in mine]
        owner = np.repeat(np.arange(len(self.kept)), [len(h.amplitudes) for h in self.kept])
        stays = [self.kept[k].effect.name not in mine for k in owner]
        further = np.concatenate([self.own[stays], self.closed])
        predictions = []
        for there, base in zip(fitted.predictions, self.predictions, strict=True):
            out = {}
            for channel, values in there.values.items():
                own = there.derivatives.get(channel, np.zeros((*values.shape, 0)))
                out[channel] = np.concatenate([own, base.derivatives[channel][..., further]], axis=-1)
            predictions.append(Prediction(there.values, out, there.trace))
        index = np.arange(len(fitted.parameters) + len(further))
        free = free_of(problem, fitted, predictions, index, self.closures)
        found = {(h.effect.name, label_of(h, self.kept)): h for h in kept}
        return Look(found, _ledger(fitted, kept, self.kept, amended, free), self.failed)


def look(
    engine: Responding,
    fitted: Fitted,
    problem: Problem,
    wanted: Sequence[Hypothesis],
    approximations: Approximations,
) -> Responses:
    """Look at hypotheses from a model that is fitted to the recordings of a problem."""
    closures = Closures(fitted.rig, problem, fitted.predictions)
    sized = [column for h in wanted for column in h.columns()]
    motions = [approximations.open_motions(i, r) for i, r in enumerate(problem.runs)]
    offsets = [approximations.offsets(run) for run in problem.runs]
    rolled = [approximations.submit_along(i, r) for i, r in enumerate(problem.runs)]
    jobs = [
        engine.submit_responses(
            fitted.rig, run, fitted.parameters, fitted.scaled, sized, [*moved, *stay, *closures.modulated(run)]
        )
        for run, moved, stay in zip(problem.runs, motions, offsets, strict=True)
    ]
    found = [job.result() for job in jobs]
    shared = len(fitted.parameters)
    ends = shared + len(sized)
    bad = np.zeros(len(sized), dtype=bool)
    for prediction in found:
        for derivatives in prediction.derivatives.values():
            lost = ~np.isfinite(derivatives[..., shared:ends])
            seen = np.isfinite(derivatives[..., :shared]).all(axis=-1) if shared else np.ones(lost.shape[:-1], bool)
            bad |= (lost & seen[..., None]).any(axis=(0, 1))
    owner = np.repeat(np.arange(len(wanted)), [len(h.amplitudes) for h in wanted])
    broken = set(owner[bad])
    kept = tuple(h for k, h in enumerate(wanted) if k not in broken)
    own = np.array([shared + k for k in range(len(sized)) if owner[k] not in broken], dtype=int)
    drawn = ends + np.arange(max(map(len, motions), default=0))
    found = [closures.append(run, p) for run, p in zip(problem.runs, found, strict=True)]
    shifted = ends + len(drawn) + np.arange(max(map(len, offsets), default=0))
    closed = ends + len(drawn) + len(shifted) + np.arange(len(closures.columns))
    names = {h.effect.name for h in kept}
    failed = {h.effect.name: "could not be simulated" for k, h in enumerate(wanted) if k in broken}
    failed = {n: why for n, why in failed.items() if n not in names} | approximations.failed
    along = [_followed(jobs) for jobs in rolled]
    named = named_errors(problem, fitted, found, drawn, shifted, motions, along, approximations)
    return Responses(found, shared, kept, own, closed, tuple(closures.columns), named, failed)


def _followed(jobs: Sequence[Future[Prediction]]) -> list[Prediction]:
    """Some rollouts up to the first one that could not be simulated."""
    found = []
    with suppress(ThinshellError):
        for job in jobs:
            found.append(job.result())
    return found


def _ledger(
    fitted: Fitted,
    kept: Sequence[Hypothesis],
    among: Sequence[Hypothesis],
    amended: Sequence[Hypothesis],
    free: Free,
) -> Ledger:
    """All that was looked at, as a value that is written to a file."""
    pulls = fitted.residual[len(fitted.residual) - fitted.pulls :] if fitted.pulls else np.zeros(len(fitted.scaled))
    columns = []
    for p, at, pull in zip(fitted.parameters, fitted.scaled, pulls, strict=True):
        sd = p.known_sd or p.prior_sd
        low, high = (end - at for end in p.scaled_bounds)
        columns.append(
            Column(
                "parameter", *_owned(p, amended), {}, p.name, p.unit, float(at), 1.0, p.log, float(-pull * sd),
                float(sd), False, float(low), float(high),
            )
        )  # fmt: skip
    for h in kept:
        label = label_of(h, among)
        for a in h.amplitudes:
            # An amplitude that vanishes at infinity has one value, and its factor says how much of its response.
            at, scale = (a.none, a.typical - a.none) if np.isfinite(a.none) else (a.typical, 0.0)
            low, high = a.limits
            columns.append(
                Column(
                    "concealed" if h.drawn else "effect", h.effect.name, place_of(h.effect), label, dict(h.shape),
                    a.parameter.name, a.parameter.unit, float(at), float(scale), False, 0.0, float(a.sd),
                    low >= 0.0, float(low), float(high),
                )
            )  # fmt: skip
    return Ledger((*columns, *free.columns), free.blocks, {})


def _owned(parameter: FitParameter, amended: Sequence[Hypothesis]) -> tuple[str, str, str]:
    """Owner, place and part of the column of a parameter: the parameter itself, or the effect that it belongs to."""
    for h in amended:
        if parameter.target.startswith(f"effects.{h.key}."):
            name = parameter.target.rsplit(".", 1)[1]
            sizes = [a.parameter.name for a in h.amplitudes if np.isfinite(a.none) and not a.parameter.log]
            return h.effect.name, place_of(h.effect), AMPLITUDE if name in sizes else SHAPE
    return parameter.name, "", ""
