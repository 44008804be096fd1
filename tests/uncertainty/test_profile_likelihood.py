"""Profile likelihood: intervals of misfits that are parabolas, that are not, and that are flat on one side."""

from __future__ import annotations

import json
import os
import re
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from sim_core.errors import ConvergenceError
from sim_core.rigs import with_parameters
from sim_core.rigs.motion import Experiment
from sim_core.simulate import Trace
from sysid.fit import FitOptions, fit_runs
from sysid.fit.fit import _at_given, _Found, _profiled
from sysid.fit.options import Intervals
from sysid.model.load import load_run
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import FitParameter
from sysid.model.predictor import Prediction, SerialPredictor
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.progress.work import Work, work_of
from sysid.report import write_fit_report
from sysid.settings.progress import PROGRESS
from sysid.settings.uncertainty import UNCERTAINTY
from sysid.simulate import simulate_to_bag
from sysid.solve.covariance import Finding, overdispersion, uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem
from sysid.uncertainty.profile_likelihood import in_words
from sysid.uncertainty.profiler import Profiler

T = np.linspace(0.0, 2.0, 60)
SIGMA = 0.05
Model = Callable[[float, float], np.ndarray]


class Curve:
    """An engine that reads ``model(a, b)``; its derivatives are central differences."""

    def __init__(self, model: Model, broken_from: float = np.inf) -> None:
        self.model, self.broken_from, self.calls = model, broken_from, 0

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        self.calls += 1
        if scaled[0] >= self.broken_from:
            raise ConvergenceError("The step does not converge.")
        steps = 1e-5 * np.eye(2)[: len(scaled)]
        slopes = np.stack([(self.model(*(scaled + s)) - self.model(*(scaled - s))) / 2e-5 for s in steps], axis=1)
        return [Prediction({"c": self.model(*scaled)[:, None]}, {"c": slopes[:, None]}, cast(Trace, None))]


def work() -> Work:
    """Of a fit, of which nobody hears."""
    return work_of(None, PROGRESS.fit_rollouts, PROGRESS.fit_between_s, 1)


def parameters(low: float, high: float) -> list[FitParameter]:
    return [
        FitParameter("contacts.a-b.friction", "", False, low, high, 1.0, ""),
        FitParameter("b", "Pa", False, -1e3, 1e3, 1e3, ""),
    ]


@pytest.fixture(autouse=True)
def stubs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid.solve.residuals.start_of", lambda rig, given: np.zeros(len(given)))
    monkeypatch.setattr("sysid.solve.residuals.rig_at", lambda rig, given, scaled: rig)


def fitted_to(
    model: Model, truth: tuple[float, float], low: float = -100.0, high: float = 100.0, **engine: float
) -> tuple[Problem, Fitted]:
    values = model(*truth)[:, None] + SIGMA * np.random.default_rng(5).standard_normal((len(T), 1))
    run = Run("r", "", (), {}, (Measured("c", "markers", T, values, ("u",)),), 2.0)
    noise = {"c": ChannelNoise(np.array([SIGMA]), 0.0, "test")}
    problem = Problem([run], noise, cast(SerialPredictor, Curve(model, **engine)))
    return problem, problem.fit(cast(Any, None), parameters(low, high), start=np.array(truth), tolerance=1e-9)


def linear(a: float, b: float) -> np.ndarray:
    return a * np.sin(3.0 * T) + b * (T + 0.5 * np.sin(3.0 * T))


def cubic(a: float, b: float) -> np.ndarray:
    return a**3 * np.sin(3.0 * T) + b * T


def valley(a: float, b: float) -> np.ndarray:
    """Little changes along b = 200 a + constant."""
    return a * np.sin(3.0 * T) + np.exp(-np.abs(b - 200.0 * a) * T)


def sticking(a: float, b: float) -> np.ndarray:
    """A force that friction carries up to ``a``: beyond 1.2 nothing slips."""
    return np.minimum(a, 1.2 * np.sin(T)) + 1e-3 * b * T


def calibration(fitted: Fitted) -> float:
    known = uncertainty(fitted)
    return float((known.sd**2 / np.diag(np.linalg.inv(fitted.jacobian.T @ fitted.jacobian)))[0])


