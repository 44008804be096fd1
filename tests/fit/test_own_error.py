"""The simulator's own error as a nuisance: on models with a known answer."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.simulate import Trace
from sysid.fit import own_error
from sysid.fit.directions import LEVELS, PATTERN_LEVELS, RIGHT_SD, ROUGH, Direction, basis_of
from sysid.fit.engine import Prediction
from sysid.fit.fitted import Fitted
from sysid.fit.leftover import left_over
from sysid.fit.noise import ChannelNoise
from sysid.fit.own_error import fit_beside_own_error, loud
from sysid.fit.parameters import FitParameter
from sysid.fit.pool import PooledEngine
from sysid.fit.problem import Problem
from sysid.fit.runs import Measured, Run
from sysid.fit.uncertainty import uncertainty
from sysid.mismatch.locate import block_scores, structure

T = np.linspace(0.0, 1.0, 120)
SIGMA = 0.01
NOISE = {"gauge": ChannelNoise(np.array([SIGMA, SIGMA]), 0.0, "test")}
PARAMETERS = [FitParameter(n, "-", False, -50.0, 50.0, 5.0, "") for n in ("a", "b")]
TRUTH = np.array([1.3, -0.4])


def coarse(x: np.ndarray) -> np.ndarray:
    """Readings of the model as it is solved."""
    return np.column_stack([x[0] * T + x[1] * np.sin(3 * T), x[0] * np.cos(2 * T) - x[1] * T**2])


def own(x: np.ndarray) -> np.ndarray:
    """Its error, which changes with the parameters nearly as the readings do."""
    return 0.7 * coarse(x - np.array([0.8, 0.1])) + 0.05 * np.column_stack([np.sin(9 * T), np.cos(7 * T)])


def run_of(values: np.ndarray) -> Run:
    measured = Measured("gauge", "markers", T, values, ("u", "v"))
    return Run("run", "", (), {}, (measured,), 1.0)


class Linear:
    """An engine whose rigs are the parameters themselves."""

    def __init__(self, error: Any = own) -> None:
        self.error = error
        self.refined = 0

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        values = self._refined(rig.x, refine)
        self.refined += refine > 1
        future.set_result(Prediction({"gauge": values}, {}, cast(Trace, None)))
        return future

    def _refined(self, x: np.ndarray, refine: int) -> np.ndarray:
        return np.asarray(coarse(x) + (0.75 * self.error(x) if refine > 1 else 0.0))

    def submit_with_derivatives(
        self, rig: Any, run: Run, parameters: Any, scaled: np.ndarray, refine: int = 1, dt: float | None = None
    ) -> Future[Prediction]:
        self.refined += refine > 1
        ends = [[self._refined(scaled + s * e, refine) for s in (1e-4, -1e-4)] for e in np.eye(2)]
        slopes = np.stack([(ahead - behind) / 2e-4 for ahead, behind in ends], axis=-1)
        future: Future[Prediction] = Future()
        future.set_result(Prediction({"gauge": self._refined(scaled, refine)}, {"gauge": slopes}, cast(Trace, None)))
        return future

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        x = scaled if len(parameters) else rig.x
        slopes = np.stack([coarse(e) for e in np.eye(2)], axis=-1)
        return [Prediction({"gauge": coarse(x)}, {"gauge": slopes}, cast(Trace, None)) for _ in runs]


class Vector:
    """Stands for a rig: its parameters, and the step of its solver."""

    class Solver:
        dt_s = 0.01

    solver = Solver()

    def __init__(self, x: np.ndarray) -> None:
        self.x = np.asarray(x, dtype=float)


@pytest.fixture
def vectors(monkeypatch: pytest.MonkeyPatch) -> None:
    def rig_at(rig: Vector, parameters: Any, scaled: np.ndarray, bag: str = "") -> Vector:
        return Vector(scaled if len(scaled) else rig.x)

    for module, name in (("sysid.fit.problem", "rig_at"), ("sysid.fit.own_error", "rig_in")):
        monkeypatch.setattr(f"{module}.{name}", rig_at)
        monkeypatch.setattr(f"{module}.start_of", lambda rig, parameters: rig.x)


def measured(rng: np.random.Generator, share: float = 0.5) -> np.ndarray:
    return coarse(TRUTH) + share * own(TRUTH) + SIGMA * rng.standard_normal((len(T), 2))


def fit(engine: Linear, run: Run, **settings: Any) -> Any:
    return fit_beside_own_error(
        cast(PooledEngine, engine), [run], NOISE, cast(Any, Vector(np.zeros(2))), PARAMETERS, **settings
    )


def test_parameters_and_error_settle_together(vectors: None) -> None:
    problem, fitted = fit(Linear(), run_of(measured(np.random.default_rng(0))))
    assert fitted.converged, fitted.message
    known = uncertainty(fitted)
    assert np.all(np.abs(fitted.scaled - TRUTH) < 3.0 * known.sd)
    at_truth = problem.corrected(fitted, 0, problem.runs[0].measured[0])
    assert np.sqrt(np.mean((at_truth - problem.runs[0].measured[0].values) ** 2)) < 1.3 * SIGMA


def test_slopes_save_rounds(vectors: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error is linear in the parameters: with its slopes what is expected of it is known everywhere."""
    run = run_of(measured(np.random.default_rng(0)))
    quick = Linear()
    fit(quick, run, rounds=40)
    blind = own_error.discretisation_with_slopes
    monkeypatch.setattr(
        own_error, "discretisation_with_slopes", lambda *given: [replace(d, slopes=()) for d in blind(*given)]
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
    before = Direction("mesh", ({"gauge": np.ones((4, 2))},), slopes=({"gauge": slopes},), at=at, reach=np.array([0.5]))
    jump = np.zeros((4, 2))
    jump[2] = 0.7, -0.2
    after = Direction("mesh", ({"gauge": np.ones((4, 2)) + 3.0 * 0.1 + jump},), slopes=before.slopes, at=at + 0.1)
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
        direction = Direction("mesh", ({"gauge": shape},), unforeseen=unforeseen)
        problem = Problem([run], NOISE, cast(PooledEngine, None), [direction])
        judged = problem.judged(0, run.measured[0], run.measured[0].values - coarse(TRUTH))
        found[name] = np.isfinite(judged), own_error.doubtful(problem)
        prediction = Prediction({"gauge": coarse(TRUTH)}, {}, cast(Trace, None))
        fitted = problem.compare([prediction], cast(Any, Vector(TRUTH)), [], np.zeros(0))
        (left,) = left_over(problem, fitted)
        assert left.samples == np.isfinite(judged).sum()
        blocks = block_scores(run, run.measured[0], judged)[0]
        assert structure(problem, fitted).whole.count == np.isfinite(blocks).sum()
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
def test_no_prediction_is_made_twice_where_a_round_begins(
    vectors: None, highest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not at a bound either, at which the first parameter stays."""
    monkeypatch.setitem(globals(), "PARAMETERS", [replace(PARAMETERS[0], upper=highest), PARAMETERS[1]])
    engine = Linear()
    looked: list[tuple[float, ...]] = []
    plain = engine.predict_all

    def predict_all(rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        looked.append(tuple(np.round(scaled, 6)))
        return plain(rig, runs, parameters, scaled)

    engine.predict_all = predict_all  # type: ignore[method-assign]
    _, fitted = fit(engine, run_of(measured(np.random.default_rng(0))), rounds=40)
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


def _interrupted(engine: Linear) -> Any:
    """Answers once more and is then interrupted."""
    left = [1]
    plain = engine.predict_all

    def predict_all(*given: Any) -> list[Prediction]:
        if not left:
            raise KeyboardInterrupt
        left.pop()
        return plain(*given)

    return predict_all


def test_intervals_hold_the_truth_as_often_as_they_say(vectors: None) -> None:
    """Errors drawn from the very prior, 300 recordings: 95 % intervals hold in 91 to 98 % of them."""
    rng = np.random.default_rng(5)
    shape = own(TRUTH)
    direction = Direction("mesh", ({"gauge": shape},))
    knots = [(np.linspace(0.0, 1.0, count), strength) for count, strength in LEVELS]
    hats = [a * np.clip(1.0 - np.abs(T[:, None] - k) * (len(k) - 1), 0.0, None) for k, a in knots]
    fine = hats[-1] > 0.0
    variances, turned = np.linalg.eigh(shape.T @ shape)
    assert variances.min() > 0.0
    courses = shape @ turned
    about = hats[-1] / LEVELS[-1][1] @ np.max(np.where(fine[:, :, None], np.abs(courses)[:, None], 0.0), axis=0)

    def drift(levels: int = len(LEVELS)) -> np.ndarray:
        return np.asarray(rng.standard_normal() + sum(h @ rng.standard_normal(h.shape[1]) for h in hats[:levels]))

    inside = np.zeros(2)
    for _ in range(300):
        drifts = [drift() for _ in range(3)]
        size = 0.5 + RIGHT_SD * (drifts[0][:, None] + np.column_stack(drifts[1:]))
        others = RIGHT_SD * (about * np.column_stack([drift(PATTERN_LEVELS) for _ in range(2)])) @ turned.T
        values = coarse(TRUTH) + size * shape + others + SIGMA * rng.standard_normal((len(T), 2))
        problem = Problem([run_of(values)], NOISE, cast(PooledEngine, Linear()), [direction])
        fitted = problem.fit(cast(Any, Vector(np.zeros(2))), PARAMETERS)
        inside += np.abs(fitted.scaled - TRUTH) < 1.96 * uncertainty(fitted).sd
    assert np.all((inside > 0.91 * 300) & (inside < 0.98 * 300)), inside


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_an_error_without_the_shape_is_allowed_for(vectors: None, rho: float) -> None:
    """Where the known error passes through zero, the true one is there all the same: it weighs samples down."""
    rng = np.random.default_rng(8)
    shape, rms = np.column_stack([np.sin(60 * T), np.cos(60 * T)]), 0.5**0.5
    direction = Direction("mesh", ({"gauge": shape},))
    inside = np.zeros(2)
    for _ in range(100):
        values = coarse(TRUTH) + 0.5 * shape + rms * ROUGH * rng.standard_normal((len(T), 2))
        noise = {"gauge": ChannelNoise(NOISE["gauge"].sigma, rho, "test")}
        problem = Problem([run_of(values)], noise, cast(PooledEngine, Linear()), [direction])
        fitted = problem.fit(cast(Any, Vector(np.zeros(2))), PARAMETERS)
        assert fitted.misfit < 1.5
        inside += np.abs(fitted.scaled - TRUTH) < 1.96 * uncertainty(fitted).sd
    assert np.all(inside >= 90), inside


def beside_a_fast_error(n: int, errors: np.ndarray | float, amplitude: float = 1.0) -> Fitted:
    """The two parameters at the truth, by ``n`` samples of eight columns beside an own error of a given ``amplitude``
    that oscillates faster than its size drifts, in each column otherwise; the readings are off by ``errors``
    ``(n, 8)``."""
    t, j = np.linspace(0.0, 1.0, n)[:, None], np.arange(8)
    slopes = np.stack([np.cos(0.7 * j * t + j), np.sin(1.1 * j * t + 1.0)], axis=-1)
    shape = amplitude * np.sin((250.0 + 20.0 * j) * t)
    values = slopes @ TRUTH + 0.5 * shape + errors
    run = Run("run", "", (), {}, (Measured("gauge", "markers", t[:, 0], values, tuple("abcdefgh")),), 1.0)
    noise = {"gauge": ChannelNoise(np.full(8, SIGMA), np.zeros(8), "test")}
    problem = Problem([run], noise, cast(PooledEngine, None), [Direction("mesh", ({"gauge": shape},))])
    there = Prediction({"gauge": slopes @ TRUTH}, {"gauge": slopes}, cast(Trace, None))
    return problem.compare([there], cast(Any, Vector(np.zeros(2))), PARAMETERS, TRUTH)


def test_an_error_without_the_shape_may_stay_for_a_while(vectors: None) -> None:
    """It is drawn anew 23 times in a run, not from sample to sample."""
    n, rng = 1200, np.random.default_rng(9)
    block = np.minimum((np.linspace(0.0, 1.0, n) * 23).astype(int), 22)
    scores = []
    for _ in range(100):
        fitted = beside_a_fast_error(n, 0.5**0.5 * ROUGH * rng.standard_normal((23, 8))[block])
        miss = np.linalg.lstsq(fitted.jacobian, fitted.residual, rcond=None)[0]
        scores.append(miss / uncertainty(fitted).sd)
    assert np.std(scores, axis=0) == pytest.approx(np.ones(2), abs=0.3)


def test_intervals_beside_an_own_error_do_not_shrink_with_the_rate(vectors: None) -> None:
    few, many = beside_a_fast_error(1200, 0.0), beside_a_fast_error(4800, 0.0)
    alone = [uncertainty(beside_a_fast_error(n, 0.0, 1e-9)).sd for n in (1200, 4800)]
    assert alone[1] == pytest.approx(0.5 * alone[0], rel=0.01), "by noise alone they do"
    assert uncertainty(many).sd == pytest.approx(uncertainty(few).sd, rel=0.2)


def test_where_error_and_readings_change_alike_less_is_known(vectors: None) -> None:
    """An error of -c/2 that changes with the parameters as the readings c do takes a quarter of the derivatives, in the
    mean of its sizes."""
    problem, fitted = fit(Linear(lambda x: -0.5 * coarse(x)), run_of(coarse(TRUTH)))
    blind = [replace(d, slopes=(), at=None) for d in problem.directions]
    plain = Problem(problem.runs, NOISE, problem.engine, blind).compare(
        fitted.predictions, cast(Any, Vector(np.zeros(2))), PARAMETERS, fitted.scaled
    )
    wider = uncertainty(fitted).sd / uncertainty(plain).sd
    assert np.max(wider) == pytest.approx(1.0 / 0.75, rel=0.05)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_what_only_the_error_depends_on_is_not_determined(
    vectors: None, monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    """Readings depend on the first parameter, the error on the second, and nobody knows how much of it there is."""
    monkeypatch.setattr(f"{__name__}.coarse", lambda x: x[0] * np.column_stack([T, np.cos(2.0 * T)]))

    def ripple(x: np.ndarray) -> np.ndarray:
        return 0.05 * np.column_stack([np.sin(60.0 * T + x[1]), np.cos(60.0 * T + x[1])])

    rng = np.random.default_rng(4)
    readings = coarse(TRUTH) + share * ripple(TRUTH) + SIGMA * rng.standard_normal((len(T), 2))
    _, fitted = fit(Linear(ripple), run_of(readings))
    assert fitted.still is not None, "its slopes are known"
    known = uncertainty(fitted)
    assert abs(fitted.scaled[0] - TRUTH[0]) < 1.96 * known.sd[0] < 0.1
    assert any(said.startswith("The data do not determine b:") for said in known.sentences)


def test_slopes_are_believed_near_where_they_were_measured() -> None:
    shape, slopes = np.ones((len(T), 2)), np.full((len(T), 2, 2), 3.0)
    direction = Direction(
        "mesh", ({"gauge": shape},), slopes=({"gauge": slopes},), at=TRUTH, reach=np.array([0.1, 0.2])
    )
    basis = basis_of([direction], 0, run_of(shape), run_of(shape).measured[0])
    near, far = TRUTH + [0.05, -0.1], TRUTH + [0.05, -9.0]
    assert basis.mean_error(near)[0, 0] == pytest.approx(direction.mean * (1.0 + 3.0 * (0.05 - 0.1)))
    assert basis.mean_error(far)[0, 0] == pytest.approx(direction.mean * (1.0 + 3.0 * (0.05 - 0.2)))
    assert basis.follows(near).tolist() == [1.0, 1.0] and basis.follows(far).tolist() == [1.0, 0.0]


def test_readings_after_a_gap_are_whitened_like_the_error_in_them(vectors: None) -> None:
    """Beside an error of ten times the noise, a tenth of the readings missing: what is left is noise."""
    rng, rho = np.random.default_rng(2), np.array([0.9, 0.9])
    t = np.linspace(0.0, 1.0, 400)
    coloured = np.zeros((len(t), 2))
    for k in range(len(t)):
        coloured[k] = rho * coloured[max(k - 1, 0)] + np.sqrt(1.0 - rho**2) * rng.standard_normal(2)
    shape = np.full((len(t), 2), 10.0 * SIGMA)
    values = 0.5 * shape + SIGMA * coloured
    values[rng.uniform(size=len(t)) < 0.1] = np.nan
    run = Run("run", "", (), {}, (Measured("gauge", "markers", t, values, ("u", "v")),), 1.0)
    noise = {"gauge": ChannelNoise(NOISE["gauge"].sigma, rho, "test")}
    problem = Problem([run], noise, cast(PooledEngine, None), [Direction("mesh", ({"gauge": shape},), sd=1e-6)])
    nothing = Prediction({"gauge": np.zeros((len(t), 2))}, {}, cast(Trace, None))
    residual = problem.assemble([nothing], [])[0]
    weight = problem.basis(0, run.measured[0]).weights(noise["gauge"])
    assert residual @ residual < 1.2 * np.sum(weight[np.isfinite(values)] ** 2)


def test_what_was_not_measured_does_not_weigh_down_what_was(vectors: None) -> None:
    """A wrench of which one force alone is measured; its error is small, that of another force large."""
    values = np.full((len(T), 6), np.nan)
    values[:, 2] = 0.0
    shape = np.tile([100.0, 0.0, 0.1, 0.0, 0.0, 0.0], (len(T), 1))
    run = Run("run", "", (), {}, (Measured("cell", "wrench", T, values, tuple("abcdef")),), 1.0)
    noise = {"cell": ChannelNoise(np.ones(6), np.zeros(6), "test")}
    problem = Problem([run], noise, cast(PooledEngine, None), [Direction("mesh", ({"cell": shape},))])
    rough = problem.basis(0, run.measured[0]).rough[:, 2]
    assert rough == pytest.approx(ROUGH * 0.1, rel=1e-12)


def test_derivatives_are_those_of_the_residual(vectors: None) -> None:
    rng = np.random.default_rng(1)
    slopes = ({"gauge": rng.standard_normal((len(T), 2, 2))},)
    direction = Direction("mesh", ({"gauge": own(TRUTH)},), slopes=slopes, at=np.array([0.2, 0.1]))
    problem = Problem([run_of(measured(rng))], NOISE, cast(PooledEngine, Linear()), [direction], prior=True)
    rig = cast(Any, Vector(np.zeros(2)))
    here = problem.evaluate(rig, PARAMETERS, TRUTH)
    for k in range(2):
        step = 1e-4 * np.eye(2)[k]
        ahead, behind = (problem.evaluate(rig, PARAMETERS, TRUTH + s * step).residual for s in (1.0, -1.0))
        assert here.jacobian[:, k] == pytest.approx((ahead - behind) / 2e-4, rel=1e-6, abs=1e-5)


def test_an_error_far_above_the_noise_is_said() -> None:
    def problem(size: float) -> Problem:
        direction = Direction("mesh", ({"gauge": np.full((len(T), 2), size)},))
        return Problem([run_of(coarse(TRUTH))], NOISE, cast(PooledEngine, Linear()), [direction])

    assert loud(problem(9.0 * SIGMA)) == []
    (said,) = loud(problem(40.0 * SIGMA))
    assert "position of gauge may be 40 times the noise" in said and "finer cells" in said


def test_a_reading_that_a_refinement_does_not_move_may_be_off_for_long() -> None:
    """Beside one that it moves by 1: by a quarter of their largest rms, and the same all through a run."""
    shape = np.column_stack([np.ones(len(T)), np.zeros(len(T))])
    run = run_of(np.zeros((len(T), 2)))
    basis = basis_of([Direction("mesh", ({"gauge": shape},))], 0, run, run.measured[0])
    lasting = [p.shape[:, 1:] * p.functions[:, :1] for p in basis.own if len(p.instants)]
    assert np.hypot.reduce(lasting) == pytest.approx(np.full((len(T), 1), ROUGH * 0.5**0.5))


def test_each_column_may_have_its_own_multiple_of_the_error(vectors: None) -> None:
    """With its sign: half as much again all through a run takes one coefficient, also where the error changes sign."""
    shape = 100.0 * SIGMA * np.column_stack([np.sin(15 * T), np.cos(11 * T)])
    problem = Problem(
        [run_of(shape * [1.0, 0.5])], NOISE, cast(PooledEngine, None), [Direction("mesh", ({"gauge": shape},))]
    )
    nothing = Prediction({"gauge": np.zeros(shape.shape)}, {}, cast(Trace, None))
    assert problem.compare([nothing], cast(Any, Vector(TRUTH)), [], np.zeros(0)).chi2 < 1.0


def test_errors_of_a_rig_that_is_right_are_the_noise(vectors: None) -> None:
    """Beside an own error of ten times the noise, which is not in the readings, of a wrench that was not tared."""
    rng, bias = np.random.default_rng(3), np.array([0.3, -0.2, 0.0, 0.0, 0.0, 0.0])
    noise = {"cell": ChannelNoise(np.full(6, SIGMA), np.zeros(6), "test")}
    values = bias + SIGMA * rng.standard_normal((len(T), 6))
    run = Run("run", "", (), {}, (Measured("cell", "wrench", T, values, tuple("abcdef")),), 1.0)
    direction = Direction("mesh", ({"cell": np.full((len(T), 6), 10.0 * SIGMA)},))
    problem = Problem([run], noise, cast(PooledEngine, None), [direction], bias=True)
    nothing = Prediction({"cell": np.zeros((len(T), 6))}, {}, cast(Trace, None))
    fitted = problem.compare([nothing], cast(Any, Vector(TRUTH)), [], np.zeros(0))
    left = values - problem.tared(fitted, 0, run.measured[0])
    assert np.sqrt(np.mean(left**2)) == pytest.approx(SIGMA, rel=0.05)
