"""Motions of tasks that hands can execute, and that a replay takes as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_core.rigs import HandLimits
from sim_core.tasks import ActionSpace, MadeTask, load_task, read_task, task_names
from sim_core.trajectories import Limits, check_trajectory, make_trajectory
from thinshell_ros.replay.guard import GuardSettings
from thinshell_ros.replay.session import checked

SMOOTH = [
    f"{name}:{variant}"
    for name, task in ((name, read_task(name)) for name in task_names())
    for variant, own in task.variants.items()
    if (own.actions or task.actions).profile == "linear"
]


@pytest.mark.parametrize("name", SMOOTH)
def test_a_replay_takes_every_motion_of_a_shipped_task(name: str) -> None:
    """Extreme actions and mild ones, with the settings that a replay has by default."""
    made = load_task(name)
    space, rng = ActionSpace(made), np.random.default_rng(0)
    extreme = rng.choice([-1.0, 1.0], (3, space.size))
    for action in (*extreme, 0.1 * extreme[0], np.zeros(space.size)):
        poses = space.poses(space.executable(action))
        trajectory = make_trajectory(made.rig, poses, limits=Limits(max_force_n=made.stop.most_force_n))
        review = checked(trajectory, GuardSettings(Limits()), 1.0, made.rig)
        assert not [text for text in review.warnings if "predicts none" not in text]


def test_the_motions_of_published_variants_that_jump_from_velocity_to_velocity_are_refused() -> None:
    made = load_task("folding_l:paper")
    space = ActionSpace(made)
    poses = space.poses(space.executable(np.ones(space.size)))
    assert any(
        "The acceleration of finger" in error for error in check_trajectory(make_trajectory(made.rig, poses)).errors
    )


def test_what_is_within_the_limits_stays_and_what_is_not_is_scaled_once() -> None:
    space, rng = ActionSpace(load_task("lifting")), np.random.default_rng(1)
    mild = 0.02 * rng.standard_normal(space.size)
    assert (space.executable(mild) == mild).all()
    scaled = space.executable(np.sign(mild))
    assert np.abs(scaled).max() < 1.0
    np.testing.assert_allclose(space.executable(scaled), scaled, rtol=1e-9)
    turns = (space.components >= 3) & (space.components < 6)  # 6 is the closing of a gripper
    for part in (~turns, turns):
        shares = scaled[part] / np.sign(mild)[part]
        np.testing.assert_allclose(shares, shares[0], rtol=1e-12)


def limited(name: str, **values: float) -> MadeTask:
    """A task whose hands have other limits."""
    made = load_task(name)
    hands = {
        n: e.model_copy(update={"limits": HandLimits(**{**e.limits.model_dump(), **values})})
        for n, e in made.rig.end_effectors.items()
    }
    return replace(made, rig=made.rig.model_copy(update={"end_effectors": hands}))


@pytest.mark.parametrize(
    "values",
    [
        {"max_speed_m_s": 0.02},
        {"max_acceleration_m_s2": 1.0},
        {"max_jerk_m_s3": 50.0},
        {"max_angular_speed_rad_s": 0.1, "max_acceleration_m_s2": 2.0},
        {"max_angular_jerk_rad_s3": 500.0, "max_speed_m_s": 0.1},
    ],
)
def test_each_limit_of_the_hand_holds_and_derivatives_are_those_of_central_differences(
    values: dict[str, float],
) -> None:
    made = limited("following", **values)
    space, rng = ActionSpace(made), np.random.default_rng(2)
    action, along, weights = rng.uniform(-1.0, 1.0, (3, space.size))
    executed = space.executable(action)
    assert np.abs(executed).max() < 0.9 * np.abs(action).max(), "it has to do something"
    review = check_trajectory(make_trajectory(made.rig, space.poses(executed)))
    approach_only = check_trajectory(make_trajectory(made.rig, space.poses(np.zeros(space.size)))).errors
    assert len(review.errors) <= len(approach_only), review.errors
    slope = float(space.pull_executable(action, weights) @ along)
    h = 1e-6
    ends = [float(weights @ space.executable(action + sign * h * along)) for sign in (1.0, -1.0)]
    assert (ends[0] - ends[1]) / (2.0 * h) == pytest.approx(slope, rel=1e-5)