def test_of_a_parabola_it_is_the_quadratic_interval() -> None:
    problem, fitted = fitted_to(linear, (0.4, -0.3))
    (a, b) = Profiler(problem, fitted).profiles()
    sd = uncertainty(fitted).sd
    for profile, at, s in zip((a, b), fitted.scaled, sd, strict=True):
        assert profile.ends == ("found", "found") and profile.sentence == ""
        np.testing.assert_allclose(profile.ci95, [at - 1.959964 * s, at + 1.959964 * s], atol=0.01 * s)
        np.testing.assert_allclose(profile.deviance, ((np.array(profile.values) - at) / s) ** 2, atol=1e-3)
    assert Profiler(problem, fitted).check() == []


@pytest.mark.parametrize("amplitude", [0.0, 1.0, 2.0, 6.0])
def test_with_a_nuisance_and_a_misfit_with_structure_it_is_the_quadratic_interval(amplitude: float) -> None:
    """Of a linear model; nearly all that separates the two is what is known of the nuisance before."""
    t = np.linspace(0.0, 2.0, 200)
    slopes = np.column_stack([np.sin(3.0 * t), np.sin(3.0 * t) + 0.02 * t])

    class Linear:
        def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
            return [Prediction({"c": (slopes @ scaled)[:, None]}, {"c": slopes[:, None]}, cast(Trace, None))]

    noise = np.random.default_rng(1).standard_normal(len(t))
    values = 0.4 * slopes[:, 0] + SIGMA * (amplitude * np.sin(9.0 * t) + noise)
    run = Run("r", "", (), {}, (Measured("c", "markers", t, values[:, None], ("u",)),), 2.0)
    asked = FitParameter("a", "", False, -100.0, 100.0, 5.0, "")
    lag = FitParameter("lag", "", False, -100.0, 100.0, 0.05, "", nuisance=True)
    problem = Problem([run], {"c": ChannelNoise(np.array([SIGMA]), 0.0, "test")}, cast(SerialPredictor, Linear()))
    fitted = problem.fit(cast(Any, None), [asked, lag], start=np.array([0.4, 0.0]), tolerance=1e-9)
    (profile,) = Profiler(problem, fitted).profiles()
    at, sd = fitted.scaled[0], uncertainty(fitted).sd[0]
    assert profile.ends == ("found", "found") and profile.sentence == ""
    np.testing.assert_allclose(profile.ci95, [at - 1.959964 * sd, at + 1.959964 * sd], atol=1e-3 * sd)
    np.testing.assert_allclose(
        profile.deviance, ((np.array(profile.values) - at) / sd) ** 2, atol=0.1 * UNCERTAINTY.worth_evaluating
    )
    assert Profiler(problem, fitted).check() == []


def test_the_others_follow_along_a_valley() -> None:
    """By scalar searches over d = b - 200 a."""
    problem, fitted = fitted_to(valley, (0.01, 3.5))
    (a, _) = Profiler(problem, fitted).profiles()
    y = problem.runs[0].measured[0].values[:, 0]

    def least(x: float) -> float:
        def square(d: float) -> float:
            return float(np.sum((y - x * np.sin(3.0 * T) - np.exp(-d * T)) ** 2)) / SIGMA**2

        return float(minimize_scalar(square, bounds=(0.0, 20.0), method="bounded", options={"xatol": 1e-9}).fun)

    limit = least(fitted.scaled[0]) + 3.841459 * calibration(fitted)
    at = fitted.scaled[0]
    expected = [brentq(lambda x: least(x) - limit, *ends) for ends in ((at - 0.2, at), (at, at + 0.2))]
    np.testing.assert_allclose(a.ci95, expected, atol=0.03 * (expected[1] - expected[0]))


