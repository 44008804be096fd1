"""The search weighs a misfit with structure for what it is, and a right model as least squares does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.rigs import load_rig
from sysid.model.parameters import FitParameter, fit_parameters
from sysid.solve.covariance import overdispersion
from sysid.solve.gauss_newton import HALTED, Search
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 1.0, 4000)
BASIS = np.column_stack([T, T**2])
PARAMETERS = [FitParameter(name, "-", False, -1e6, 1e6, 1.0, "") for name in "ab"]
RNG = np.random.default_rng(5)
NOISE = RNG.normal(size=len(T))


def problem(data: np.ndarray) -> Any:
    """A line and a parabola against data of unit noise, with priors of unit width at zero."""

    def evaluate(scaled: np.ndarray) -> Fitted:
        residual = np.concatenate([data - BASIS @ scaled, scaled])
        labels = [(0, "gauge", T), (-1, "prior", np.zeros(2))]
        rig = cast(Any, None)
        jacobian = np.vstack([-BASIS, np.eye(2)])
        return Fitted(PARAMETERS, scaled, rig, residual, jacobian, labels, [], rig, 1, True, "")

    return evaluate


def solved(data: np.ndarray, weight: float) -> np.ndarray:
    """Ridge regression by its normal equations."""
    return np.asarray(np.linalg.solve(BASIS.T @ BASIS + weight * np.eye(2), BASIS.T @ data))


def search(data: np.ndarray, start: tuple[float, float] = (0.0, 0.0)) -> Fitted:
    return Search(problem(data), PARAMETERS, None).run(np.array(start), 60, 0.5)


@pytest.mark.parametrize("start", [(0.0, 0.0), (300.0, -200.0)])
def test_a_right_model_is_fitted_as_least_squares_does(start: tuple[float, float]) -> None:
    data = BASIS @ [2.0, -1.0] + NOISE
    found = search(data, start)
    assert found.converged
    assert overdispersion(found) < 2.5
    sd = np.sqrt(np.diag(np.linalg.inv(BASIS.T @ BASIS + np.eye(2))))
    np.testing.assert_array_less(np.abs(found.scaled - solved(data, 1.0)), 0.25 * sd)


@pytest.mark.parametrize("off", [1.0, 5.0, 20.0])
def test_what_a_misfit_says_nothing_of_is_fitted_as_well_as_it_is_known(off: float) -> None:
    """Two gauges, of which one is missed by ten times its noise; the other one's parameter is off by so many standard
    deviations. Chance makes more of all of chi-square than that parameter can make of it."""
    wave, other = np.sin(3.0 * T), np.cos(9.0 * T)
    missed, right = NOISE + 10.0 * np.sin(7.0 * T), RNG.normal(size=len(T))
    slopes = np.block([[-wave[:, None], np.zeros((len(T), 1))], [np.zeros((len(T), 1)), -other[:, None]]])

    def evaluate(scaled: np.ndarray) -> Fitted:
        residual = np.concatenate([missed, right]) + slopes @ scaled
        labels, nothing = [(0, "missed", T), (0, "right", T)], cast(Any, None)
        return Fitted(PARAMETERS, scaled, nothing, residual, slopes, labels, [], nothing, 1, True, "")

    best = np.array([wave @ missed / (wave @ wave), other @ right / (other @ other)])
    sd = 1.0 / np.linalg.norm(other)
    found = Search(evaluate, PARAMETERS, None).run(best + [0.0, off * sd], 60, 0.5)
    assert found.converged and 0.5 * overdispersion(found) > off**2
    assert abs(found.scaled[1] - best[1]) < 0.25 * sd


def test_chance_of_white_noise_is_about_one() -> None:
    values = []
    for _ in range(40):
        data = RNG.normal(size=len(T))
        values.append(overdispersion(problem(data)(solved(data, 1.0))))
    assert np.mean(values) == pytest.approx(1.0, abs=0.35)


def test_a_misfit_with_structure_leaves_parameters_near_their_prior() -> None:
    # An oscillation that neither parameter can make, of 30 times the noise: its chance correlation with them
    # is no evidence for values of 100 prior widths.
    data = 30.0 * np.sin(9.0 * T) + NOISE
    loose, found = solved(data, 1.0), search(data)
    kappa = overdispersion(found)
    assert kappa > 1000.0
    assert np.abs(found.scaled).max() < 0.3 * np.abs(loose).max()
    low, high = (solved(data, w) for w in (2.0 * kappa, 0.5 * kappa))
    assert min(low[0], high[0]) - 0.3 < found.scaled[0] < max(low[0], high[0]) + 0.3


def test_the_best_is_kept_when_the_search_is_interrupted() -> None:
    evaluate = problem(BASIS @ [2.0, -1.0] + NOISE)
    count = 0

    def interrupted(scaled: np.ndarray) -> Fitted:
        nonlocal count
        count += 1
        if count == 3:
            raise KeyboardInterrupt
        return evaluate(scaled)

    found = Search(interrupted, PARAMETERS, None).run(np.array([300.0, 0.0]), 60, 0.5)
    assert found.interrupted and not found.converged
    assert found.chi2 < evaluate(np.array([300.0, 0.0])).chi2


@pytest.mark.parametrize("start", [0.0, 1e-4, 1e-2, 3.0])
@pytest.mark.parametrize("sd", [0.02, 0.05])
def test_a_search_gets_away_from_where_it_starts(start: float, sd: float) -> None:
    """From a bound or from next to it, at which the value is nothing, as from anywhere else."""
    friction = FitParameter("friction", "-", False, 0.0, 3.0, 0.5, "")
    slope = np.ones(400) / np.sqrt(400) / sd
    data = 0.3 * slope + np.random.default_rng(2).standard_normal(400)

    def evaluate(scaled: np.ndarray) -> Fitted:
        nothing, labels = cast(Any, None), [(0, "gauge", np.linspace(0.0, 1.0, 400))]
        residual = data - slope * scaled[0]
        return Fitted([friction], scaled, nothing, residual, -slope[:, None], labels, [], nothing, 1, True, "")

    found = Search(evaluate, [friction], None).run(np.array([start]), 30, 0.5)
    best = float(slope @ data / (slope @ slope))
    assert found.converged
    assert abs(found.scaled[0] - best) < sd


def test_a_search_that_is_halted_says_so_and_knows_where_it_began() -> None:
    evaluate = problem(BASIS @ [2.0, -1.0] + NOISE)
    seen: list[list[float]] = []

    def halt(course: Sequence[float]) -> bool:
        seen.append(list(course))
        return len(course) == 2

    begin = np.array([300.0, -200.0])
    found = Search(evaluate, PARAMETERS, None, halt).run(begin, 60, 0.5)
    assert not found.converged and found.message == HALTED and found.elsewhere
    assert found.began == pytest.approx(evaluate(begin).chi2)
    assert seen[-1] == pytest.approx([found.began, found.chi2])


def test_a_search_does_not_go_out_of_sight_little_by_little() -> None:
    """The farther it goes the better it fits, since ever more is out of sight: a tenth of the most that was seen is all
    that may be, not a tenth at each step."""
    slope = np.linspace(0.5, 1.5, 1000)
    line = [FitParameter("a", "-", False, -1e6, 1e6, 1.0, "")]

    def evaluate(scaled: np.ndarray) -> Fitted:
        seen = int(1000 * np.exp(-max(scaled[0], 0.0) / 20.0))
        there = np.arange(1000) < seen
        residual = np.where(there, slope * (100.0 - scaled[0]), 0.0)
        jacobian = np.where(there, -slope, 0.0)[:, None]
        nothing, labels = cast(Any, None), [(0, "gauge", np.linspace(0.0, 1.0, 1000))]
        return Fitted(line, scaled, nothing, residual, jacobian, labels, [], nothing, 1, True, "", sight=there)

    found = Search(evaluate, line, None).run(np.array([0.0]), 200, 0.5)
    assert 0.0 < found.scaled[0] and 900 <= found.samples < 1000


def hiding(weight: float, missed: float) -> Any:
    """1200 readings of weight (a + a^2), a = 0.366 by all; one in twelve, which leaves the picture beyond a = 0.4, is
    missed by so many times the noise, up and down in turn."""
    outer = np.arange(1200) % 12 == 0
    up_and_down = np.where(np.arange(1200) % 24 == 0, missed, -missed)
    data = 0.5 * weight + np.where(outer, up_and_down, np.random.default_rng(1).standard_normal(1200))

    def evaluate(scaled: np.ndarray) -> Fitted:
        (a,) = scaled
        there = ~outer if a > 0.4 else np.ones(1200, dtype=bool)
        residual = np.where(there, data - weight * (a + a * a), 0.0)
        jacobian = np.where(there, -weight * (1.0 + 2.0 * a), 0.0)[:, None]
        nothing, labels = cast(Any, None), [(0, "gauge", np.linspace(0.0, 1.0, 1200))]
        return Fitted(LINE, scaled, nothing, residual, jacobian, labels, [], nothing, 1, True, "", sight=there)

    return evaluate


LINE = [FitParameter("a", "-", False, -1e6, 1e6, 1.0, "")]


def test_nothing_is_gained_by_hiding_what_is_missed() -> None:
    """The first step goes too far, to where what is missed most is out of sight, and the next ones come back."""
    found = Search(hiding(10.0, 6.0), LINE, None).run(np.array([0.0]), 200, 0.5)
    assert found.converged and found.scaled[0] == pytest.approx(0.366, abs=0.01)


def test_nothing_is_lost_by_seeing_what_is_missed_as_the_rest_is() -> None:
    """What was out of sight from the beginning counts there as it would on average."""
    found = Search(hiding(3.0, 1.0), LINE, None).run(np.array([0.41]), 200, 0.5)
    assert found.converged and found.scaled[0] == pytest.approx(0.366, abs=0.02)


def test_outcomes_are_compared_over_what_both_have_in_sight() -> None:
    nothing, residual = cast(Any, None), np.arange(1.0, 5.0)
    one, other = (
        Fitted([], np.zeros(0), nothing, scale * residual, np.zeros((4, 0)), [], [], nothing, 1, True, "", sight=there)
        for scale, there in ((1.0, np.array([True, True, False, True])), (2.0, np.array([True, True, True, False])))
    )
    assert one.common_chi2(other) == (5.0, 20.0) and (one.samples, other.samples) == (3, 3)
    assert one.misfit == pytest.approx(one.chi2 / 3.0)


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_a_search_does_not_depend_on_units(unit: float) -> None:
    """The data ask for a value at four of its plausible widths, which in a unit of thousandths are thousands."""
    plain = problem(BASIS @ [4.0, 0.5] + NOISE)

    def course(size: float) -> list[np.ndarray]:
        parameters, seen = [replace(PARAMETERS[0], prior_sd=1.0 / size), PARAMETERS[1]], []

        def evaluate(scaled: np.ndarray) -> Fitted:
            seen.append(scaled * [size, 1.0])
            there = plain(seen[-1])
            return replace(there, parameters=parameters, scaled=scaled, jacobian=there.jacobian * [size, 1.0])

        Search(evaluate, parameters, None).run(np.zeros(2), 60, 0.5)
        return seen

    np.testing.assert_allclose(course(unit), course(1.0), atol=1e-9)


def _knocked(
    calibrated: np.ndarray | None, halt: Callable[[Sequence[float]], bool] | None = None
) -> tuple[Fitted, list[np.ndarray]]:
    """A settling whose rate is asked for, 3.1 where it is taken for 3, read by a gauge that was knocked by 40 where it
    is known within 5. A rate that is much too large makes up for some of that, and then has no derivative."""
    rate_known, zero_known = 2.0, 5.0
    parameters = [
        FitParameter("rate", "-", False, 0.0, 100.0, rate_known, ""),
        FitParameter("zero", "-", False, -1e3, 1e3, zero_known, "", nuisance=True),
    ]
    data = 40.0 + 20.0 * (1.0 - np.exp(-3.1 * T)) + NOISE
    seen: list[np.ndarray] = []

    def evaluate(scaled: np.ndarray) -> Fitted:
        seen.append(scaled)
        rate, zero = scaled
        left = data - zero - 20.0 * (1.0 - np.exp(-rate * T))
        slopes = np.column_stack([-20.0 * T * np.exp(-rate * T), -np.ones(len(T))])
        residual, jacobian = np.append(left, zero / zero_known), np.vstack([slopes, [0.0, 1.0 / zero_known]])
        labels, nothing = [(0, "gauge", T), (-1, "prior", np.zeros(1))], cast(Any, None)
        return Fitted(parameters, scaled, nothing, residual, jacobian, labels, [], nothing, 1, True, "")

    return Search(evaluate, parameters, None, halt, calibrated).run(np.array([3.0, 0.0]), 4, 0.5), seen


def test_a_knocked_sensor_is_calibrated_before_anything_else_is_searched_for() -> None:
    found, seen = _knocked(np.array([False, True]))
    np.testing.assert_allclose(found.scaled, [3.1, 40.0], atol=0.05)
    assert seen[1][0] == 3.0
    astray, _ = _knocked(None)
    assert abs(astray.scaled[0] - 3.1) > 2.0


def test_how_slowly_a_search_comes_on_is_judged_from_where_it_was_calibrated() -> None:
    """What a calibration takes away says nothing of an error of the mesh that was measured where bodies began."""
    courses: list[list[float]] = []

    def halt(course: Sequence[float]) -> bool:
        courses.append(list(course))
        return False

    found, _ = _knocked(np.array([False, True]), halt)
    assert courses and all(course[0] == courses[0][0] for course in courses)
    assert courses[0][0] == found.began < 2.0 * found.chi2 < 1e-2 * 40.0**2 * len(T)


def test_what_moves_bodies_is_no_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    """Clocks and cameras are; where a hand is, and what was asked for by name, are not."""
    asked: list[np.ndarray] = []

    class Found:
        def __init__(self, *given: Any, calibrated: np.ndarray) -> None:
            asked.append(calibrated)

        def run(self, *given: Any) -> None:
            return None

    monkeypatch.setattr("sysid.solve.residuals.Search", Found)
    rig = load_rig("gel_sensor")
    names = ["gel.E_pa", "inside.latency_s", "inside.cx_px", "finger.offset_x_m", "inside.fx_px"]
    parameters = [replace(p, nuisance=k in (1, 2, 3)) for k, p in enumerate(fit_parameters(rig, names))]
    Problem([], {}, cast(Any, None)).fit(rig, parameters)
    assert asked[0].tolist() == [False, True, True, False, False]


@pytest.mark.parametrize("size", [2.0, 20.0])
def test_a_sensor_that_is_well_calibrated_is_searched_for_with_the_rest(size: float) -> None:
    """The first step is that of all parameters, also where a sensor could make up for most of what they explain."""
    parameters = [replace(PARAMETERS[0], nuisance=True), PARAMETERS[1]]
    seen: list[np.ndarray] = []
    plain = problem(BASIS @ [0.01, size] + NOISE)

    def evaluate(scaled: np.ndarray) -> Fitted:
        seen.append(scaled)
        return plain(scaled)

    Search(evaluate, parameters, None, calibrated=np.array([False, False])).run(np.zeros(2), 60, 0.5)
    whole = list(seen)
    seen.clear()
    Search(evaluate, parameters, None, calibrated=np.array([True, False])).run(np.zeros(2), 60, 0.5)
    assert np.abs(whole[1]).min() > 0.0
    np.testing.assert_array_equal(seen, whole)
