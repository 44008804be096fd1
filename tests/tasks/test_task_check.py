"""What a person would not call a success is none: dragged over the edge, not let go, through each other, one mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_task import TASK, small_task

from sim_core.errors import ConfigError
from sim_core.optimise import Budget, Evaluation, Problem
from sim_core.optimise.confirm import CHECKS, Confirmations
from sim_core.optimise.evaluators import LocalEvaluator
from sim_core.tasks import MadeTask, TaskRollouts, load_task
from sim_core.tasks.actions import STRAIGHT
from sim_core.tasks.check import Checker, Verdict, judged

PRESS = np.tile([0.0, 0.0, -1.0, 0.0, 0.0, 0.0], 2)
"""Presses the strip down."""


@pytest.fixture(scope="module")
def following() -> TaskRollouts:
    return TaskRollouts(load_task("following"))


def test_a_block_that_is_dragged_over_the_edge_of_the_table_does_not_follow(following: TaskRollouts) -> None:
    away = 0.5 * following.space.generic()[STRAIGHT][1]
    outcome = following.outcome(away)
    assert "block leaves table at" in outcome.stopped and not outcome.success


def test_a_finger_that_goes_through_the_table_is_seen(following: TaskRollouts) -> None:
    """No contact is declared between them, so that the rollout goes on."""
    into = 0.2 * following.space.generic()[STRAIGHT][0]
    failures, _ = judged(following, into)
    assert any("gel_below" in words and "table" in words and "through" in words for words in failures), failures


def test_a_card_under_a_block_is_not_drawn_away(following: TaskRollouts) -> None:
    rollouts = TaskRollouts(load_task("separating"))
    failures, reward = judged(rollouts, np.zeros(rollouts.space.size))
    assert reward == pytest.approx(5.63, abs=0.02)
    assert failures[0].startswith("the reward is 5.63")
    assert "table bears 0 % of the weight of block in the end" in failures
    assert "block and card touch in the end" in failures
    failures, _ = judged(following, np.zeros(following.space.size))
    assert len(failures) == 1 and "reward" in failures[0]  # there it is to be so


def asking(folder: Path, more: str = "", success: float = 0.05) -> MadeTask:
    made = small_task(folder, text=TASK + more)
    return replace(made, variant=made.variant.model_copy(update={"success": success}))


def test_a_finger_that_is_to_let_go_lets_go(tmp_path: Path) -> None:
    wanted = "conditions: {apart: [[gel, card]]}\n"
    pressed, _ = judged(TaskRollouts(asking(tmp_path, wanted, -9.0)), PRESS)
    assert pressed == ["gel and card touch in the end"]
    back = "afterwards: {retreat_m: {finger: [0.0, 0.0, 0.02]}, retreat_s: 0.1, rest_s: 0.1}\n"
    rollouts = TaskRollouts(asking(tmp_path, wanted + back, -9.0))
    assert judged(rollouts, PRESS)[0] == []
    poses, space = rollouts.poses(PRESS)["finger"].positions, rollouts.space
    assert poses[-1] - poses[space.last] == pytest.approx([0.0, 0.0, 0.02])
    assert len(space.times) - 1 - space.last == 20 and np.ptp(poses[-11:], axis=0).max() == 0.0


def test_a_success_of_one_mesh_alone_is_none(tmp_path: Path) -> None:
    """With a bound between the rewards of the two meshes."""
    verdict = Checker(asking(tmp_path, success=-9.0)).check(PRESS)
    assert verdict.passed and abs(verdict.refined_reward - verdict.reward) > 1e-4
    between = 0.5 * (verdict.reward + verdict.refined_reward)
    if verdict.reward > verdict.refined_reward:
        found = Checker(asking(tmp_path, success=between)).check(PRESS)
        assert found.failures[0].startswith("with cells and steps half as large, the reward is")
    else:
        assert not Checker(asking(tmp_path, success=between)).check(PRESS).passed
    assert Checker(asking(tmp_path, success=min(verdict.reward, verdict.refined_reward))).check(PRESS).passed


def test_cells_and_steps_are_half_as_large_and_the_motion_is_the_same(tmp_path: Path) -> None:
    made = asking(tmp_path)
    plain, fine = TaskRollouts(made), TaskRollouts(made, finer=2)
    counts = [len(r.scene.bodies["card"].nodes) for r in (plain, fine)]
    assert counts == [7 * 3, 13 * 5]
    np.testing.assert_allclose(np.diff(fine.times), 0.5 * made.task.step_s)
    a, b = (r.poses(PRESS)["finger"].positions for r in (plain, fine))
    np.testing.assert_allclose(b[::2], a, atol=1e-12)
    seen = [r.seen(PRESS)[0] for r in (plain, fine)]  # rewards that sum over steps sum over those of the task
    np.testing.assert_allclose(seen[0].times, seen[1].times, atol=1e-12)
    assert seen[0].points["sheet"].shape == seen[1].points["sheet"].shape


def test_a_torque_or_a_force_above_that_of_a_hand_ends_the_rollout(tmp_path: Path) -> None:
    made = small_task(tmp_path, text=TASK.replace(", target_seed: 3", ""))
    for limit, words in (({"max_force_n": 0.01}, "N at"), ({"max_torque_nm": 1e-5}, "N m at")):
        hand = made.rig.end_effectors["finger"]
        hand = hand.model_copy(update={"limits": hand.limits.model_copy(update=limit)})
        rig = made.rig.model_copy(update={"end_effectors": {"finger": hand}})
        stopped = TaskRollouts(replace(made, rig=rig)).outcome(PRESS).stopped
        assert "a finger bears" in stopped and words in stopped


def test_conditions_name_what_the_rig_has(tmp_path: Path) -> None:
    for more, message in (
        ("conditions: {rests_on: {crad: gel}}", "crad.*card"),
        ("conditions: {apart: [[card, card]]}", "no contact"),
        ("stop: {over: {sheet: card}}", "no rigid body"),
        ("afterwards: {retreat_s: 0.1}", "retreat_m"),
    ):
        with pytest.raises(ConfigError, match=rf"(?s){message}"):
            small_task(tmp_path, text=TASK + more + "\n")


def test_checks_are_written_down_and_made_where_more_than_what_was_missing_is_gained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, checked = asking(tmp_path, success=1.0), []

    def check(self: Checker, action: np.ndarray) -> Verdict:
        checked.append(float(action[0]))
        return Verdict(("too little",), 1.1, 0.7, 1.0) if action[0] < 5.0 else Verdict((), 2.0, 2.0, 1.0)

    monkeypatch.setattr(Checker, "check", check)

    def tried(confirm: Confirmations, fitness: float) -> bool:
        return confirm(Evaluation(np.array([fitness]), fitness, None, (), "", 0.0))

    confirm = Confirmations(made, tmp_path)
    assert not tried(confirm, 1.1)  # 0.3 are missing with finer cells
    assert not tried(confirm, 1.3) and checked == [1.1]
    assert not tried(confirm, 1.5) and checked == [1.1, 1.5]
    again = Confirmations(made, tmp_path)
    assert not tried(again, 1.1) and not tried(again, 1.5) and checked == [1.1, 1.5]
    assert tried(again, 5.0) and len((tmp_path / CHECKS).read_text().splitlines()) == 3
    assert again.cpu_s == 3.0


def test_a_search_goes_on_where_the_check_says_no(tmp_path: Path) -> None:
    made = asking(tmp_path, success=-9.0)
    counts = []
    for answer in (False, True):
        problem = Problem(
            LocalEvaluator(TaskRollouts(made)),
            Budget(3),
            stop_at_success=True,
            confirm=lambda _, answer=answer: answer,  # type: ignore[misc]
        )
        try:
            problem.values([PRESS, 0.5 * PRESS, 0.2 * PRESS, PRESS])
        except Exception:
            counts.append((problem.rollouts, problem.confirmed is not None))
    assert counts == [(3, False), (1, True)]
