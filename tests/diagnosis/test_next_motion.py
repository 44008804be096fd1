"""The next experiment goes where the recording went, slowly with holds, then at its speed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig
from sim_core.rigs.motion import compile_experiment, load_experiment
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.diagnosis.next_motion import MOTION_FILE, experiment_to_yaml, in_words, next_motion
from sysid.diagnosis.result import NamedParameter
from sysid.noise.estimate import undeclared
from sysid.observations.observations import Run

SPEED_M_S, DEPTH_M, SLIDE_M, TURN_DEG = 0.02, 0.01, 0.03, 20.0
HOLD_S = 2.0


def recorded(rig: Rig) -> PoseTrajectory:
    """Down, along x while it turns about z, and up again, from 1 cm off the start of the rig, at one speed."""
    start = rig.end_effectors["finger"].start
    corners = np.array([[0.0, 0, 0], [0, 0, -DEPTH_M], [SLIDE_M, 0, -DEPTH_M], [SLIDE_M, 0, 0]])
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1) / SPEED_M_S)])
    t = np.arange(0.0, at[-1] + 1.0, 0.01)
    shifts = np.stack([np.interp(t, at, corners[:, k]) for k in range(3)], axis=1)
    turns = Rotation.from_euler("z", np.interp(t, at, [0.0, 0.0, TURN_DEG, TURN_DEG])[:, None], degrees=True)
    begin = start.position() + [0.01, 0.0, 0.0]
    return PoseTrajectory.from_samples(t, begin + shifts, (turns * start.rotation()).as_quat())


def run(poses: dict[str, PoseTrajectory]) -> Run:
    return Run("slide", "slide", (), poses, (), float(poses["finger"].times[-1]))


def test_it_goes_the_recorded_path_twice_first_at_half_the_speed_with_holds(small_rig: Any, tmp_path: Path) -> None:
    rig = small_rig()
    given = recorded(rig)
    motion = next_motion(rig, run({"finger": given}), HOLD_S)
    assert motion is not None
    (tmp_path / MOTION_FILE).write_text(experiment_to_yaml(motion))
    path = compile_experiment(load_experiment(tmp_path / MOTION_FILE), rig)["finger"]
    np.testing.assert_allclose(path.positions[0], given.positions[0], atol=1e-12)
    away = np.linalg.norm(path.positions[:, None] - given.positions, axis=2)
    assert away.min(axis=1).max() < 0.03 * SLIDE_M, "it leaves the path"
    assert away.min(axis=0).max() < 0.03 * SLIDE_M, "it leaves some of the path out"
    turned = Rotation.from_quat(path.quaternions) * Rotation.from_quat(given.quaternions[0]).inv()
    assert np.rad2deg(turned.magnitude()).max() == pytest.approx(TURN_DEG, abs=0.5)
    speed = np.linalg.norm(np.diff(path.positions, axis=0), axis=1) / np.diff(path.times)
    first = path.times[1:] < 0.5 * path.times[-1]
    assert speed[first].max() == pytest.approx(0.5 * SPEED_M_S, rel=0.05)
    assert speed.max() == pytest.approx(SPEED_M_S, rel=0.05)
    resting = speed < 1e-9
    assert np.sum(np.diff(path.times)[resting]) >= 3 * HOLD_S - 0.1, "three corners, each held"


def test_of_hands_that_stand_still_there_is_none(small_rig: Any) -> None:
    rig = small_rig()
    given = recorded(rig)
    still = PoseTrajectory.from_samples(
        given.times, 0.0 * given.positions, np.tile([0.0, 0, 0, 1], (len(given.times), 1))
    )
    assert next_motion(rig, run({"finger": still}), HOLD_S) is None
    assert next_motion(rig, run({"finger": given, "other": given}), HOLD_S) is None


def test_a_plan_is_proposed_where_the_rig_declares_its_noise(small_rig: Any) -> None:
    rig = small_rig()
    motion = next_motion(rig, run({"finger": recorded(rig)}), HOLD_S)
    assert motion is not None
    named = [NamedParameter("effects.air_drag.drag_coefficient", 1.0, (0.5, 1.5), "", "drag")]
    cameras = {n: c.model_copy(update={"noise": type(c.noise)()}) for n, c in rig.cameras.items()}
    silent = rig.model_copy(update={"cameras": cameras})
    assert undeclared(silent) and "thinshell plan" not in in_words(silent, motion, named)
    text = in_words(rig, motion, named)
    assert "thinshell show amended_rig.yaml next_experiment.yaml" in text
    assert "--params effects.air_drag.drag_coefficient" in text
    assert "thinshell plan" not in in_words(rig, motion, [])
