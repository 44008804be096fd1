"""Actions of hands as poses of end effectors, and derivatives back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_task import TASK, small_task

from sim_core.errors import ConfigError
from sim_core.tasks import ActionSpace, load_task
from sim_core.tasks.actions import OUT_AND_BACK, STRAIGHT


def test_a_gripper_turns_about_its_middle_and_closes() -> None:
    space = ActionSpace(load_task("following"))
    rng = np.random.default_rng(0)
    action = np.clip(rng.standard_normal(space.size), -1.0, 1.0)
    poses = space.poses(action)
    above, below = poses["above"], poses["below"]
    gap = np.linalg.norm(above.positions - below.positions, axis=1)[space.first :]
    closing = action.reshape(5, 7)[:, 6]
    first = gap[0] - gap[-1]
    # Each finger moves by the sum of the weights of a knot, which is steps / (knots + 1), times the bound.
    assert first == pytest.approx(2.0 * 1e-4 * 60 / 6 * closing.sum(), rel=1e-9)
    ways = [Rotation.from_quat(p.quaternions[-1]) * Rotation.from_quat(p.quaternions[space.first]).inv()
            for p in (above, below)]  # fmt: skip
    np.testing.assert_allclose(ways[0].as_matrix(), ways[1].as_matrix(), atol=1e-12)
    axis = above.positions - below.positions
    np.testing.assert_allclose(
        ways[0].apply(axis[space.first]) / gap[0], axis[-1] / np.linalg.norm(axis[-1]), atol=1e-12
    )
    assert np.abs(action).max() == 1.0
    middle = 0.5 * (above.positions + below.positions)
    assert np.abs(np.diff(middle[:, 0])).max() <= 0.002 + 1e-12


def test_derivatives_by_actions_are_those_of_central_differences() -> None:
    """For a loss that is any function of the poses: here a linear one of positions and of turned vectors."""
    space = ActionSpace(load_task("following"))
    rng = np.random.default_rng(1)
    action, along = 0.5 * rng.standard_normal((2, space.size))
    n = len(space.times)
    pull = {f: rng.standard_normal((n, 3)) for f in ("above", "below")}
    arms = {f: rng.standard_normal((n, 3)) for f in ("above", "below")}

    def loss(a: np.ndarray) -> float:
        total = 0.0
        for f, pose in space.poses(a).items():
            tips = pose.positions + 0.01 * Rotation.from_quat(pose.quaternions).apply(arms[f])
            total += float((pull[f] * tips).sum())
        return total

    by_poses = {}
    for f, pose in space.poses(action).items():
        turns = Rotation.from_quat(pose.quaternions)
        force = turns.inv().apply(pull[f])
        by_poses[f] = np.hstack([force, np.cross(0.01 * arms[f], force)])
    slope = float(space.pull(action, by_poses) @ along)
    h = 1e-5
    assert (loss(action + h * along) - loss(action - h * along)) / (2 * h) == pytest.approx(slope, rel=1e-6)


def test_straight_motions_are_of_all_hands_alike_and_of_one_against_the_other() -> None:
    space = ActionSpace(load_task("pick_folding"))
    motions = space.generic()[STRAIGHT]
    assert motions.shape == (12, space.size)
    ends = []
    for motion in motions[:4]:
        way = {f: p.positions[space.last] - p.positions[space.first] for f, p in space.poses(motion).items()}
        ends.append([way["left"][0], way["right"][0]])
        assert all(abs(w[1]) + abs(w[2]) == 0.0 for w in way.values())
    whole = 0.001 * 60 * 5 / 6  # the share of the steps that the knots' weights add up to
    np.testing.assert_allclose(ends, whole * np.array([[1, 1], [-1, -1], [1, -1], [-1, 1]]), rtol=1e-9)


@pytest.mark.parametrize("name", ["throwing", "lifting:paper", "folding_l:paper", "separating:paper"])
def test_motions_out_and_back_end_where_they_began(name: str) -> None:
    """Whatever the profile between knots, also where 29 steps are shared unevenly by 5 knots."""
    space = ActionSpace(load_task(name))
    kinds = space.generic()
    assert kinds[OUT_AND_BACK].shape == kinds[STRAIGHT].shape
    for motion, straight in zip(kinds[OUT_AND_BACK], kinds[STRAIGHT], strict=True):
        assert np.abs(motion).max() == 1.0
        turn = (space.first + space.last) // 2
        axes = []
        for pose, other in zip(space.poses(motion).values(), space.poses(straight).values(), strict=True):
            way, whole = (p.positions[space.first : space.last + 1] - p.positions[space.first] for p in (pose, other))
            np.testing.assert_allclose(way[-1], 0.0, atol=1e-12)
            far = np.abs(way[turn - space.first]).max()
            assert 0.35 <= far / max(np.abs(whole[-1]).max(), 1e-9) <= 0.55 or far == np.abs(whole).max() == 0.0
            axes.append(np.flatnonzero(np.abs(way).max(axis=0) > 1e-12))
        assert len({tuple(a) for a in axes if len(a)}) == 1


def test_an_action_of_another_length_is_refused(tmp_path: Path) -> None:
    space = ActionSpace(small_task(tmp_path))
    with pytest.raises(ConfigError, match=r"has 12 finite numbers, not an array of shape \(3,\)"):
        space.poses(np.zeros(3))


def test_constant_profiles_hold_each_velocity(tmp_path: Path) -> None:
    made = small_task(tmp_path, text=TASK.replace("knots: 2", "knots: 2\n  profile: constant"))
    space = ActionSpace(made)
    action = np.zeros((2, 6))
    action[0, 0], action[1, 1] = 1.0, -0.5
    way = np.diff(space.poses(action.ravel())["finger"].positions[space.first :], axis=0)
    np.testing.assert_allclose(way[:4], [[6e-4, 0, 0]] * 4, atol=1e-15)
    np.testing.assert_allclose(way[4:], [[0, -3e-4, 0]] * 4, atol=1e-15)
