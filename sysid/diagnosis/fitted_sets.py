"""Sets of effects fitted together with the rig, each from where the linearised model says.

Laws are not linear in their amplitudes, so sets that hold nearly all of the probability are fitted, and compared where
they are. A fit begins where the ledger's most probable amplitudes are, with the rig's fitted numbers and with those it
was given: near a snap, or where the baseline has taken up part of an effect, one linear step does not lead back.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from sim_core.effects import RecordingScales
from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.comparison.ledger import Ledger
from sysid.diagnosis.baseline import (
    Baseline,
    with_all_named_errors,
    with_fit,
    with_own_derivatives,
    with_steps_that_it_follows,
    without_mistakes_of,
)
from sysid.diagnosis.candidates import Hypothesis, hypotheses
from sysid.diagnosis.error_turns import fitted_from, settled
from sysid.diagnosis.look import Look, Responses, look
from sysid.discretisation.approximations import Approximations
from sysid.io.checkpoints import Checkpoints
from sysid.model.parameters import FitParameter, fit_parameters, rig_in, start_of
from sysid.model.predictor import Prediction
from sysid.model.space_mapping import SpaceMappedPredictor
from sysid.observations.observations import Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.settings.solve import SOLVE
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

Shapes = tuple[tuple[str, str], ...]
"""Effects, each with the label of one of its shapes in a ledger."""


@dataclass(frozen=True)
class FittedSet:
    """The rig with a set of effects beyond it, empty for the baseline. ``problem``: that it was fitted to; ``there``:
    the model on the recordings held out, None without any; ``seen``: the look at all other effects from there;
    ``measured_at``: scaled values ``(p,)`` at which its errors of mesh and time step were measured, None where they are
    the baseline's."""

    hypotheses: tuple[Hypothesis, ...]
    problem: Problem
    fitted: Fitted
    there: Fitted | None
    seen: Look
    measured_at: np.ndarray | None = None

    @property
    def identity(self) -> object:
        """What it is known by among the sets of a diagnosis."""
        return self.names, self.fitted.scaled, *_errors(self.problem)

    @property
    def names(self) -> tuple[str, ...]:
        """Effects of the set."""
        return tuple(sorted(h.effect.name for h in self.hypotheses))

    @property
    def title(self) -> str:
        """The effects in words, as clauses."""
        return " and that ".join(h.effect.title for h in self.hypotheses)

    @property
    def misfit(self) -> float:
        """Mean squared residual, in units of the noise, that the model leaves of the recordings given."""
        return self.fitted.misfit

    @property
    def ledger(self) -> Ledger:
        """Of the model linearised there."""
        return self.seen.ledger


@dataclass(frozen=True)
class _Start:
    """Where a fit begins. ``centre``: rig that the priors pull to; ``scaled`` ``(p,)``: in the fitted scale; ``like``:
    a problem whose errors hold there, which were measured at ``measured_at``, None: that of the baseline."""

    hypotheses: tuple[Hypothesis, ...]
    centre: Rig
    parameters: list[FitParameter]
    scaled: np.ndarray
    like: Problem | None = None
    measured_at: np.ndarray | None = None

    @property
    def identity(self) -> object:
        """What it is known by among the starts of a diagnosis."""
        errors = None if self.like is None else _errors(self.like)
        return self.hypotheses, self.centre, self.parameters, self.scaled, errors, self.measured_at


