"""Recordings of another rig: what differs is named, and what to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import RecordingError
from sim_core.rigs import config_folder, load_rig
from sysid.cli.app import main
from sysid.model.load import load_run
from sysid.observations.rig_match import check_topics, numbers_apart, places_of_topics
from sysid.observations.rig_topics import topics_of
from sysid.recording import RecordingWriter
from sysid.recording.bag import TopicInfo
from sysid.recording.message_types import CAMERA_INFO, CLOUD, IMAGE, POSE, WRENCH

PRESS_POST = config_folder().parent / "bags" / "press_post"

OF_CARD_PRESS = {
    "/current_pose": POSE,
    "/target_pose": POSE,
    "/tactile/left/wrench": WRENCH,
    "/tactile/left/markers": CLOUD,
    "/outside/marker_tracks": CLOUD,
    "/outside/camera_info": CAMERA_INFO,
    "/rosout": "rcl_interfaces/msg/Log",
}


def topics(kinds: dict[str, str]) -> dict[str, TopicInfo]:
    return {name: TopicInfo(name, (kind,), ("cdr",), 10) for name, kind in kinds.items()}


def refused(rig: str, kinds: dict[str, str]) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        check_topics(load_rig(rig), Path("press.bag"), topics(kinds))
    return caught.value


def test_a_recording_of_the_rig_is_accepted_in_any_namespace_and_with_less() -> None:
    rig = load_rig("card_press")
    check_topics(rig, Path("press.bag"), topics(OF_CARD_PRESS))
    check_topics(rig, Path("press.bag"), topics({f"/cell{t}": kind for t, kind in OF_CARD_PRESS.items()}))
    check_topics(rig, Path("press.bag"), topics({"/target_pose": POSE, "/tactile/left/wrench": WRENCH}))


def test_what_another_rigs_recording_lacks_and_what_it_has_instead_is_named() -> None:
    error = refused("material_bench", OF_CARD_PRESS)
    assert error.problem == (
        "press.bag does not match the rig 'material_bench': it lacks the pose of 'gripper' (gripper/current_pose or "
        "gripper/target_pose), the pose of 'finger' (finger/current_pose or finger/target_pose), the readings of "
        "'load_cell' (load_cell/wrench), the readings of 'wrench_gel' (tactile/finger/wrench), the readings of "
        "'gel_markers' (tactile/finger/markers); it has /current_pose, /target_pose, /tactile/left/wrench, "
        "/tactile/left/markers, which the rig does not name."
    )
    assert error.remedy == (
        "Give the rig that it was recorded with, or write the topics of the recording into this one, as in "
        "end_effectors.gripper.topics.current_pose: /current_pose."
    )


def test_the_example_is_a_topic_of_the_right_type() -> None:
    error = refused("card_press", {"/current_pose": POSE, "/marker_tracks": CLOUD, "/wrench": WRENCH})
    assert error.remedy.endswith("as in sensors.wrench_gel.topic: /wrench.")


def test_a_name_that_may_mean_two_topics_is_reported_with_both() -> None:
    two = {t: kind for t, kind in OF_CARD_PRESS.items() if kind != POSE}
    error = refused("card_press", {**two, "/finger/current_pose": POSE, "/gripper/current_pose": POSE})
    assert "(current_pose or target_pose) may be /finger/current_pose or /gripper/current_pose" in error.problem
    assert "lacks" not in error.problem and "which the rig does not name" not in error.problem
    assert error.remedy.endswith("end_effectors.finger.topics.current_pose: /finger/current_pose.")
    check_topics(load_rig("card_press"), Path("a"), topics({**OF_CARD_PRESS, "/gripper/current_pose": POSE}))


def test_images_alone_are_to_be_tracked() -> None:
    error = refused("card_press", {"/current_pose": POSE, "/outside/image/compressed": IMAGE})
    assert "which the rig does not name" not in error.problem
    assert error.remedy.startswith("Make tracks of the images of outside with 'thinshell track', give the rig")


def test_other_frames_and_other_markers_are_noted(tmp_path: Path) -> None:
    """The gel of card_press has markers 0 to 24; of this recording's the rig knows 0 to 2, and not 90 and 91."""
    ids = [0, 1, 2, 90, 91]
    at = np.column_stack([1e-3 * np.arange(5.0), np.zeros(5), np.zeros(5)])
    with RecordingWriter(tmp_path / "bag") as bag:
        for k in range(1, 30):
            bag.pose("current_pose", k * 10_000_000, (0.03, 0, 0.056), (0, 0, 0, 1), "base_link")
            bag.markers("tactile/left/markers", k * 10_000_000, at, at, ids, "tactile_left_gel")
            bag.wrench("tactile/left/wrench", k * 10_000_000, (0, 0, 1), (0, 0, 0), "elsewhere")
    (note,) = (n for n in load_run(load_rig("card_press"), tmp_path / "bag").notes if "Give the rig" in n)
    assert note == (
        "wrench_gel: /tactile/left/wrench is in the frame 'elsewhere', in the rig in 'tactile_left_gel'. gel_markers: "
        "the recording has 5 markers (0, 1, 2, 90, 91), the rig 25 (0 to 24); never seen: 3 to 24; not compared, since "
        "the rig does not know them: 90, 91. Give the rig that it was recorded with, if that is another one."
    )


