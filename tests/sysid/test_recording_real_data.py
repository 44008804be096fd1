"""Recordings of real rigs. They are not part of the project; without them these tests are skipped."""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
import yaml

from sim_core.errors import RecordingError
from sysid.recording import read_recording

SHARED = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
DATA = SHARED / "data"

needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"no folder {DATA}: set THINSHELL_SHARED to the folder that holds data/"
)


def bags(pattern: str) -> list[Path]:
    return sorted(p.parent for p in DATA.glob(f"{pattern}/metadata.yaml"))


def counts(bag: Path) -> dict[str, int]:
    content = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    return {t["topic_metadata"]["name"]: t["message_count"] for t in content["topics_with_message_count"]}


@needs_data
def test_knit_fabric_stretch() -> None:
    found = bags("knit_fabric_stretch/*")
    assert len(found) == 31
    for bag in found:
        count = counts(bag)
        recording = read_recording(bag)
        assert recording.provenance.message_counts == count
        pose, wrench, tracks = recording.poses["ee"], recording.wrenches["sensor"], recording.tracks["camera"]
        assert (len(pose), len(wrench), len(tracks)) == (
            count["/current_pose"],
            count["/wrench"],
            count["/marker_tracks"],
        )
        assert (pose.frame_id, wrench.frame_id, tracks.frame_id) == (
            "top_clamp",
            "top_clamp",
            "camera_optical_frame",
        )
        np.testing.assert_array_equal(tracks.ids, np.arange(7))
        assert tracks.camera_info is None
        assert (tracks.confidence[np.isfinite(tracks.uv[:, :, 0])] == 1.0).all()
        np.testing.assert_array_equal(pose.t, tracks.t)
        # The pose was computed from the two clamp dots: direction must agree with the pixels.
        dots = tracks.uv[:, 5] - tracks.uv[:, 6]
        scale = np.linalg.norm(pose.position, axis=1) / np.linalg.norm(dots, axis=1)
        np.testing.assert_allclose(scale, scale[0], rtol=1e-3)
        assert 1.6e-4 < scale[0] < 2.6e-4


@needs_data
@pytest.mark.parametrize(("part", "unloaded"), [("cr_tactip", 1), ("franka_tactip_1", 0)])
def test_tactip_shear(part: str, unloaded: int) -> None:
    (bag,) = bags(f"tactip_shear/{part}")
    recording = read_recording(bag)
    with (bag.parent / f"{part}_labels.csv").open() as file:
        labels = list(csv.reader(file))[1:]
    images, pose = recording.images["camera"], recording.poses["ee"]
    assert recording.provenance.message_counts == counts(bag)
    assert len(images) == len(pose) + unloaded == counts(bag)["/image/compressed"]
    assert len(labels) >= len(pose)
    assert pose.topic == "/target_pose" and pose.frame_id == "plate"
    np.testing.assert_array_equal(images.t[unloaded:], pose.t)
    depth = pose.position[:, 2]
    assert 0.0004 < depth.min() and depth.max() < 0.0061
    shape = (420, 420) if unloaded else (440, 445)
    assert images.image(0).shape == images.image(len(images) - 1).shape == shape
    assert "the commanded pose is the input" in recording.summary()


@needs_data
def test_gelsight_mini() -> None:
    (bag,) = bags("gelsight_mini/*")
    with pytest.raises(RecordingError, match="holds no pose"):
        read_recording(bag)
    recording = read_recording(bag, need_pose=False)
    assert (len(recording.wrenches["sensor"]), len(recording.images["camera"])) == (122, 41)
    assert recording.wrenches["sensor"].frame_id == "ft_sensor"
    assert [image.shape for _, image in recording.images["camera"]] == [(240, 320, 3)] * 41
    assert recording.t0_ns == 1_744_664_892_082_000_000
    assert recording.duration == pytest.approx(178.512)


@needs_data
def test_oca_adhesive_shear() -> None:
    found = bags("oca_adhesive_shear/*")
    assert [bag.name for bag in found] == [
        "cyclic_0d1", "cyclic_1", "cyclic_2", "cyclic_5", "cyclic_unlabelled", "monotonic_0d05"
    ]  # fmt: skip
    for bag in found:
        recording = read_recording(bag)
        assert recording.provenance.message_counts == counts(bag)
        assert len(recording.poses["ee"]) == len(recording.wrenches["sensor"]) == counts(bag)["/wrench"]
        assert recording.poses["ee"].frame_id == "machine"
        strain = recording.poses["ee"].position[:, 0] / 1e-3
        assert 0.9 < strain.max() < 20.0
