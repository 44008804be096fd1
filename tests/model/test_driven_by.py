"""Which poses of a recording an end effector follows: measured ones, smoothed by their noise, or commanded ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import RecordingError
from sim_core.rigs import Rig, load_rig
from sysid.model.load import read_run
from sysid.observations.rig_topics import topics_of
from sysid.recording import read_recording
from sysid.recording.bag import open_bag
from sysid.recording.notes import Notes

ROOT = Path(__file__).parents[2]
BAG = ROOT / "bags" / "press_post"


def rig_with(**topics_and_driver: object) -> Rig:
    rig = load_rig("card_press")
    return rig.model_copy(
        update={"end_effectors": {n: e.model_copy(update=topics_and_driver) for n, e in rig.end_effectors.items()}}
    )


def test_an_end_effector_follows_the_poses_that_the_rig_says() -> None:
    rig = rig_with(driven_by="commanded")
    recording = read_recording(BAG, topics_of(rig, open_bag(BAG, Notes()).topics)[0])
    commanded, measured = read_run(rig, BAG).poses, read_run(rig_with(driven_by="measured"), BAG).poses
    for name in rig.end_effectors:
        np.testing.assert_array_equal(commanded[name].positions, recording.target_poses[name].position)
        np.testing.assert_array_equal(measured[name].positions, recording.poses[name].position)
        assert commanded[name].noise == (0.0, 0.0)


def test_commanded_poses_that_were_not_recorded_are_an_error() -> None:
    rig = load_rig("card_press")
    lacking = rig_with(
        driven_by="commanded",
        topics=next(iter(rig.end_effectors.values())).topics.model_copy(update={"target_pose": "nowhere"}),
    )
    with pytest.raises(RecordingError, match="driven by commanded poses, and the recording has none on nowhere"):
        read_run(lacking, BAG)