@pytest.mark.parametrize(("more", "of_another"), [(3, False), (20, True)])
def test_a_few_markers_that_a_rig_leaves_out_speak_not_against_it(tmp_path: Path, more: int, of_another: bool) -> None:
    """The gel of card_press has markers 0 to 24."""
    at = np.column_stack([1e-3 * np.arange(25.0 + more), np.zeros(25 + more), np.zeros(25 + more)])
    with RecordingWriter(tmp_path / "bag") as bag:
        for k in range(1, 30):
            bag.pose("current_pose", k * 10_000_000, (0.03, 0, 0.056), (0, 0, 0, 1), "base_link")
            bag.markers("tactile/left/markers", k * 10_000_000, at, at, np.arange(25 + more), "tactile_left_gel")
    run = load_run(load_rig("card_press"), tmp_path / "bag")
    assert bool(run.unlike) == of_another
    (note,) = (n for n in run.notes if "not compared, since the rig does not know them" in n)
    assert ("Give the rig" in note) == of_another


def test_markers_of_which_the_rig_knows_none_are_refused(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "bag") as bag:
        for k in range(1, 30):
            bag.pose("current_pose", k * 10_000_000, (0.03, 0, 0.056), (0, 0, 0, 1), "base_link")
            bag.markers("tactile/left/markers", k * 10_000_000, np.eye(3), np.eye(3), [90, 91, 92], "tactile_left_gel")
    with pytest.raises(RecordingError, match=r"knows none: the recording has 3 markers \(90 to 92\), the rig 25 "):
        load_run(load_rig("card_press"), tmp_path / "bag")


def test_many_numbers_are_abbreviated() -> None:
    assert numbers_apart(np.arange(0, 40, 2), np.arange(3)).startswith(
        "the recording has 20 markers (0, 2, 4, 6, 8, 10, 12, 14, ...), the rig 3 (0 to 2); never seen: 1; not compared"
    )


def test_the_rig_names_every_topic_that_a_recording_may_lack_somewhere(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("card_press", "material_bench", "gel_sensor"):
        assert set(topics_of(load_rig(name), [])[1]) <= set(places_of_topics(load_rig(name)))
    assert main(["inspect", str(PRESS_POST), "--rig", "material_bench"]) == 0
    output = capsys.readouterr().out
    assert "missing: load_cell/wrench: the rig 'material_bench' names it in sensors.load_cell.topic, the rec" in output
    assert output.endswith("What the recording has under another name: write that name there into the rig.\n")