def test_of_a_cube_it_is_the_cube_root_of_that_of_the_cube() -> None:
    problem, fitted = fitted_to(cubic, (0.25, 0.3))
    (a, _) = Profiler(problem, fitted).profiles()
    cube = fitted.scaled[0] ** 3
    jacobian = np.column_stack([np.sin(3.0 * T), T]) / SIGMA
    sd = np.sqrt(np.linalg.inv(jacobian.T @ jacobian)[0, 0] * calibration(fitted))
    np.testing.assert_allclose(a.ci95, np.cbrt([cube - 1.959964 * sd, cube + 1.959964 * sd]), rtol=0.02)
    assert abs(a.quadratic[0] - a.ci95[0]) > 0.2 * abs(fitted.scaled[0] - a.ci95[0])
    assert "not a parabola" in a.sentence and f"{a.ci95[0]:.3g} to {a.ci95[1]:.3g}" in a.sentence
    (said,) = Profiler(problem, fitted).check()
    assert "The interval of contacts.a-b.friction" in said and "--profile" in said


def test_friction_that_never_slips_has_a_lower_limit() -> None:
    problem, fitted = fitted_to(sticking, (1.6, 0.5), low=0.0, high=3.0)
    (a, _) = Profiler(problem, fitted).profiles()
    assert a.ends == ("found", "open") and a.undetermined and a.ci95[1] == pytest.approx(3.0)
    y = problem.runs[0].measured[0].values[:, 0]

    def least(x: float) -> float:
        miss, slope = y - np.minimum(x, 1.2 * np.sin(T)), 1e-3 * T
        return float(np.sum((miss - slope * (slope @ miss) / (slope @ slope)) ** 2)) / SIGMA**2

    limit = least(2.0) + 3.841459 * calibration_of_misfit(fitted)
    expected = brentq(lambda x: least(x) - limit, 0.8, 1.2)
    assert a.ci95[0] == pytest.approx(expected, abs=0.02)
    assert a.sentence.startswith(f"contacts.a-b.friction is at least {a.ci95[0]:.3g}; anything above, as far as 3,")
    assert a.sentence.endswith("A contact that sticks sets friction no upper limit.")


def walled(a: float, b: float) -> np.ndarray:
    """Nothing tells of ``a`` up to a wall at 2."""
    return 1e3 * max(a - 2.0, 0.0) * np.cos(T) + b * np.sin(3.0 * T)


def test_no_limit_lies_before_what_fits_as_well() -> None:
    """Four points as good as the best on the way to a wall."""
    problem, fitted = fitted_to(walled, (0.5, 0.5), low=0.0, high=3.0)
    (a, _) = Profiler(problem, fitted).profiles()
    good = [x for x, deviance in zip(a.values, a.deviance, strict=True) if deviance < 3.841459]
    assert a.ends[1] == "found" and max(good) <= a.ci95[1] < 2.1


def calibration_of_misfit(fitted: Fitted) -> float:
    return max(1.0, uncertainty(fitted).reduced_chi2) * float(uncertainty(fitted).inflation[0]) ** 2


def test_where_nothing_can_be_simulated_the_interval_is_open() -> None:
    problem, fitted = fitted_to(linear, (0.4, -0.3), broken_from=0.41)
    (a, _) = Profiler(problem, fitted).profiles()
    assert a.ends == ("found", "failed") and a.ci95[1] < 0.41
    assert "nothing could be simulated beyond" in a.sentence


def test_an_end_that_cannot_be_simulated_is_said_to_be_unchecked() -> None:
    problem, fitted = fitted_to(linear, (0.4, -0.3), broken_from=0.41)
    (said,) = Profiler(problem, fitted).check()
    end = fitted.scaled[0] + 1.959964 * uncertainty(fitted).sd[0]
    assert said.startswith(f"The rig could not be simulated with contacts.a-b.friction = {end:.3g}, where the")
    problem, fitted = fitted_to(cubic, (0.25, 0.3))
    cast(Curve, problem.engine).broken_from = fitted.scaled[0] + 0.01
    wide, unchecked = (said for said in Profiler(problem, fitted).check() if "friction" in said)
    assert "takes the misfit for a parabola" in wide and "could not be simulated" in unchecked