class SetFits:
    """Fits of sets of effects to the recordings of a baseline. ``failed``: why some were not possible, by what was
    tried; ``done``: the sets that were fitted, in the order in which they were. ``kept``: holds what was found before
    where a diagnosis was interrupted."""

    def __init__(
        self,
        base: Baseline,
        scales: RecordingScales,
        shapes: Sequence[Hypothesis] = (),
        kept: Checkpoints | None = None,
    ) -> None:
        self._kept, self._scales = kept or Checkpoints(), scales
        wanted = [*hypotheses(base.fitted.rig, scales), *shapes]

        def looked() -> tuple[Responses, Baseline]:
            approximations = Approximations(base.engine, base.fitted, base.problem)
            responses = look(base.engine, base.fitted, base.problem, wanted, approximations)
            return responses, with_all_named_errors(base, responses.named)

        self._responses, self._base = self._kept.stage("effects", looked, base, wanted)
        self.failed = dict(self._responses.failed)
        self.baseline = self._without_effects()
        self.done = [self.baseline]

    @property
    def base(self) -> Baseline:
        """The baseline with all named errors."""
        return self._base

    def _without_effects(self) -> FittedSet:
        base = self._base
        seen = self._responses.look_at(base.problem, base.fitted)
        return FittedSet((), base.problem, base.fitted, base.there, seen, base.measured_at)

    def without_mistakes_of(self, best: FittedSet, fitted: Sequence[FittedSet]) -> list[FittedSet] | None:
        """All sets, of which the baseline is the first, fitted on without the readings that are mistakes by the
        residuals of the ``best``; None where they are those that are left out already. Those of a model that is far off
        hide them."""
        predictions = best.fitted.predictions
        base = self._kept.stage("mistakes", lambda: without_mistakes_of(self._base, predictions), self._base, best)
        if base is None:
            return None
        self._base = base
        self.baseline = self._without_effects()
        with ThreadPoolExecutor(max(1, len(fitted) - 1)) as threads:
            again = list(threads.map(self._fitted_on, fitted[1:]))
        return [self.baseline, *(one for one in again if one is not None)]

    def with_steps_that_it_follows(self, best: FittedSet) -> list[Run]:
        """The recordings given, those that could not tell their time steps with the ones that they follow by the
        ``best`` set; empty where these are the rig's."""
        return self._kept.stage("steps", lambda: with_steps_that_it_follows(self._base, best.fitted), self._base, best)

    def _fitted_on(self, one: FittedSet) -> FittedSet | None:
        """A set fitted on to the recordings of the baseline from where it stands."""
        return self._fitted(_from(one, one.fitted.scaled), (), " and ".join(one.names))

    def with_error_where_it_stands(self, one: FittedSet) -> FittedSet:
        """A set fitted on with the errors of mesh and time step as they are where it stands: what a law adds to them
        the baseline, which is without it, does not show. The set as it is where they were measured there."""
        found = self._kept.stage("errors", lambda: self._settled(one), self._base, one)
        return found if isinstance(found, FittedSet) else one

    def _settled(self, one: FittedSet) -> FittedSet | str:
        """As :meth:`with_error_where_it_stands`, made now, or why it stays as it is."""
        problem = self._like(one.problem)
        problem, fitted, at = settled(problem, one.fitted, self._base.reference, one.measured_at)
        if at is one.measured_at:
            return "the errors were measured where it stands"
        return self._finished(problem, fitted, at, one.hypotheses)

    def _like(self, other: Problem | None) -> Problem:
        """The problem of the baseline with the errors, and what a reference model adds, of another one."""
        base = self._base.problem
        if other is None:
            return base
        assert other.named is not None
        found = base.with_named(other.named)
        found.engine = other.engine
        return found

    def promising(self, begun: FittedSet, wanted: Sequence[Shapes], temper: float, count: int) -> list[Shapes]:
        """Of some sets those that simulations explain best where their fits would begin."""
        if len(wanted) <= count:
            return list(wanted)
        starts = [start for shapes in wanted for start in self._starts(begun, shapes, temper)[:1]]
        left = self._kept.stage("glance", lambda: self._glance(starts), self._base, starts)
        order = np.argsort(left)[:count]
        return [wanted[k] for k in order if np.isfinite(left[k])]

    def fit(self, begun: FittedSet, wanted: Sequence[Shapes], temper: float) -> FittedSet | None:
        """A set of effects fitted together with those of ``begun``, from the best of several starts, each with shapes
        from a look at it; None, and why in ``failed``, where that cannot be simulated."""
        name = " and ".join(e for e, _ in wanted[0])
        starts = [start for shapes in wanted for start in self._starts(begun, shapes, temper)]
        left = self._kept.stage("glance", lambda: self._glance(starts), self._base, starts)
        if not np.isfinite(left).any():
            self.failed[name] = "could not be simulated"
            return None
        return self._fitted(starts[int(np.argmin(left))], begun.hypotheses, name)

    def fit_without(self, begun: FittedSet, effect: str) -> FittedSet | None:
        """A set of several effects without one of them, fitted on from where the set stands (backward elimination);
        None, and why in ``failed``, where that cannot be simulated."""
        fitted = begun.fitted
        gone = next(h for h in begun.hypotheses if h.effect.name == effect)
        kept = tuple(h for h in begun.hypotheses if h is not gone)
        mine = np.array([not p.target.startswith(f"effects.{gone.key}.") for p in fitted.parameters])
        centre = fitted.centre.model_copy(
            update={"effects": {k: v for k, v in fitted.centre.effects.items() if k != gone.key}}
        )
        parameters = [p for p, stays in zip(fitted.parameters, mine, strict=True) if stays]
        start = _Start(kept, centre, parameters, fitted.scaled[mine], begun.problem)
        return self._fitted(start, (), " and ".join(h.effect.name for h in kept))

    def fitted_from(self, one: FittedSet, whole: FittedSet) -> FittedSet:
        """A set fitted again from where another one stands that has its effects and more, if that leaves less."""
        there = dict(zip((p.target for p in whole.fitted.parameters), whole.fitted.scaled, strict=True))
        fitted = one.fitted
        name = " and ".join(one.names)
        again = self._fitted(_from(one, np.array([there[p.target] for p in fitted.parameters])), (), name)
        self.failed.pop(name, None)  # It is fitted, whatever became of this.
        if again is None or again.fitted.residual @ again.fitted.residual >= fitted.residual @ fitted.residual:
            return one
        if not one.hypotheses:
            other = again.fitted
            self._base = self._kept.stage("baseline again", lambda: with_fit(self._base, other), self._base, again)
            self.baseline = again = self._without_effects()
        return again

    def _fitted(self, start: _Start, before: tuple[Hypothesis, ...], name: str) -> FittedSet | None:
        """What a fit from a start comes to, whose model has the effects of ``before`` as well; None, and why in
        ``failed``, where it comes to nothing."""
        found = self._kept.stage(f"set {name}", lambda: self._fit_from(start, before), self._base, start, before)
        if isinstance(found, str):
            self.failed[name] = found
            return None
        self.done.append(found)
        return found

    def _fit_from(self, start: _Start, before: tuple[Hypothesis, ...]) -> FittedSet | str:
        """As :meth:`_fitted`, made now, or why it comes to nothing."""
        problem, at = self._like(start.like), start.measured_at
        reference = self._base.reference
        try:
            fitted = fitted_from(problem, start.centre, start.parameters, start.scaled, DIAGNOSIS.refit_evaluations)
            if reference is not None:  # What it adds to the readings hangs on the model far more than other errors do.
                problem, fitted, at = settled(problem, fitted, reference, at, rounds=1)
        except ThinshellError as error:
            return f"could not be simulated: {error}"
        return self._finished(problem, fitted, at, (*before, *start.hypotheses))

    def _finished(
        self, problem: Problem, fitted: Fitted, at: np.ndarray | None, whole: tuple[Hypothesis, ...]
    ) -> FittedSet | str:
        """A fit with derivatives of its own, held out recordings, and a look at all else, or why it is no model of the
        recordings."""
        base = self._base
        if fitted.samples < SOLVE.in_sight_share * base.fitted.samples:
            return "it moves readings out of sight"
        try:
            fitted = with_own_derivatives(problem, fitted)
            seen = self._responses.look_at(problem, fitted, whole)
            there = base.check.evaluate(fitted.rig, [], np.zeros(0)) if base.check.runs else None
        except ThinshellError as error:
            return f"could not be simulated: {error}"
        return FittedSet(whole, problem, fitted, there, seen, at)

    def _starts(self, begun: FittedSet, shapes: Shapes, temper: float) -> list[_Start]:
        """From where the most probable amplitudes lead, and with the rig's own numbers."""
        chosen = tuple(begun.seen.hypotheses[pair] for pair in shapes)
        factors, shift = begun.seen.start(shapes, temper)
        fitted = begun.fitted
        home = start_of(fitted.centre, fitted.parameters)
        home = np.where([p.target.startswith("effects.") for p in fitted.parameters], fitted.scaled, home)
        return [self._start(fitted, chosen, factors, at) for at in (fitted.scaled + shift, home)]

    def _start(
        self, begun: Fitted, chosen: tuple[Hypothesis, ...], factors: Sequence[np.ndarray], scaled: np.ndarray
    ) -> _Start:
        values = {h.key: h.values(list(f)) for h, f in zip(chosen, factors, strict=True)}
        rig = begun.rig.model_copy(update={"effects": {**begun.rig.effects, **values}})
        own = self._parameters(rig, chosen)
        parameters = [*begun.parameters, *own]
        limits = np.array([p.scaled_bounds for p in parameters]).T
        at = np.clip(np.concatenate([scaled, start_of(rig, own)]), *limits)
        centre = begun.centre.model_copy(update={"effects": {**begun.centre.effects, **_at_rest(values, chosen)}})
        return _Start(chosen, centre, parameters, at)

    def _parameters(self, rig: Rig, chosen: Sequence[Hypothesis]) -> list[FitParameter]:
        """The parameters of effects, with priors that fit the recordings."""
        found = []
        for h in chosen:
            by_name = {p.name: p.fitted_to(self._scales) for p in h.effect.parameters}
            names = [n for n in rig.effects[h.key] if by_name[n].lower < by_name[n].upper]
            for p in fit_parameters(rig, [f"effects.{h.key}.{n}" for n in names]):
                found.append(replace(p, prior_sd=by_name[p.target.rsplit(".", 1)[1]].prior_sd))
        return found

    def _glance(self, starts: Sequence[_Start]) -> np.ndarray:
        """What simulations at some starts leave after one linear step of the baseline's parameters."""
        problem, base = self._base.problem, self._base.fitted
        jobs = [self._begun(s) for s in starts]
        found = []
        for s, row in zip(starts, jobs, strict=True):
            try:
                predictions = [job.result() for job in row or ()]
                found.append(_least(base, problem.assemble(predictions, [], s.scaled).residual) if row else np.inf)
            except ThinshellError:
                found.append(np.inf)
        return np.array(found)

    def _begun(self, start: _Start) -> list[Future[Prediction]] | None:
        """Rollouts of the recordings at a start; None where its effects act on nothing, as where friction is zero."""
        problem = self._base.problem
        try:
            rigs = [rig_in(start.centre, start.parameters, start.scaled, run.name) for run in problem.runs]
            return [problem.engine.submit(rig, run) for rig, run in zip(rigs, problem.runs, strict=True)]
        except ThinshellError:
            return None


