"""Where recordings leave parameters undetermined, the values nearest to the start among those that fit as well."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sim_core.rigs import load_rig, with_parameters
from sim_core.rigs.motion import load_experiment
from sim_core.simulate import Trace
from sysid.fit import FitOptions, fit_runs
from sysid.fit.fit import NEAREST
from sysid.fit.minimum_norm import minimum_norm_solution
from sysid.model.load import load_runs
from sysid.model.parameters import FitParameter
from sysid.model.predictor import Prediction, SerialPredictor
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.fit import FIT
from sysid.simulate import simulate_to_bag
from sysid.solve.covariance import uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 2.0, 60)
SIGMA = 0.05
A = FitParameter("a", "-", False, -1e3, 1e3, 1.0, "")
B = FitParameter("b", "-", False, -1e3, 1e3, 3.0, "")
START_HERE = np.zeros(2)


class Sum:
    """Readings of a + b, of ``apart`` (a - b), and of 0.03 c if there is a third parameter; nothing can be simulated
    with a from ``wall`` to 10."""

    def __init__(self, apart: float = 0.0, wall: float = np.inf) -> None:
        self.apart, self.wall = apart, wall

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        if self.wall <= scaled[0] < 10.0:
            raise ConvergenceError("The step does not converge.")
        shapes = np.stack([np.sin(T) + self.apart * np.cos(T), np.sin(T) - self.apart * np.cos(T)], axis=-1)
        shapes = np.column_stack([shapes, 0.03 * np.cos(5.0 * T)])[:, : len(scaled)]
        return [Prediction({"c": (shapes @ scaled)[:, None]}, {"c": shapes[:, None]}, cast(Trace, None))]


@pytest.fixture(autouse=True)
def stubs(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    if "tmp_path" not in request.fixturenames:
        monkeypatch.setattr("sysid.solve.residuals.start_of", lambda rig, given: np.zeros(len(given)))
        monkeypatch.setattr("sysid.solve.residuals.rig_at", lambda rig, given, scaled: rig)


def ended(engine: Sum, at: tuple[float, ...], parameters: list[FitParameter] | None = None) -> tuple[Problem, Fitted]:
    """A search that has ended at values of which the sum is 2, as that of the truth."""
    values = 2.0 * np.sin(T)[:, None] + SIGMA * np.random.default_rng(5).standard_normal((len(T), 1))
    run = Run("r", "", (), {}, (Measured("c", "markers", T, values, ("u",)),), 2.0)
    problem = Problem([run], {"c": ChannelNoise(np.array([SIGMA]), 0.0, "test")}, cast(SerialPredictor, engine))
    return problem, problem.evaluate(cast(Any, None), parameters or [A, B], np.array(at))


def test_the_nearest_in_plausible_widths_is_gone_to() -> None:
    """On a + b = 2 the least of a^2 + (b / 3)^2 is at 0.2 and 1.8."""
    problem, fitted = ended(Sum(), (30.0, -28.0))
    reported: list[Fitted] = []
    found = minimum_norm_solution(problem, fitted, START_HERE, 30, reported.append)
    np.testing.assert_allclose(found.scaled, [0.2, 1.8], atol=0.02)
    assert found.chi2 - fitted.chi2 <= FIT.chi2_rise and found.converged and found.message == fitted.message
    assert len(reported) == found.evaluations - fitted.evaluations == 1


def test_what_is_determined_or_was_known_stays() -> None:
    problem, fitted = ended(Sum(apart=1.0), (1.0, 1.0))
    assert minimum_norm_solution(problem, fitted, START_HERE, 30) is fitted
    problem, fitted = ended(Sum(), (30.0, -28.0), [replace(A, known_sd=1.0), replace(B, known_sd=3.0)])
    assert minimum_norm_solution(problem, fitted, START_HERE, 30) is fitted
    problem, fitted = ended(Sum(), (30.0, -28.0))
    for changed in ({"converged": False}, {"interrupted": True}, {"limited": True}):
        unlike = replace(fitted, **changed)  # type: ignore[arg-type]
        assert minimum_norm_solution(problem, unlike, START_HERE, 30) is unlike


def test_what_was_known_is_not_pulled_further() -> None:
    """a = 0 +- 100 was known: what is nearest is b = 0."""
    problem, fitted = ended(Sum(), (30.0, -28.0), [replace(A, known_sd=100.0), B])
    np.testing.assert_allclose(minimum_norm_solution(problem, fitted, START_HERE, 30).scaled, [2.0, 0.0], atol=0.05)


def test_what_is_weakly_determined_is_not_given_up() -> None:
    """The difference of both is known to +- 9, and 24 from the start: all the way back would cost 7."""
    problem, fitted = ended(Sum(apart=0.0013), (13.0, -11.0))
    problem.runs[0].measured[0].values[:] = (2.0 * np.sin(T) + 24.0 * 0.0013 * np.cos(T))[:, None]
    fitted = problem.evaluate(cast(Any, None), [A, B], fitted.scaled)
    found = minimum_norm_solution(problem, fitted, START_HERE, 30)
    assert found is not fitted and found.chi2 - fitted.chi2 <= FIT.chi2_rise
    assert 3.0 < found.scaled[0] - found.scaled[1] < 20.0


@pytest.mark.parametrize("third", [5.0, 8.0])
def test_what_is_determined_with_it_is_not_drawn_to_the_start(third: float) -> None:
    """c is known to 0.3 of its plausible width, and several of these from the start."""
    given = [A, B, FitParameter("c", "-", False, -1e3, 1e3, 1.0, "")]
    problem, fitted = ended(Sum(), (30.0, -28.0, third), given)
    problem.runs[0].measured[0].values[:] += 0.03 * third * np.cos(5.0 * T)[:, None]
    fitted = problem.fit(cast(Any, None), given, start=fitted.scaled, tolerance=1e-9)
    sd = uncertainty(fitted).sd[2]
    found = minimum_norm_solution(problem, fitted, np.zeros(3), 30)
    np.testing.assert_allclose(found.scaled[:2], [0.2, 1.8], atol=0.1)
    assert 0.2 < sd < 0.45 and abs(found.scaled[2] - fitted.scaled[2]) < 0.2 * sd


def test_bounds_hold_on_the_way_back() -> None:
    problem, fitted = ended(Sum(), (0.15, 1.85), [replace(A, upper=0.15), B])
    there = problem.evaluate(cast(Any, None), fitted.parameters, np.array([-30.0, 32.0]))
    np.testing.assert_allclose(minimum_norm_solution(problem, there, START_HERE, 30).scaled, [0.15, 1.85], atol=0.02)


def test_no_more_evaluations_are_made_than_may_be() -> None:
    problem, fitted = ended(Sum(wall=-50.0), (12.0, -10.0))
    reported: list[Fitted] = []
    assert minimum_norm_solution(problem, fitted, START_HERE, 2, reported.append) is fitted
    assert [t.chi2 for t in reported] == [fitted.chi2] * 2  # what failed counts, and the best is reported
    assert minimum_norm_solution(problem, fitted, START_HERE, 0, reported.append) is fitted and len(reported) == 2


def test_where_the_way_back_cannot_be_simulated_the_fit_stays() -> None:
    problem, fitted = ended(Sum(wall=-50.0), (12.0, -10.0))
    assert minimum_norm_solution(problem, fitted, START_HERE, 30) is fitted


def test_modulus_thickness_and_density_of_a_pull_stay_near_the_rig(tmp_path: Path) -> None:
    """Only E h is determined; a search ends at 75 MPa and 5 mm, from 4.9 GPa and 0.1 mm."""
    rig, bag = load_rig("strip_coarse"), tmp_path / "bag"
    simulate_to_bag(with_parameters(rig, {"strip.E_pa": 4e9}), load_experiment("pull_taut"), bag, seed=0)
    names = ["strip.E_pa", "strip.thickness_m", "strip.density_kg_m3"]
    options = FitOptions(nuisance=("none",), intervals="quadratic")
    (run,), _ = load_runs(rig, [Path(f"{bag}@0:2")])
    result, _ = fit_runs(rig, [run], names, options)
    modulus, thickness, density = (e.value for e in result.estimates)
    assert modulus * thickness == pytest.approx(4e5, rel=0.05)
    assert 1e9 < modulus < 1e10 and 500.0 < density < 4000.0
    assert NEAREST in result.identifiability and {"strip.E_pa", "strip.thickness_m"} <= result.undetermined
