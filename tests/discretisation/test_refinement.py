"""Rounds of measuring the discretisation error and fitting with it: on a model with a known solution."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from discretisation_model import NOISE, PARAMETERS, SIGMA, TRUTH, Linear, T, Vector, coarse, fit, measured, run_of

from sim_core.errors import ConvergenceError
from sim_core.rigs import parse_rig
from sim_core.rigs.schema import Solver
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, Trace
from sysid.diagnosis.residual_analysis import block_scores
from sysid.discretisation import refinement as discretisation_error
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.predictor import Prediction
from sysid.observations.observations import Run
from sysid.solve.covariance import uncertainty
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.residuals import Problem
from sysid.uncertainty.goodness_of_fit import misfit_by_quantity


def test_parameters_and_error_settle_together(vectors: None) -> None:
    problem, fitted = fit(Linear(), run_of(measured(np.random.default_rng(0))))
    assert fitted.converged, fitted.message
    known = uncertainty(fitted)
    assert np.all(np.abs(fitted.scaled - TRUTH) < 3.0 * known.sd)
    at_truth = problem.corrected(fitted, 0, problem.runs[0].measured[0])
    assert np.sqrt(np.mean((at_truth - problem.runs[0].measured[0].values) ** 2)) < 1.3 * SIGMA


class Polynomial(Linear):
    """An engine whose readings are off by the step to the power of the integrator's order."""

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        off = 7.0 * (dt or rig.solver.dt_s) ** (2 if rig.solver.integrator == "bdf2" else 1)
        future.set_result(Prediction({"gauge": coarse(TRUTH) + off}, {}, cast(Trace, None)))
        return future


def test_the_error_of_the_time_step_is_extrapolated_by_the_order_of_each_rigs_integrator(small_rig: Any) -> None:
    """So that what is found in addition to the readings is what they are with no step at all."""
    dt = 0.02
    rigs = [small_rig(solver={"dt_s": dt, "integrator": name}) for name in ("implicit_euler", "bdf2")]
    runs = [run_of(coarse(TRUTH))] * 2
    _, step = discretisation_error.discretisation(cast(ParallelPredictor, Polynomial()), rigs, runs)
    for shape, off in zip(step.shapes, (7.0 * dt, 7.0 * dt**2), strict=True):
        np.testing.assert_allclose(shape["gauge"], -off, rtol=1e-9)


def hanging(integrator: str, steps: int) -> np.ndarray:
    """Where the nodes of a bar are that swings from a hinge for 0.2 s."""
    bar = {
        "type": "affine",
        "shape": {"type": "box", "size_m": [0.1, 0.01, 0.01]},
        "pose": {"position_m": [0.05, 0.0, 0.0]},
        "material": {"density_kg_m3": 7800.0},
    }
    hinge = {"type": "hinge", "body": "bar", "to": "world", "at_m": [-0.05, 0.0, 0.0], "axis": [0.0, 1.0, 0.0]}
    dt = 0.2 / steps
    rig = parse_rig(
        {"name": "bar", "solver": {"dt_s": dt, "integrator": integrator}, "bodies": {"bar": bar}, "joints": [hinge]},
        "bar",
    )
    simulation = Simulation(build_scene(rig), settle=False)
    for _ in range(steps):
        simulation.step({}, dt)
    return np.array(simulation.state.x)


@pytest.mark.parametrize(("integrator", "order"), [("implicit_euler", 1), ("bdf2", 2)])
def test_the_order_is_that_of_rollouts(integrator: str, order: int) -> None:
    ends = [hanging(integrator, steps) for steps in (40, 80, 160)]
    changes = [np.linalg.norm(ends[k + 1] - ends[k]) for k in range(2)]
    assert np.log2(changes[0] / changes[1]) == pytest.approx(order, abs=0.2)
    assert Solver(integrator=cast(Any, integrator)).order == order
    assert Solver(integrator=cast(Any, integrator), inertia=False).order == 1


