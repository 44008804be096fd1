"""Motions of the experiments that come with the package: a replay takes each as it is, on each rig that it fits."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.rigs import load_rig
from sim_core.rigs.load import names_in
from sim_core.rigs.motion import compile_experiment, load_experiment
from sim_core.trajectories import Limits, make_trajectory, planned_path
from thinshell_ros.replay.guard import GuardSettings
from thinshell_ros.replay.session import checked

RIGS = {name: load_rig(name) for name in names_in("rigs")}


SCENES = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text()


def fitting(name: str) -> list[str]:
    """Rigs that an experiment is for: the one that it names, or of whose scene it is, else all that have its end
    effectors."""
    plan = load_experiment(name)
    if not any(plan.motions.values()):
        return []
    if plan.rig is not None:
        return [plan.rig]
    if scene := re.search(rf"^\| `(\w+)` \| [^|]*`{name}`", SCENES, re.MULTILINE):
        return [scene[1]]
    return [rig for rig, made in RIGS.items() if set(plan.motions) == set(made.end_effectors)]


PAIRS = [(rig, name) for name in names_in("experiments") for rig in fitting(name)]


@pytest.mark.parametrize(("rig", "name"), PAIRS)
def test_a_replay_takes_it_with_default_settings(rig: str, name: str) -> None:
    poses = compile_experiment(load_experiment(name), RIGS[rig])
    trajectory = make_trajectory(RIGS[rig], {n: planned_path(p.times, p) for n, p in poses.items()})
    review = checked(trajectory, GuardSettings(Limits()), 1.0, RIGS[rig])
    assert not [text for text in review.warnings if "predicts none" not in text]


def test_each_experiment_that_moves_something_is_tried() -> None:
    moving = {name for name in names_in("experiments") if any(load_experiment(name).motions.values())}
    assert {name for _, name in PAIRS} == moving


def test_a_hand_that_may_do_less_is_refused_the_same_motion() -> None:
    rig = RIGS["lifting"]
    hands = {
        n: e.model_copy(update={"limits": e.limits.model_copy(update={"max_acceleration_m_s2": 0.1})})
        for n, e in rig.end_effectors.items()
    }
    slow = rig.model_copy(update={"end_effectors": hands})
    trajectory = make_trajectory(slow, compile_experiment(load_experiment("lift"), slow))
    with pytest.raises(ConfigError, match=r"acceleration of top is 0\.46\d* m/s\^2 at .* \(at most 0\.1 m/s\^2\)"):
        checked(trajectory, GuardSettings(Limits()), 1.0, slow)


def test_the_way_back_leaves_out_what_was_done_between_two_rests_at_one_place() -> None:
    """press_post rubs between two visits of the place above the post: the way back goes from there to the start."""
    rig = RIGS["card_press"]
    trajectory = make_trajectory(rig, compile_experiment(load_experiment("press_post"), rig))
    assert trajectory.retract is not None
    back, path = trajectory.retract.end_effectors["finger"].positions_m, trajectory.end_effectors["finger"].positions_m
    np.testing.assert_allclose(back[0], path[-1], atol=1e-9)
    np.testing.assert_allclose(back[-1], path[0], atol=1e-9)
    assert back[:, 2].min() >= min(path[0, 2], path[-1, 2]) - 1e-9, "it does not press again"
    assert path[:, 2].min() < path[-1, 2] - 2e-3


def test_the_way_to_the_start_begins_where_the_hand_waits_and_keeps_to_its_limits() -> None:
    rig = RIGS["card_press"]
    finger = rig.end_effectors["finger"]
    ready = finger.ready.model_copy(update={"position_m": (0.0, 0.0, 0.08), "rpy_deg": (0.0, 40.0, 0.0)})
    hands = {"finger": finger.model_copy(update={"ready": ready})}
    lifted = rig.model_copy(update={"end_effectors": hands})
    trajectory = make_trajectory(lifted, compile_experiment(load_experiment("press_hold_release"), lifted))
    review = checked(trajectory, GuardSettings(Limits()), 1.0, lifted)
    assert trajectory.approach is not None and trajectory.retract is not None
    start, end = (trajectory.approach.end_effectors["finger"].positions_m[row] for row in (0, -1))
    np.testing.assert_allclose(start - end, [0.0, 0.0, 0.08], atol=1e-12)
    peaks = [f.value / f.limit for f in review.figures if "on its way to the start" in f.what and f.limit]
    assert 0.8 < max(peaks) <= 1.0, "as fast as the hand may"