def test_only_an_end_that_was_found_is_a_limit() -> None:
    mu = FitParameter("contacts.a-b.friction", "", False, 0.0, 3.0, 0.5, "")

    def said(*ends: str) -> str:
        return in_words(mu, (0.35, 3.0), cast(tuple[str, str], ends), (0.1, 0.9))

    whys = {
        "failed": "nothing could be simulated beyond",
        "unfinished": "the points allowed ended at",
        "interrupted": "Ctrl-C ended it at",
    }
    for stop, why in whys.items():
        for sentence, at, side in ((said(stop, "open"), "0.35", "upper"), (said("open", stop), "3", "lower")):
            assert "is at least" not in sentence and "is at most" not in sentence and "slip" not in sentence
            assert f"no {side} limit to {mu.name}" in sentence and sentence.endswith(f"{why} {at}.")
    assert said("failed", "unfinished") == (
        f"The interval of {mu.name} may reach further: nothing could be simulated beyond 0.35, and the points allowed "
        "ended at 3."
    )
    assert said("found", "open").startswith(f"{mu.name} is at least 0.35;")
    assert said("open", "found") == f"{mu.name} is at most 3; anything below, as far as 0.35, fits as well."


@pytest.mark.parametrize(("broken_from", "replaced"), [(np.inf, True), (1.61, False)])
def test_only_what_says_as_much_takes_the_place_of_not_determined(broken_from: float, replaced: bool) -> None:
    """Friction that never slips has a lower limit; where more cannot be simulated nobody knows if there is an upper."""
    problem, fitted = fitted_to(sticking, (1.6, 0.5), low=0.0, high=3.0, broken_from=broken_from)
    before = f"The data do not determine {fitted.parameters[0].name}: 1 to 2 fit about as well."
    finding = Finding(before, (fitted.parameters[0].name,))
    profiles, found, _ = _profiled(problem, fitted, [finding], "profiled", work())
    said = [f.sentence for f in found]
    assert profiles[0].ends == ("found", "open" if replaced else "failed")
    assert profiles[0].sentence in said and (before in said) != replaced


def test_what_was_known_before_does_not_take_the_place_of_not_determined() -> None:
    """Both ends of the profile are found then, whatever the data say."""
    problem, plain = fitted_to(cubic, (0.25, 0.3))
    first, other = plain.parameters
    finding = Finding("The data do not determine it: its interval is what was known before.", (first.name,))
    for known_sd, kept in ((None, False), (10.0, True)):
        given = [replace(first, known_sd=known_sd), other]
        fitted = problem.fit(cast(Any, None), given, start=plain.scaled, tolerance=1e-9)
        profiles, found, _ = _profiled(problem, fitted, [finding], "profiled", work())
        assert profiles[0].ends == ("found", "found") and "not a parabola" in profiles[0].sentence
        assert (finding in found) == kept


class Pressed(Curve):
    """Ctrl-C is pressed once, while the first end of an interval is simulated."""

    pressed = False

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        if not self.pressed:
            self.pressed = True
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.5)
        return super().predict_all(rig, runs, parameters, scaled)


@pytest.mark.parametrize("intervals", ["checked", "profiled"])
def test_ctrl_c_on_the_way_to_the_ends_is_reported(intervals: Intervals) -> None:
    problem, fitted = fitted_to(linear, (0.4, -0.3))
    problem.engine = cast(SerialPredictor, Pressed(linear))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it
    try:
        _, found, better = _profiled(problem, fitted, [], intervals, work())
    finally:
        signal.signal(signal.SIGINT, before)
    assert better is None
    *reached, last = [f.sentence for f in found]
    assert last == "Not all intervals were looked at along the likelihood: interrupted."
    assert all("Ctrl-C ended it" in sentence for sentence in reached)  # if the other end had been begun by then


