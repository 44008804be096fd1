"""Fits that allow for the discretisation error, which is measured by refinement where the fit stands.

The error of mesh and time step depends on the parameters, and the best parameters on what is taken for
error, so both are found in turns: measure at theta_k, fit, measure at theta_{k+1}. Such turns creep where
the two resemble each other (a coarse gel slides later, so does one with more friction). Near the solution the
refined simulations are therefore differentiated as well, and the fit uses

    d(theta) = d(theta_k) + D (theta - theta_k),    D = d'(theta_k),

within ``DISCRETISATION.slopes_reach`` of where they were measured. What the next measurement shows apart from that is
unforeseen: the refined simulation snaps over a moment earlier or later than before. Readings are weighed down by it
there (:meth:`sysid.solve.discretisation_basis.ErrorShape.following`), or turns would go on from one side to the other.
Far from the solution, where a search is to be followed by another one anyway, derivatives say little of where that will
lead. They lead a search, but intervals learn nothing from them (:func:`sysid.solve.covariance.uncertainty`): how large
the error is, is not known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace

import numpy as np

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.model.parameters import FitParameter, rig_in, start_of
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import quantities
from sysid.observations.observations import Run
from sysid.settings.discretisation import DISCRETISATION
from sysid.solve.covariance import uncertainty
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.interruption import ENDS_EARLY, end_unconverged
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

MESH, TIME_STEP = "mesh", "time step"
"""Label of the error shape of the mesh."""

Minimise = Callable[[Problem, np.ndarray], Fitted]
"""A search for the minimum of a problem from given scaled values."""


class Unmeasured(ThinshellError):
    """The error of mesh and time step cannot be measured where a search has ended, with the problem that has the error
    measured before and what was found, as not converged."""

    def __init__(self, cause: ThinshellError, last_problem: Problem, fitted: Fitted) -> None:
        super().__init__(cause.problem, cause.remedy)
        end_unconverged(fitted, cause, "it stands where its discretisation error is not known")
        self.last_problem, self.fitted = last_problem, fitted


def discretisation(
    engine: AnyEngine,
    rig: Rig | Sequence[Rig],
    runs: Sequence[Run],
    plain: Sequence[Prediction] | None = None,
    mesh: ErrorShape | None = None,
) -> list[ErrorShape]:
    """How the predictions change when the mesh, and when the time step, is refined once.

    ``rig``: one for all runs, or one for each; ``plain``: its predictions as it is, where they are at hand; ``mesh``:
    the error of the mesh, where it is known.

    The true error is about 2^p / (2^p - 1) of these differences, with the order p of the mesh
    (``DISCRETISATION.mesh_order``) and of the rig's integrator; the shapes are scaled accordingly. Raises
    ``ThinshellError`` where a refined simulation fails.
    """
    rigs = rig if isinstance(rig, Sequence) else [rig] * len(runs)
    pairs = list(zip(rigs, runs, strict=True))
    pending = [engine.submit(there, run) for there, run in pairs] if plain is None else []
    fine = [engine.submit(there, run, 2) for there, run in pairs] if mesh is None else []
    short = [engine.submit(there, run, 1, 0.5 * there.solver.dt_s) for there, run in pairs]
    base = plain or [_outcome(f, run, "as it is") for f, run in zip(pending, runs, strict=True)]
    if mesh is not None:
        return [mesh, *_error_shapes(rigs, runs, base, None, short)]
    return _error_shapes(rigs, runs, base, fine, short)


def error_of_coarser_cells(fine: Sequence[Prediction], coarse: Sequence[Prediction], finer: float) -> ErrorShape:
    """The error of the mesh of predictions ``fine`` from those on a coarser one, the cells of which are ``finer`` times
    as wide: y* - y_h = (y_h - y_H) / ((H / h)^p - 1)."""
    shapes, sight = [], []
    for here, there in zip(fine, coarse, strict=True):
        change = {c: (v - there.values[c]) / (finer**DISCRETISATION.mesh_order - 1.0) for c, v in here.values.items()}
        sight.append({c: np.isfinite(d) for c, d in change.items()})
        shapes.append({c: np.where(np.isfinite(d), d, 0.0) for c, d in change.items()})
    return ErrorShape(MESH, tuple(shapes), sight=tuple(sight))


def discretisation_with_slopes(
    engine: AnyEngine,
    rig: Rig,
    runs: Sequence[Run],
    plain: Sequence[Prediction],
    parameters: Sequence[FitParameter],
    scaled: np.ndarray,
) -> list[ErrorShape]:
    """The same at scaled values ``(p,)`` of ``parameters``, with its derivatives by them; ``plain``: with derivatives.

    Raises ``ThinshellError`` where a refined simulation fails.
    """
    at = (parameters, scaled)
    fine = [engine.submit_with_derivatives(rig, run, *at, 2) for run in runs]
    short = [engine.submit_with_derivatives(rig, run, *at, 1, 0.5 * rig.solver.dt_s) for run in runs]
    reach = np.array([DISCRETISATION.slopes_reach * p.prior_sd for p in parameters])
    return [replace(d, at=scaled, reach=reach) for d in _error_shapes([rig] * len(runs), runs, plain, fine, short)]


def _error_shapes(
    rigs: Sequence[Rig],
    runs: Sequence[Run],
    base: Sequence[Prediction],
    fine: Sequence[Future[Prediction]] | None,
    short: Sequence[Future[Prediction]],
) -> list[ErrorShape]:
    found = []
    for label, how, orders, pending in (
        (MESH, "on a finer mesh", [DISCRETISATION.mesh_order] * len(rigs), fine),
        (TIME_STEP, "with half the time step", [rig.solver.order for rig in rigs], short),
    ):
        if pending is None:
            continue
        refined = [_outcome(f, run, how) for f, run in zip(pending, runs, strict=True)]
        three = list(zip(refined, base, orders, strict=True))
        shapes = tuple(_error(r.values, b.values, p) for r, b, p in three)
        slopes = tuple(_error(r.derivatives, b.derivatives, p) for r, b, p in three if r.derivatives)
        sight = tuple({c: np.isfinite(v - b.values[c]) for c, v in r.values.items()} for r, b, _ in three)
        found.append(ErrorShape(label, shapes, slopes=slopes, sight=sight))
    return found


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


def _error(refined: dict[str, np.ndarray], base: dict[str, np.ndarray], order: int) -> dict[str, np.ndarray]:
    """Extrapolated from what halving the size of a method of some order changes; 0 where either is out of sight, or not
    a number."""
    factor = 2.0**order / (2.0**order - 1.0)
    found = {c: factor * (values - base[c]) for c, values in refined.items()}
    return {c: np.where(np.isfinite(d), d, 0.0) for c, d in found.items()}


def fit_with_discretisation_error(
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
    rounds: int = DISCRETISATION.error_rounds,
    search: Minimise | None = None,
) -> tuple[Problem, Fitted]:
    """Fit ``parameters`` of ``rig``; the problem holds the discretisation error measured at the solution.

    ``plain``: the predictions where the fit starts, where they are at hand.

    A search that came so far that the error is another one (``Fitted.elsewhere``) is followed by another round.
    ``Fitted.converged`` is false, and its message says so, when the rounds ended before both settled.
    Once a search has ended, Ctrl-C, a later search that fails, and a limit to the evaluations of ``search`` keep the
    best so far, with the error last measured. Raises :class:`Unmeasured` where the error cannot be measured where a
    search has ended.
    """
    scaled = start_of(rig, parameters) if start is None else np.asarray(start, dtype=float)
    look = search or (lambda problem, at: problem.fit(rig, parameters, start=at))

    def each(at: np.ndarray) -> list[Rig]:
        return [rig_in(rig, parameters, at, run.name) for run in runs]

    error_shapes = discretisation(engine, each(scaled), runs, plain)
    problem = Problem(runs, noise, engine, error_shapes, prior, bias)
    evaluations, with_slopes = 0, False
    known: Fitted | None = None
    for left in reversed(range(rounds)):
        try:
            fitted = look(problem, scaled)
        except ENDS_EARLY as error:
            if known is None:
                raise
            end_unconverged(
                known, error, "the search did not go on with the error of mesh and time step where it stands"
            )
            return problem, _counted(known, evaluations)
        evaluations += fitted.evaluations
        moved = np.abs(fitted.scaled - scaled)
        scaled = fitted.scaled
        settled = not fitted.elsewhere and bool(np.all(moved <= DISCRETISATION.remeasured_sd * uncertainty(fitted).sd))
        if fitted.cut_short or (settled and (with_slopes or not parameters)):
            return problem, _counted(fitted, evaluations)
        if not left:
            break
        with_slopes = not fitted.elsewhere
        try:
            if with_slopes:
                at = (parameters, scaled)
                found = discretisation_with_slopes(engine, rig, runs, fitted.predictions, *at)
            else:
                found = discretisation(engine, each(scaled), runs, fitted.predictions)
        except KeyboardInterrupt:
            fitted.interrupt()
            return problem, _counted(fitted, evaluations)
        except ThinshellError as error:
            raise Unmeasured(error, problem, _counted(fitted, evaluations)) from error
        error_shapes = [now.following(then, scaled) for now, then in zip(found, error_shapes, strict=True)]
        problem = Problem(runs, noise, engine, error_shapes, prior, bias)
        known = problem.compare(fitted.predictions, rig, parameters, scaled)
        problem.keep(known)
    if fitted.converged or fitted.elsewhere:
        fitted.message = (
            f"the error of mesh and time step still changed with the parameters after {rounds} rounds; a finer "
            "mesh (cells) or a shorter step (solver.dt_s) makes it smaller"
        )
    fitted.converged = False
    return problem, _counted(fitted, evaluations)


def large_discretisation_errors(problem: Problem) -> list[str]:
    """A sentence for each quantity in which the error of mesh and time step is far above the noise."""
    return [
        f"The error of mesh and time step in the {quantity} of {channel} may be {max(ratios):.0f} times the noise. "
        "Intervals rest on what one refinement shows of it and may be too narrow: use finer cells or a shorter "
        "solver.dt_s."
        for (channel, quantity), (_, ratios) in _sizes(problem).items()
        if max(ratios) > DISCRETISATION.loud_error_ratio
    ]


def coarse_quantities(problem: Problem) -> tuple[str, ...]:
    """A sentence for each quantity in which the error of mesh and time step is too large to ask what is missing."""
    ranges: dict[tuple[str, str], float] = {}
    for m in (m for run in problem.runs for m in run.measured):
        for quantity, group in quantities(m):
            seen = m.values[:, group][:, np.isfinite(m.values[:, group]).any(axis=0)]
            span = float(np.max(np.nanmax(seen, axis=0) - np.nanmin(seen, axis=0), initial=0.0))
            ranges[m.channel, quantity] = max(span, ranges.get((m.channel, quantity), 0.0))
    return tuple(
        f"The error of mesh and time step in the {quantity} of {channel} is {100.0 * max(sizes) / span:.0f} % of its "
        f"range, {max(ratios):.0f} times the noise; below {100.0 * DISCRETISATION.coarse_range_share:.0f} % is needed."
        for (channel, quantity), (sizes, ratios) in _sizes(problem).items()
        if (span := ranges[channel, quantity]) > 0.0
        and max(sizes) > DISCRETISATION.coarse_range_share * span
        and max(ratios) > DISCRETISATION.coarse_noise_ratio
    )


def error_sizes(problem: Problem) -> dict[tuple[str, str], float]:
    """Root mean square of the error of mesh and time step by channel and quantity, measured units: the largest of all
    runs."""
    return {key: max(sizes) for key, (sizes, _) in _sizes(problem).items()}


def _sizes(problem: Problem) -> dict[tuple[str, str], tuple[list[float], list[float]]]:
    """Root mean square of that error by channel and quantity, one a run: measured units, and over the noise."""
    found: dict[tuple[str, str], tuple[list[float], list[float]]] = {}
    for i, run in enumerate(problem.runs):
        for m in run.measured:
            noise = problem.noise[m.channel].sigma
            whole = np.sum([d.shapes[i].get(m.channel, 0.0 * m.values) for d in problem.refined], axis=0)
            seen = np.where(np.isfinite(m.values), whole, np.nan)
            for quantity, group in quantities(m):
                if np.isfinite(seen[:, group]).any():
                    both = found.setdefault((m.channel, quantity), ([], []))
                    for sizes, values in zip(both, (seen[:, group], (seen / noise)[:, group]), strict=True):
                        sizes.append(float(np.sqrt(np.nanmean(values**2))))
    return found


def unresolved_quantities(problem: Problem) -> list[str]:
    """A sentence for each quantity of a run that counts little where its discretisation error changes unforeseen."""
    said = []
    for i, run in enumerate(problem.runs):
        for m in run.measured:
            basis, sigma = problem.basis(i, m), problem.noise[m.channel].sigma
            little = basis.doubtful(problem.noise[m.channel]) & np.isfinite(m.values)
            for quantity, group in quantities(m):
                when = m.t[little[:, group].any(axis=1)]
                if len(when):
                    apart = np.max((basis.unforeseen / sigma)[:, group][little[:, group]])
                    said.append(
                        f"The {quantity} of {m.channel} in {run.name} counts little between {when[0]:.2f} and "
                        f"{when[-1]:.2f} s: with nearly the same parameters a finer mesh or a shorter step is there on "
                        f"either of two sides, up to {apart:.0f} times the noise apart. A gentler motion or finer "
                        "cells would tell."
                    )
    return said


def _counted(fitted: Fitted, evaluations: int) -> Fitted:
    fitted.evaluations = evaluations
    return fitted