def test_slopes_save_rounds(vectors: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error is linear in the parameters: with its slopes what is expected of it is known everywhere."""
    run = run_of(measured(np.random.default_rng(0)))
    quick = Linear()
    fit(quick, run, rounds=40)
    blind = discretisation_error.discretisation_with_slopes
    monkeypatch.setattr(
        discretisation_error,
        "discretisation_with_slopes",
        lambda *given: [replace(d, slopes=()) for d in blind(*given)],
    )
    slow = Linear()
    fit(slow, run, rounds=40)
    assert 1 < quick.refined < slow.refined


def test_an_error_that_stays_as_it_was_measured_needs_no_other_round(vectors: None) -> None:
    """The search comes from far, and the error is the same where it ends: it is measured at both ends alone."""
    error = 0.3 * coarse(np.array([0.4, 1.0]))
    engine = Linear(lambda x: error)
    _, fitted = fit(engine, run_of(coarse(TRUTH) + 0.5 * error))
    assert fitted.converged and fitted.scaled == pytest.approx(TRUTH, abs=1e-3)
    assert engine.refined == 2


WINDOW = ((T > 0.4) & (T < 0.57))[:, None] * np.array([[1.0, -0.5]])
SNAP = 60.0 * SIGMA


class Snapping(Linear):
    """For a sixth of the run the refined simulation is on either of two sides, with next to no change of the
    parameters; its derivatives, as real ones, are those of the side where it is."""

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        return self._snapped(super().submit(rig, run, refine, dt), rig.x, refine)

    def submit_with_derivatives(
        self, rig: Any, run: Run, parameters: Any, scaled: np.ndarray, refine: int = 1, dt: float | None = None
    ) -> Future[Prediction]:
        return self._snapped(super().submit_with_derivatives(rig, run, parameters, scaled, refine, dt), scaled, refine)

    def _snapped(self, future: Future[Prediction], x: np.ndarray, refine: int) -> Future[Prediction]:
        if refine > 1:
            future.result().values["gauge"] += SNAP * np.sign(np.sin(900.0 * x.sum())) * WINDOW
        return future


def test_an_error_that_snaps_over_does_not_keep_the_rounds_going(vectors: None) -> None:
    """The recording is on one side."""
    error = 0.1 * coarse(np.array([0.4, 1.0]))
    settled, inside = [], []
    for seed in range(40):
        side = 0.5 / 0.75 * SNAP * (-1) ** seed * WINDOW
        noise = SIGMA * np.random.default_rng(seed).standard_normal((len(T), 2))
        _, fitted = fit(Snapping(lambda x: error), run_of(coarse(TRUTH) + 0.5 * error + side + noise))
        settled.append(fitted.converged)
        inside.append(np.abs(fitted.scaled - TRUTH) < 1.96 * uncertainty(fitted).sd)
    assert np.mean(settled) >= 0.9 and np.mean(inside) > 0.8, (np.mean(settled), np.mean(inside))


def test_what_slopes_foresee_is_not_unforeseen() -> None:
    """Within their reach; the largest of what was missed is kept."""
    at, slopes = np.array([1.0]), np.full((4, 2, 1), 3.0)
    before = ErrorShape(
        "mesh", ({"gauge": np.ones((4, 2))},), slopes=({"gauge": slopes},), at=at, reach=np.array([0.5])
    )
    jump = np.zeros((4, 2))
    jump[2] = 0.7, -0.2
    after = ErrorShape("mesh", ({"gauge": np.ones((4, 2)) + 3.0 * 0.1 + jump},), slopes=before.slopes, at=at + 0.1)
    near = after.following(before, at + 0.1)
    np.testing.assert_allclose(near.unforeseen[0]["gauge"], np.abs(jump), atol=1e-12)
    calm = replace(after, shapes=({"gauge": after.shapes[0]["gauge"] + 3.0 * 0.1},))
    np.testing.assert_allclose(calm.following(near, at + 0.2).unforeseen[0]["gauge"], np.abs(jump), atol=1e-12)
    assert after.following(before, at + 0.6).unforeseen == ()
    hidden = np.ones((4, 2), dtype=bool)
    hidden[2, 0] = False
    there = replace(before, sight=({"gauge": hidden},))
    assert after.following(there, at + 0.1).unforeseen[0]["gauge"].max() == pytest.approx(0.2)


def test_where_the_error_changes_unforeseen_nothing_is_judged_and_that_is_said(vectors: None) -> None:
    """A miss of forty times the noise in a sixth of the run."""
    values = np.where(WINDOW != 0.0, 40.0 * SIGMA, 0.0) + SIGMA * np.random.default_rng(0).standard_normal((len(T), 2))
    run = run_of(coarse(TRUTH) + values)
    shape = 0.1 * np.column_stack([np.sin(9 * T), np.cos(7 * T)])
    found = {}
    for name, unforeseen in (("calm", ()), ("snapping", ({"gauge": 80.0 * SIGMA * np.abs(WINDOW)},))):
        known = ErrorShape("mesh", ({"gauge": shape},), unforeseen=unforeseen)
        problem = Problem([run], NOISE, cast(ParallelPredictor, None), [known])
        judged = problem.judged(0, run.measured[0], run.measured[0].values - coarse(TRUTH))
        found[name] = np.isfinite(judged), discretisation_error.unresolved_quantities(problem)
        prediction = Prediction({"gauge": coarse(TRUTH)}, {}, cast(Trace, None))
        fitted = problem.compare([prediction], cast(Any, Vector(TRUTH)), [], np.zeros(0))
        (left,) = misfit_by_quantity(problem, fitted)
        assert left.samples == np.isfinite(judged).sum()
        blocks = block_scores(run, run.measured[0], judged)[0]
    assert found["calm"][0].all() and not found["calm"][1]
    there, said = found["snapping"]
    assert np.isfinite(blocks).sum() < blocks.size
    assert not there[(T > 0.4) & (T < 0.57)].any() and there[(T < 0.3) | (T > 0.67)].all()
    assert len(said) == 1 and "position of gauge in run counts little between 0.3" in said[0]


def test_rounds_that_end_too_soon_are_said(vectors: None) -> None:
    _, fitted = fit(Linear(), run_of(measured(np.random.default_rng(0))), rounds=1)
    assert not fitted.converged
    assert "finer mesh" in fitted.message


def test_a_search_that_wants_the_error_measured_again_gets_it(vectors: None) -> None:
    run = run_of(measured(np.random.default_rng(0)))
    _, settled = fit(Linear(), run, rounds=40)
    calls = 0

    def search(problem: Problem, at: np.ndarray) -> Any:
        nonlocal calls
        calls += 1
        found = problem.fit(cast(Any, Vector(np.zeros(2))), PARAMETERS, start=at)
        found.elsewhere = calls < 4
        found.converged = not found.elsewhere
        return found

    _, fitted = fit(Linear(), run, start=settled.scaled, search=search)
    # Once more when it has been measured with slopes, which says little where a search is to go on.
    assert calls == 5 and fitted.converged
    calls = 0
    _, never = fit(Linear(), run, start=settled.scaled, search=search, rounds=3)
    assert calls == 3 and not never.converged
    assert "finer mesh" in never.message


@pytest.mark.parametrize("highest", [50.0, TRUTH[0] - 0.1])
def test_no_prediction_is_made_twice_where_a_round_begins(vectors: None, highest: float) -> None:
    """Not at a bound either, at which the first parameter stays."""
    parameters = [replace(PARAMETERS[0], upper=highest), PARAMETERS[1]]
    engine = Linear()
    looked: list[tuple[float, ...]] = []
    plain = engine.predict_all

    def predict_all(rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        looked.append(tuple(np.round(scaled, 6)))
        return plain(rig, runs, parameters, scaled)

    engine.predict_all = predict_all  # type: ignore[method-assign]
    _, fitted = fit(engine, run_of(measured(np.random.default_rng(0))), parameters, rounds=40)
    assert engine.refined > 1, "there is one round only"
    assert len(set(looked)) == len(looked)
    assert fitted.converged and (fitted.scaled[0] == highest) == (highest < 50.0)


def test_ctrl_c_keeps_the_best(vectors: None) -> None:
    engine = Linear()
    run = run_of(measured(np.random.default_rng(0)))
    calls = 0

    def search(problem: Problem, at: np.ndarray) -> Any:
        nonlocal calls
        calls += 1
        if calls == 2:
            engine.predict_all = _interrupted(engine)  # type: ignore[method-assign]
        return problem.fit(cast(Any, Vector(np.zeros(2))), PARAMETERS, start=at)

    _, fitted = fit(engine, run, search=search)
    assert fitted.interrupted and not fitted.converged
    assert np.all(np.isfinite(fitted.scaled)) and np.abs(fitted.scaled).max() > 0.1


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ConvergenceError("No.")], ids=["ctrl-c", "failed"])
def test_a_later_search_that_fails_keeps_what_was_found(error: BaseException, vectors: None) -> None:
    """Where it stands, with the error measured there."""
    found = []

    def search(problem: Problem, at: np.ndarray) -> Any:
        if found:
            raise error
        found.append(problem.fit(cast(Any, Vector(np.zeros(2))), PARAMETERS, start=at))
        return found[0]

    engine, run = Linear(), run_of(measured(np.random.default_rng(0)))
    problem, fitted = fit(engine, run, search=search)
    assert engine.refined == 2 and not fitted.converged and "did not go on" in fitted.message
    assert fitted.interrupted == isinstance(error, KeyboardInterrupt)
    np.testing.assert_array_equal(fitted.scaled, found[0].scaled)
    there = problem.evaluate(cast(Any, Vector(np.zeros(2))), PARAMETERS, fitted.scaled)
    assert fitted.chi2 == pytest.approx(there.chi2) and fitted.evaluations == found[0].evaluations
    with pytest.raises(type(error)):
        fit(engine, run, search=search)


def _interrupted(engine: Linear) -> Any:
    """Predicts once more and is then interrupted."""
    left = [1]
    plain = engine.predict_all

    def predict_all(*given: Any) -> list[Prediction]:
        if not left:
            raise KeyboardInterrupt
        left.pop()
        return plain(*given)

    return predict_all