class Hiding(Curve):
    """Where ``a`` is above ``hidden_from`` some readings are out of sight, which tell little of it."""

    hidden_from = 0.004

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        (found,) = super().predict_all(rig, runs, parameters, scaled)
        if scaled[0] > self.hidden_from:
            found.values["c"][np.abs(T - 1.05) < 0.15] = np.nan
        return [found]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_nothing_is_gained_by_hiding_readings_where_intervals_end(side: float) -> None:
    """Whether they go out of sight on the way from the fit or come into sight."""
    problem, fitted = fitted_to(linear, (0.0, 1.0))
    plain = Profiler(problem, fitted).profiles()
    hiding = Hiding(linear)
    hiding.hidden_from = fitted.scaled[0] + side * 1.5 * uncertainty(fitted).sd[0]
    problem = Problem(problem.runs, problem.noise, cast(SerialPredictor, hiding))
    there = problem.fit(cast(Any, None), fitted.parameters, start=fitted.scaled, tolerance=1e-9)
    assert there.sight is not None and there.sight.all() == (side > 0.0)
    profiler = Profiler(problem, there)
    assert profiler.check() == [] and profiler.better is None
    if side > 0.0:
        for profile, before, sd in zip(Profiler(problem, there).profiles(), plain, uncertainty(there).sd, strict=True):
            np.testing.assert_allclose(profile.ci95, before.ci95, atol=0.3 * sd)


def test_the_number_of_evaluations_is_bounded() -> None:
    problem, fitted = fitted_to(sticking, (1.6, 0.5), low=0.0, high=3.0)
    engine = cast(Curve, problem.engine)
    engine.calls = 0
    reported: list[str] = []
    Profiler(problem, fitted, reported.append).profiles()
    assert engine.calls == len(reported) <= 40
    assert all(re.fullmatch(r"ends of intervals, evaluation \d+ of about \d+", text) for text in reported)


def test_a_better_fit_on_the_way_is_reported() -> None:
    """Where the search stands, the readings do not change with the first parameter."""
    problem, _ = fitted_to(cubic, (1.0, 0.1))
    there = problem.evaluate(cast(Any, None), parameters(-5.0, 5.0), np.array([0.0, 0.1]))
    profiler = Profiler(problem, there)
    profiler.profiles()
    assert "The search had ended too early" in profiler.lower()
    assert "contacts.a-b.friction = " in profiler.lower()


@pytest.mark.parametrize(("share", "reported"), [(0.9, False), (1.1, True)])
def test_what_chance_makes_of_a_misfit_with_structure_is_no_better_fit(share: float, reported: bool) -> None:
    """Samples that repeat each other let chi-square fall by more than misfit over noise tells."""
    problem, _ = fitted_to(linear, (0.4, -0.3))
    (run,) = problem.runs
    (m,) = run.measured
    wave = replace(m, values=m.values + 3.0 * SIGMA * np.sin(8.0 * T)[:, None])
    wrong = Problem([replace(run, measured=(wave,))], problem.noise, problem.engine)
    fitted = wrong.fit(cast(Any, None), parameters(-100.0, 100.0), start=np.array([0.4, -0.3]), tolerance=1e-9)
    by_chance = overdispersion(fitted)
    assert by_chance > 1.5 * uncertainty(fitted).reduced_chi2 > 1.5
    profiler = Profiler(wrong, fitted)
    least = fitted.chi2 - share * 1.959964**2 * by_chance
    profiler._lowest = replace(profiler._best, residual=fitted.residual * np.sqrt(least / fitted.chi2))
    assert bool(profiler.lower()) == reported


def escaping(a: float, b: float) -> np.ndarray:
    """Changes with ``a`` by its square at first, so that a search at 0 stays there."""
    return a * a * np.sin(3.0 * T) + b * T


@pytest.mark.parametrize("intervals", ["checked", "profiled"])
def test_a_better_fit_at_the_ends_is_no_narrow_interval(intervals: Intervals) -> None:
    """Where the search stands, the readings hardly change with the first parameter."""
    problem, _ = fitted_to(escaping, (1.0, 0.1))
    there = problem.evaluate(cast(Any, None), parameters(-5.0, 5.0), np.array([0.05, 0.1]))
    _, (early,), better = _profiled(problem, there, [], intervals, work())
    assert early.sentence.startswith("The search had ended too early: chi-square is lower by")
    assert better is not None and problem.evaluate(cast(Any, None), there.parameters, better).chi2 < there.chi2
    gain = there.chi2 - problem.evaluate(cast(Any, None), there.parameters, better).chi2
    assert _profiled(problem, there, [], intervals, work(), gain)[2] is None
    there.converged = False
    _, found, better = _profiled(problem, there, [], intervals, work())
    silent = [f.sentence for f in found]
    assert better is None
    assert not any("too early" in s or "interval of" in s for s in silent)
    assert silent[-1].endswith("since the fit did not converge.")


