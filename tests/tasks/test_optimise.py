"""Methods of optimisation on problems with known solutions; budgets, logs, interruption."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from small_task import small_task

from sim_core.errors import ConfigError
from sim_core.optimise import METHODS, Budget, BudgetSpent, Problem, Settings, optimise
from sim_core.optimise.evaluators import Request
from sim_core.optimise.hybrid import PROBE
from sim_core.optimise.posterior import posterior_draws
from sim_core.rigs import load_rig
from sim_core.tasks import Outcome
from sim_core.tasks.actions import OUT_AND_BACK, STRAIGHT

Value = Callable[[np.ndarray], tuple[float, np.ndarray]]
TARGET = np.array([0.5, -0.3, 0.2, 1.4])  # the last one is beyond the bounds


def bowl(x: np.ndarray) -> tuple[float, np.ndarray]:
    """Best at the target within the bounds: -0.4^2."""
    weights = np.array([1.0, 4.0, 2.0, 1.0])
    return -float(weights @ (x - TARGET) ** 2), -2.0 * weights * (x - TARGET)


def shelf(x: np.ndarray) -> tuple[float, np.ndarray]:
    """No slope until the first entry is above 0.4, as where nothing touches."""
    if x[0] < 0.4:
        return -5.0, np.zeros(4)
    return bowl(x)


class Toy:
    """Evaluates a function instead of a rollout. Actions with a third entry above 0.7 end early."""

    size, workers = 4, 2

    def __init__(self, value: Value, fail_after: int = 10**9) -> None:
        self.value, self.made, self.fail_after = value, 0, fail_after

    def outcomes(self, requests: Sequence[Request]) -> list[Outcome]:
        found = []
        for request in requests:
            if self.made >= self.fail_after:
                raise KeyboardInterrupt
            self.made += 1
            shift = (request.parameters or {}).get("shift", 0.0)
            if request.action[2] > 0.7:
                found.append(Outcome(float("nan"), False, 0.5, "too far", 0.0, 1, 0.0))
                continue
            value, slope = self.value(request.action - shift)
            found.append(Outcome(value, value > -0.2, 1.0, "", 0.0, 1, 0.0, slope if request.gradient else None))
        return found


def search(name: str, problem: Problem, seed: int = 0) -> Problem:
    with pytest.raises(BudgetSpent):
        METHODS[name].search(problem, np.zeros(4), np.random.default_rng(seed))
    return problem


ENOUGH = {"hybrid": 60, "gradient": 30, "adam": 120, "cma": 400, "cem": 500}
"""Rollouts in which each method finds the best of a bowl."""


@pytest.mark.parametrize(("name", "rollouts"), ENOUGH.items())
def test_each_method_finds_the_best_within_the_bounds(name: str, rollouts: int) -> None:
    problem = search(name, Problem(Toy(bowl), Budget(rollouts)))
    assert problem.best is not None and problem.rollouts == rollouts
    assert problem.best.fitness == pytest.approx(-0.16, abs=1e-2 if name == "cem" else 2e-3)
    assert np.abs(problem.best.action - [0.5, -0.3, 0.2, 1.0]).max() < 0.05


@pytest.mark.parametrize("name", ["hybrid", "cma"])
def test_where_nothing_touches_evolution_finds_the_way(name: str) -> None:
    problem = search(name, Problem(Toy(shelf), Budget(300)))
    assert problem.best is not None and problem.best.fitness == pytest.approx(-0.16, abs=0.01)


def stuck(x: np.ndarray) -> tuple[float, np.ndarray]:
    """What sticks: near the start a slope that leads away from where the first entry, once it is below -0.15, goes."""
    if x[0] > -0.15:
        return -9.0 + 0.01 * x[0], np.array([0.01, 0.0, 0.0, 0.0])
    return -25.0 * float((x[0] + 0.6) ** 2), np.array([-50.0 * (x[0] + 0.6), 0.0, 0.0, 0.0])


def test_a_straight_motion_breaks_what_sticks_and_a_gradient_goes_on() -> None:
    straight = {STRAIGHT: np.array([s * row for row in np.eye(4)[:3] for s in (1.0, -1.0)])}
    found = {}
    for name, given in (("with", straight), ("without", None)):
        problem = search("hybrid", Problem(Toy(stuck), Budget(25), motions=given))
        assert problem.best is not None
        found[name] = problem.best.fitness
    assert found["with"] > -1e-3 and found["without"] < -5.0


def test_a_straight_motion_that_ends_early_is_made_slower() -> None:
    """Actions with a third entry above 0.7 end early in the toy; here the only way leads there."""
    motion = np.array([[0.0, 0.0, 1.0, 0.0]])
    problem = Problem(Toy(bowl), Budget(60), motions={STRAIGHT: 1.6 * motion, OUT_AND_BACK: motion})
    search("hybrid", problem)
    tried = {kind: [e.action[2] for e in problem.history if e.phase == kind] for kind in (STRAIGHT, OUT_AND_BACK)}
    assert tried[OUT_AND_BACK][0] == 1.0 and 0.7 < tried[STRAIGHT][0] <= 1.5 * 0.8  # out and back at its bounds first
    for kind in tried:
        assert tried[kind][1:] == pytest.approx([0.4 * tried[kind][0]])


def left_behind(x: np.ndarray) -> tuple[float, np.ndarray]:
    """What comes along unless it is left fast: only near the bound of the first entry, with a slope away from there."""
    if x[0] < -0.9:
        return 0.0, np.array([-0.1, 0.0, 0.0, 0.0])
    return -1.0 - float((x[0] + 0.4) ** 2), np.array([-2.0 * (x[0] + 0.4), 0.0, 0.0, 0.0])


def test_the_best_straight_motion_is_tried_at_its_bounds() -> None:
    straight = {STRAIGHT: np.array([[1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0]])}
    problem = search("hybrid", Problem(Toy(left_behind), Budget(PROBE + 5), motions=straight))
    assert problem.best is not None and problem.best.fitness == 0.0 and problem.best.phase == STRAIGHT
    assert problem.best.action[0] == -1.0


def thrown(x: np.ndarray) -> tuple[float, np.ndarray]:
    """What is thrown where the first two entries differ by more than 1.2 and end where they began, as a ball is where
    hands turn about fast enough; near the start a small hill of its own, and a cliff for going away."""
    away, speed = x[0] + x[1], x[0] - x[1]
    if speed < 1.2:
        return 0.3 * speed - speed**2 - 20.0 * away**2 - 3.0, np.array(
            [0.3 - 2.0 * speed - 40.0 * away, -0.3 + 2.0 * speed - 40.0 * away, 0.0, 0.0]
        )
    return speed - 2.15 - 20.0 * away**2, np.array([1.0 - 40.0 * away, -1.0 - 40.0 * away, 0.0, 0.0])


def test_a_motion_out_and_back_throws_what_no_straight_motion_throws() -> None:
    straight = np.array([[1.0, 1.0, 0.0, 0.0], [-1.0, -1.0, 0.0, 0.0]])
    back = np.array([[1.0, -1.0, 0.0, 0.0], [-1.0, 1.0, 0.0, 0.0]])
    counts = {}
    for name, given in (("with", {STRAIGHT: straight, OUT_AND_BACK: back}), ("without", {STRAIGHT: straight})):
        problem = search("hybrid", Problem(Toy(thrown), Budget(200), motions=given, stop_at_success=True))
        assert problem.best is not None
        counts[name] = problem.rollouts if problem.best.success else 200
    assert counts["with"] < 0.5 * counts["without"]


def test_seeds_differ_from_evolution_on() -> None:
    """So seeds say nothing of how often a search succeeds that ends before it."""
    one, other = (search("hybrid", Problem(Toy(bowl), Budget(60)), seed).history for seed in (0, 1))
    evolved = next(k for k, e in enumerate(one) if e.phase == "CMA-ES")
    assert evolved == PROBE
    same = [np.array_equal(a.action, b.action) for a, b in zip(one, other, strict=True)]
    assert all(same[:evolved]) and not any(same[evolved : evolved + 5])


def test_hybrid_needs_fewer_rollouts_than_evolution() -> None:
    counts = {}
    for name in ("hybrid", "cma"):
        problem = search(name, Problem(Toy(bowl), Budget(400), stop_at_success=True))
        assert problem.best is not None and problem.best.success
        counts[name] = problem.rollouts
    assert counts["hybrid"] < 0.5 * counts["cma"]


@pytest.mark.parametrize("name", sorted(METHODS))
def test_a_search_that_was_ended_goes_on_as_if_it_had_not_been(tmp_path: Path, name: str) -> None:
    whole = search(name, Problem(Toy(bowl), Budget(50)))
    log = tmp_path / "log.jsonl"
    part = search(name, Problem(Toy(bowl), Budget(23), log=log))
    part.close()
    with log.open("a") as stored:
        stored.write('{"action": [0.1,')  # as of a process that was killed
    toy = Toy(bowl)
    rest = search(name, Problem(toy, Budget(50), log=log))
    assert toy.made == 50 - 23
    for a, b in zip(whole.history, rest.history, strict=True):
        assert np.array_equal(a.action, b.action) and a.fitness == b.fitness


def test_a_log_of_another_search_is_refused(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    search("cma", Problem(Toy(bowl), Budget(20), log=log), seed=1).close()
    problem = Problem(Toy(bowl), Budget(40), log=log)
    with pytest.raises(ConfigError, match="does not go the way that its log has from evaluation 0 on"):
        METHODS["cma"].search(problem, np.zeros(4), np.random.default_rng(2))


def test_the_mean_over_draws_and_over_the_worst_of_them() -> None:
    draws = [{"shift": s} for s in (-0.1, 0.0, 0.3)]
    action = np.zeros(4)
    values = [bowl(action - d["shift"]) for d in draws]
    for quantile, chosen in ((0.0, [0, 1, 2]), (0.34, [int(np.argmin([v for v, _ in values]))])):
        problem = Problem(Toy(bowl), Budget(30), draws=draws, quantile=quantile)
        found = problem.gradients([action])[0]
        assert found.fitness == pytest.approx(np.mean([values[k][0] for k in chosen]))
        assert found.gradient is not None
        np.testing.assert_allclose(found.gradient, np.mean([values[k][1] for k in chosen], axis=0))
        assert problem.rollouts == 3


def test_draws_of_a_posterior_have_its_spread_and_stay_within_bounds(tmp_path: Path) -> None:
    rig = load_rig("folding")
    fit = {
        "estimates": [
            {"name": "sheet.E_pa", "value": 3e9, "sd": 0.2, "log": True},
            {"name": "gel-sheet.friction", "value": 0.6, "sd": 0.1, "log": False},
        ],
        "correlation": [[1.0, 0.8], [0.8, 1.0]],
    }
    path = tmp_path / "fit.json"
    path.write_text(json.dumps(fit))
    draws = posterior_draws(path, rig, 4000, 0)
    drawn = np.array([[np.log(d["sheet.E_pa"]), d["contacts.gel-sheet.friction"]] for d in draws])
    np.testing.assert_allclose(drawn.mean(axis=0), [np.log(3e9), 0.6], atol=0.02)
    np.testing.assert_allclose(drawn.std(axis=0), [0.2, 0.1], rtol=0.05)
    assert np.corrcoef(drawn.T)[0, 1] == pytest.approx(0.8, abs=0.03)
    fit["estimates"][1]["sd"] = 5.0  # type: ignore[index]
    path.write_text(json.dumps(fit))
    assert min(d["contacts.gel-sheet.friction"] for d in posterior_draws(path, rig, 50, 0)) >= 0.0
    path.write_text("{}")
    with pytest.raises(ConfigError, match=r"no result of a fit.*thinshell fit"):
        posterior_draws(path, rig, 5, 0)


def test_a_run_is_a_folder_that_goes_on(tmp_path: Path) -> None:
    made, out = small_task(tmp_path), tmp_path / "run"
    first = optimise(made, Settings(method="gradient", rollouts=2), out)
    again = optimise(made, Settings(method="gradient", rollouts=4), out)
    assert (first.rollouts, again.rollouts) == (2, 4) and again.reward >= first.reward
    assert {p.name for p in out.iterdir()} == {
        "run.json", "task.yaml", "rig.yaml", "evaluations.jsonl", "result.json", "trajectory.json", "trace.npz",
    }  # fmt: skip
    whole = optimise(made, Settings(method="gradient", rollouts=4))
    assert whole.reward == again.reward
    with pytest.raises(ConfigError, match="has a search with method 'gradient', not 'cma'"):
        optimise(made, Settings(method="cma"), out)
