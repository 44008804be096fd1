"""Rollouts of a small task: gradients, repeatability, early stops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_task import RIG, TASK, small_task

from sim_core.tasks import TaskRollouts, load_task
from sim_core.tasks.actions import OUT_AND_BACK


@pytest.mark.parametrize("reward", ["folding", "forming"])
def test_the_gradient_is_that_of_central_differences(tmp_path: Path, reward: str) -> None:
    """Through contact, friction and yielding; by a reward of fold angles and one of positions."""
    rollouts = TaskRollouts(small_task(tmp_path, reward))
    rng = np.random.default_rng(2)
    action = 0.3 * rng.standard_normal(rollouts.space.size)
    action[[2, 8]] = -0.9, -0.8  # down, so that the strip yields
    along = rng.standard_normal(rollouts.space.size)
    found = rollouts.gradient(action)
    assert found.gradient is not None and found.reward != 0.0
    slope, h = float(found.gradient @ along), 1e-4
    ends = [rollouts.outcome(action + s * h * along).reward for s in (1.0, -1.0)]
    assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(slope, rel=2e-4)


def test_a_rollout_does_not_depend_on_those_before(tmp_path: Path) -> None:
    rollouts = TaskRollouts(small_task(tmp_path))
    rng = np.random.default_rng(3)
    one, other = 0.5 * rng.standard_normal((2, rollouts.space.size))
    first = rollouts.outcome(one).reward
    rollouts.outcome(other)
    rollouts.gradient(other)
    assert rollouts.outcome(one).reward == first
    assert TaskRollouts(small_task(tmp_path)).outcome(one).reward == first
    assert rollouts.gradient(one).reward == pytest.approx(first, rel=1e-6)


def test_a_robot_that_does_not_obey_does_so_in_each_kind_of_rollout(tmp_path: Path) -> None:
    """What acts on commands counts with the gradient and without it, as where a trajectory is rolled out."""
    rewards = {}
    for share in (0.0, -0.2):
        scale = f"\n  command_scale: {{scale_x: 0.0, scale_y: 0.0, scale_z: {share}}}"
        (tmp_path / "rig.yaml").write_text(RIG.replace("\neffects:", f"\neffects:{scale}"))
        text = TASK.replace("REWARD", "folding").replace("rig: RIG", "rig: rig.yaml")
        (tmp_path / "task.yaml").write_text(text)
        rollouts = TaskRollouts(load_task(str(tmp_path / "task.yaml")))
        action = np.zeros(rollouts.space.size)
        action[[2, 8]] = -0.9, -0.8
        rewards[share] = rollouts.outcome(action).reward
        assert rollouts.gradient(action).reward == pytest.approx(rewards[share], rel=1e-6)
    assert abs(rewards[-0.2] - rewards[0.0]) > 1e-3 * abs(rewards[0.0])


def test_the_target_may_be_made_on_another_rig(tmp_path: Path) -> None:
    """So the goal stays where it was while the rig is amended; rigs are found next to the file of the task."""
    given = TaskRollouts(small_task(tmp_path, "forming"))
    softer = RIG.replace("E_pa: 2.0e9", "E_pa: 1.6e9")
    (tmp_path / "softer.yaml").write_text(softer)
    text = TASK.replace("REWARD", "forming").replace("rig: RIG", "rig: softer.yaml\ntarget_rig: rig.yaml")
    (tmp_path / "amended.yaml").write_text(text)
    amended = TaskRollouts(load_task(str(tmp_path / "amended.yaml")))
    assert (amended.target["sheet"] == given.target["sheet"]).all()
    (tmp_path / "moved.yaml").write_text(text.replace("target_rig: rig.yaml", ""))
    moved = TaskRollouts(load_task(str(tmp_path / "moved.yaml")))
    assert np.abs(moved.target["sheet"] - given.target["sheet"]).max() > 1e-6


def test_a_force_above_the_limit_ends_the_rollout(tmp_path: Path) -> None:
    rollouts = TaskRollouts(small_task(tmp_path, text=TASK + "stop: {most_force_n: 0.012}\n"))
    action = np.zeros((2, 6))
    action[:, 2] = -1.0
    for outcome in (rollouts.outcome(action.ravel()), rollouts.gradient(action.ravel())):
        assert "a finger bears" in outcome.stopped and "more than 0.012" in outcome.stopped
        assert 0.0 < outcome.completed < 1.0 and outcome.gradient is None
        assert outcome.fitness < -1e8


def test_no_contact_ends_the_rollout(tmp_path: Path) -> None:
    text = TASK.replace(", target_seed: 3", "") + "stop: {least_force_n: 0.01, touching_from: 6}\n"
    rollouts = TaskRollouts(small_task(tmp_path, text=text))
    away = np.zeros((2, 6))
    away[:, 2] = 1.0
    assert "no finger bears" in rollouts.outcome(away.ravel()).stopped
    assert not rollouts.outcome(-away.ravel()).stopped


def test_a_fold_angle_is_the_turn_of_a_strip_that_kept_it(tmp_path: Path) -> None:
    """A strip whose end was pressed down turns downwards by what all of it kept: a negative angle across its length."""
    text = TASK.replace("at_m: -0.01, over_m: 0.02", "at_m: 0.005, over_m: 0.05")
    rollouts = TaskRollouts(small_task(tmp_path, "pick_folding", text))
    action = np.zeros((2, 6))
    action[:, 2] = -1.0
    seen, reward = rollouts.seen(action.ravel())
    assert seen.folds["middle"] < -0.01
    # Of it a hundredth of the whole angle between the chords before and after the middle, negative too.
    chords = np.diff([seen.points[name][-1].mean(axis=0) for name in ("before", "middle", "after")], axis=0)
    slopes = np.arctan2(chords[:, 2], chords[:, 0])
    assert slopes[1] < slopes[0]
    assert reward == pytest.approx(-3.0 * (seen.folds["middle"] + 0.01 * (slopes[1] - slopes[0])))


@pytest.mark.slow
def test_both_hands_up_and_back_throw_a_ball_as_free_flight_says() -> None:
    """With knots a sixth of T = 0.2 s apart, hands go up at v = 0.6 m/s from T/6 on and slow down from T/3 on, then
    vT/4 high, at 18 m/s^2. So there the ball leaves: it flies v^2 / 2g higher, and for the 2T/3 that are left."""
    rollouts = TaskRollouts(load_task("throwing"))
    duration, speed, gravity = 0.2, 0.6, 9.81
    up = rollouts.space.generic()[OUT_AND_BACK][8]
    start = next(iter(rollouts.space.poses(up).values())).positions[rollouts.space.first]
    lifted = max(np.max(p.positions[:, 2]) for p in rollouts.space.poses(up).values()) - start[2]
    assert lifted == pytest.approx(speed * duration / 3, rel=0.01)
    found = rollouts.outcome(up)
    assert found.success, found
    heights = rollouts.episode.outputs()["task_points_ball"][:, 0, 2]
    left, flight = speed * duration / 4, 2.0 * duration / 3
    assert np.ptp(heights) == pytest.approx(left + speed**2 / (2.0 * gravity), abs=1.5e-3)
    end = left + speed * flight - 0.5 * gravity * flight**2
    assert heights[-1] - heights[0] == pytest.approx(end, abs=1.5e-3)