def test_a_better_fit_in_sight_of_the_ends_is_gone_to() -> None:
    """Of a product: with a factor that is far off the other goes too far at first, and is right only then."""
    problem, _ = fitted_to(lambda a, b: a * b * np.sin(3.0 * T), (1.0, 1.0))
    there = problem.evaluate(cast(Any, None), parameters(-100.0, 100.0), np.array([0.05, 0.05]))
    profiler = Profiler(problem, there)
    (said,) = profiler.check()
    gain = float(said.split("lower by ")[1].split(" at ")[0])
    y = problem.runs[0].measured[0].values[:, 0]
    shape = np.sin(3.0 * T)
    least = float(np.sum((y - shape * (shape @ y) / (shape @ shape)) ** 2)) / SIGMA**2
    assert gain == pytest.approx(there.chi2 - least, rel=0.01)


@pytest.mark.parametrize(("given", "kept"), [(2.5, True), (0.5, False)])
def test_where_given_values_stay_the_profile_that_holds_them_is_kept(given: float, kept: bool) -> None:
    """Of a friction that never slips, which has a lower limit of 1.2."""
    problem, fitted = fitted_to(sticking, (1.6, 0.5), low=0.0, high=3.0)
    profiles, _, _ = _profiled(problem, fitted, [], "profiled", work())
    first = np.array([given, fitted.scaled[1]])
    stays = problem.evaluate(cast(Any, None), fitted.parameters, first)
    found = _Found(cast(Any, None), problem, fitted, [], [], [], 1.0, profiles, [])
    there = _at_given(found, stays, first)
    friction = "contacts.a-b.friction"
    assert [p.value for p in there.profiles if p.name == friction] == [given] * kept
    said = " ".join(f.sentence for f in there.findings)
    assert (f"{friction} is at least" in said) == kept
    assert not kept or f"do not determine {friction}" not in said


@pytest.mark.slow
def test_a_gel_that_sticks_says_how_much_friction_there_is_at_least(
    small_rig: Any, tmp_path: Path, workers: ParallelPredictor
) -> None:
    """Pressed on a post and pulled aside by less than its friction holds."""
    rig = small_rig()
    finger = rig.end_effectors["finger"].model_copy(
        update={"start": rig.end_effectors["finger"].start.model_copy(update={"position_m": (0.08, 0.004, 0.0545)})}
    )
    rig = rig.model_copy(
        update={
            "bodies": {n: b for n, b in rig.bodies.items() if n != "card"}, "clamps": (), "cameras": {},
            "contacts": rig.contacts[1:], "end_effectors": {"finger": finger},
            "solver": rig.solver.model_copy(update={"inertia": False}),
        }
    )  # fmt: skip
    poses = [{"position_m": [0.0, 0.0, -0.0008]}, {"position_m": [0.0002, 0.0, -0.0008]}]
    motion = [
        {"type": "wait", "duration_s": 0.2},
        {"type": "waypoints", "speed_m_s": 2e-3, "hold_s": 0.2, "poses": poses},
    ]
    experiment = Experiment.model_validate({"name": "stick", "motions": {"finger": motion}})
    name = "contacts.gel-post.friction"
    simulate_to_bag(with_parameters(rig, {name: 1.2}), experiment, tmp_path / "bag", seed=4)
    start = with_parameters(rig, {name: 1.0})
    result, _ = fit_runs(
        start, [load_run(rig, tmp_path / "bag")], [name], FitOptions(intervals="profiled"), engine=workers
    )
    (profile,) = result.profiles
    assert profile.ends == ("found", "open") and 0.1 < profile.ci95[0] < 1.0
    assert profile.sentence.startswith(f"{name} is at least") and profile.sentence in result.identifiability
    assert "by profile likelihood" in result.table() and "(open)" in result.table()
    page = write_fit_report(result, tmp_path / "report.html").read_text()
    assert "Deviance against each parameter" in page and f"Deviance against {name}" in page
    assert json.loads(json.dumps(result.to_json()))["profiles"][0]["ends"] == ["found", "open"]