def _errors(problem: Problem) -> tuple[object, object]:
    """Errors of a problem, and what a reference model adds."""
    return problem.named, cast(SpaceMappedPredictor, problem.engine).added


def _from(one: FittedSet, scaled: np.ndarray) -> _Start:
    """A start of the fit of a set that is fitted already."""
    fitted = one.fitted
    return _Start(one.hypotheses, fitted.centre, list(fitted.parameters), scaled, one.problem, one.measured_at)


def _least(base: Fitted, residual: np.ndarray) -> float:
    """Least chi-square of a whitened residual along the derivatives of the baseline, within what is known of its
    parameters; its chi-square where other readings are in sight than there."""
    data = len(base.residual) - base.pulls
    if len(residual) != data or not base.parameters:
        return float(residual @ residual)
    j = base.jacobian[:data]
    known = np.array([p.known_sd or p.prior_sd for p in base.parameters])
    slope = j.T @ residual
    return float(residual @ residual - slope @ np.linalg.solve(j.T @ j + np.diag(1.0 / known**2), slope))


def _at_rest(values: dict[str, dict[str, float]], chosen: Sequence[Hypothesis]) -> dict[str, dict[str, float]]:
    """Values that the priors pull to: amplitudes at nothing, if a fit can stand there."""
    found = {}
    for h in chosen:
        mine = dict(values[h.key])
        for a in h.amplitudes:
            if np.isfinite(a.none) and not a.parameter.log:
                mine[a.parameter.name] = a.none
        found[h.key] = mine
    return found
