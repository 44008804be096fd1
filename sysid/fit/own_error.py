"""Fits beside the simulator's own error, which is measured by refinement where the fit stands.

The error of mesh and time step depends on the parameters, and the best parameters on what is taken for
error, so both are found in turns: measure at theta_k, fit, measure at theta_{k+1}. Such turns creep where
the two resemble each other (a coarse gel slides later, so does one with more friction). The change of the
error with the parameters is therefore learnt on the way by Broyden's rank-one update (Broyden 1965),

    D <- D + (d(theta_{k+1}) - d(theta_k) - D s) v^T / (v^T s),    s = theta_{k+1} - theta_k,  v = J^T J s,

in the metric of the data, and the fit uses d(theta) = d(theta_k) + D (theta - theta_k).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace

import numpy as np

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.fit.directions import Direction
from sysid.fit.engine import Prediction
from sysid.fit.fitted import Fitted
from sysid.fit.noise import ChannelNoise, quantities
from sysid.fit.parameters import FitParameter, rig_in, start_of
from sysid.fit.pool import AnyEngine
from sysid.fit.problem import Problem
from sysid.fit.runs import Run
from sysid.fit.uncertainty import uncertainty

MOST_ROUNDS = 8
"""Times that the error is measured and the fit repeated."""

SETTLED = 0.5
"""Rounds end when no parameter that is asked for has moved by this many standard deviations, or will beside the error
measured last."""

LOUD = 10.0
"""Error of mesh and time step over noise from which a result says that it rests on that error."""

Minimise = Callable[[Problem, np.ndarray], Fitted]
"""A search for the minimum of a problem from given scaled values."""


class Unmeasured(ThinshellError):
    """The error of mesh and time step cannot be measured where a search has ended, with the problem beside the error
    measured before and what was found, as not converged."""

    def __init__(self, cause: ThinshellError, beside: Problem, fitted: Fitted) -> None:
        super().__init__(cause.problem, cause.remedy)
        fitted.message, fitted.converged = f"it stands where its own error is not known. {cause}", False
        self.beside, self.fitted = beside, fitted


def discretisation(
    engine: AnyEngine, rig: Rig | Sequence[Rig], runs: Sequence[Run], plain: Sequence[Prediction] | None = None
) -> list[Direction]:
    """How the predictions change when the mesh, and when the time step, is refined once.

    ``rig``: one for all runs, or one for each; ``plain``: its predictions as it is, where they are at hand.

    The true error is about 4/3 (mesh, order two) and twice (step, order one) of these differences; the
    directions are scaled accordingly. Raises ``ThinshellError`` where a refined simulation fails.
    """
    rigs = rig if isinstance(rig, Sequence) else [rig] * len(runs)
    pairs = list(zip(rigs, runs, strict=True))
    pending = [engine.submit(there, run) for there, run in pairs] if plain is None else []
    fine = [engine.submit(there, run, 2) for there, run in pairs]
    short = [engine.submit(there, run, 1, 0.5 * there.solver.dt_s) for there, run in pairs]
    base = plain or [_outcome(f, run, "as it is") for f, run in zip(pending, runs, strict=True)]
    finer = [_outcome(f, run, "on a finer mesh") for f, run in zip(fine, runs, strict=True)]
    shorter = [_outcome(f, run, "with half the time step") for f, run in zip(short, runs, strict=True)]
    return [
        Direction("mesh", tuple(_difference(f, b, 4.0 / 3.0) for f, b in zip(finer, base, strict=True))),
        Direction("time step", tuple(_difference(s, b, 2.0) for s, b in zip(shorter, base, strict=True))),
    ]


def _outcome(future: Future[Prediction], run: Run, how: str) -> Prediction:
    """The prediction; a failure says what it was for."""
    try:
        return future.result()
    except ThinshellError as error:
        raise type(error)(
            f"While measuring the error of mesh and time step, {run.name} could not be simulated {how}: "
            f"{error.problem}",
            error.remedy,
        ) from error


def _difference(refined: Prediction, base: Prediction, factor: float) -> dict[str, np.ndarray]:
    return {c: factor * np.nan_to_num(refined.values[c] - v) for c, v in base.values.items()}


def fit_beside_own_error(
    engine: AnyEngine,
    runs: Sequence[Run],
    noise: dict[str, ChannelNoise],
    rig: Rig,
    parameters: Sequence[FitParameter],
    *,
    start: np.ndarray | None = None,
    plain: Sequence[Prediction] | None = None,
    prior: bool = False,
    bias: bool = False,
    rounds: int = MOST_ROUNDS,
    search: Minimise | None = None,
) -> tuple[Problem, Fitted]:
    """Fit ``parameters`` of ``rig``; the problem holds the own error measured at the solution.

    ``plain``: the predictions where the fit starts, where they are at hand.

    A search that came so far that the error is another one (``Fitted.elsewhere``) is followed by another round.
    ``Fitted.converged`` is false, and its message says so, when the rounds ended before both settled.
    Ctrl-C, and a limit to the evaluations of ``search``, keep the best so far, beside the error last measured.
    Raises :class:`Unmeasured` where the error cannot be measured where a search has ended.
    """
    scaled = start_of(rig, parameters) if start is None else np.asarray(start, dtype=float)
    look = search or (lambda problem, at: problem.fit(rig, parameters, start=at))

    def each(at: np.ndarray) -> list[Rig]:
        return [rig_in(rig, parameters, at, run.name) for run in runs]

    directions = discretisation(engine, each(scaled), runs, plain)
    problem = Problem(runs, noise, engine, directions, prior, bias)
    asked = np.array([not p.nuisance for p in parameters], dtype=bool)
    evaluations, seconds, settled = 0, 0.0, False
    for _ in range(rounds):
        fitted = look(problem, scaled)
        evaluations += fitted.evaluations
        seconds += fitted.seconds
        if fitted.cut_short:
            return problem, _counted(fitted, evaluations, seconds)
        step = fitted.scaled - scaled
        try:
            measured = discretisation(engine, each(fitted.scaled), runs, fitted.predictions)
        except KeyboardInterrupt:
            fitted.message, fitted.converged = "interrupted; the best values so far are kept", False
            return problem, _counted(fitted, evaluations, seconds)
        except ThinshellError as error:
            raise Unmeasured(error, problem, _counted(fitted, evaluations, seconds)) from error
        scaled = fitted.scaled
        still = _small(step, fitted, asked)
        # What is known of the slopes belongs to the derivatives: where error and readings change alike less is known.
        pairs = zip(directions, measured, strict=True)
        directions = [_carried(old, new, scaled) if still else _learnt(old, new, step, fitted) for old, new in pairs]
        problem = Problem(runs, noise, engine, directions, prior, bias)
        final = problem.compare(fitted.predictions, rig, parameters, scaled)
        problem.keep(final)
        settled = not fitted.elsewhere and (still or _small(_gauss_newton(final), final, asked))
        if settled:
            break
    final.message, final.converged = fitted.message, fitted.converged and settled
    if (fitted.converged or fitted.elsewhere) and not settled:
        final.message = (
            f"the error of mesh and time step still changed with the parameters after {rounds} rounds; a finer "
            "mesh (cells) or a shorter step (solver.dt_s) makes it smaller"
        )
    return problem, _counted(final, evaluations, seconds)


def _small(step: np.ndarray, fitted: Fitted, asked: np.ndarray) -> bool:
    """No parameter that is asked for moves by more than :data:`SETTLED`."""
    return bool(np.all((np.abs(step) <= SETTLED * uncertainty(fitted).sd)[asked]))


def _gauss_newton(fitted: Fitted) -> np.ndarray:
    """The step to where the fit would be best by the derivatives at hand."""
    return np.asarray(-np.linalg.lstsq(fitted.jacobian, fitted.residual, rcond=None)[0])


def loud(problem: Problem) -> list[str]:
    """A sentence for each quantity in which the error of mesh and time step is far above the noise."""
    found: dict[tuple[str, str], list[float]] = {}
    for i, run in enumerate(problem.runs):
        for m in run.measured:
            noise = problem.noise[m.channel].sigma
            whole = np.sum([d.shapes[i].get(m.channel, 0.0 * m.values) for d in problem.directions], axis=0)
            relative = np.where(np.isfinite(m.values), whole / noise, np.nan)
            for quantity, group in quantities(m):
                if np.isfinite(relative[:, group]).any():
                    ratio = float(np.sqrt(np.nanmean(relative[:, group] ** 2)))
                    found.setdefault((m.channel, quantity), []).append(ratio)
    return [
        f"The error of mesh and time step in the {quantity} of {channel} may be {max(ratios):.0f} times the noise. "
        "Intervals rest on what one refinement shows of it and may be too narrow: use finer cells or a shorter "
        "solver.dt_s."
        for (channel, quantity), ratios in found.items()
        if max(ratios) > LOUD
    ]


def _carried(old: Direction, new: Direction, scaled: np.ndarray) -> Direction:
    """The newly measured direction with the slopes known before."""
    return replace(new, slopes=old.slopes, at=scaled) if old.slopes else new


def _learnt(old: Direction, new: Direction, step: np.ndarray, fitted: Fitted) -> Direction:
    """The newly measured direction with what the step has taught of its slope.

    A step that changes no reading teaches nothing; the direction is then as measured.
    """
    metric = fitted.jacobian.T @ (fitted.jacobian @ step)
    length = float(metric @ step)
    if not (np.isfinite(length) and length > 0.0):
        return new
    weight = metric / length
    slopes = []
    for i, (before, after) in enumerate(zip(old.shapes, new.shapes, strict=True)):
        known = old.slopes[i] if old.slopes else {c: np.zeros((*a.shape, len(step))) for c, a in after.items()}
        slopes.append({c: known[c] + (a - before[c] - known[c] @ step)[:, :, None] * weight for c, a in after.items()})
    return replace(new, slopes=tuple(slopes), at=fitted.scaled)


def _counted(fitted: Fitted, evaluations: int, seconds: float) -> Fitted:
    fitted.evaluations, fitted.seconds = evaluations, seconds
    return fitted
