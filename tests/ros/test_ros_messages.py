"""Messages built from plain values, every field checked by the middleware."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_core.rigs import FisheyeCamera, PinholeCamera, load_rig
from sysid.recording.clouds import cloud_fields
from thinshell_ros.clouds import marker_points, marker_positions, track_points
from thinshell_ros.health import Report
from thinshell_ros.poses import Pose

pytestmark = pytest.mark.ros
STAMP = 3 * 10**9 + 5


@pytest.fixture
def messages(ros: None) -> Iterator[Any]:
    from thinshell_ros import messages

    yield messages


def test_pose_and_wrench(messages: Any) -> None:
    pose = messages.pose(STAMP, "base_link", Pose(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.6, 0.0, 0.8])))
    assert (pose.header.stamp.sec, pose.header.stamp.nanosec, pose.header.frame_id) == (3, 5, "base_link")
    assert (pose.pose.position.z, pose.pose.orientation.y, pose.pose.orientation.w) == (3.0, 0.6, 0.8)
    wrench = messages.wrench(STAMP, "cell", np.arange(6, dtype=np.float32))
    assert (wrench.wrench.force.y, wrench.wrench.torque.z) == (1.0, 5.0)
    assert messages.clock(STAMP).clock.nanosec == 5


def test_clouds_read_back(messages: Any) -> None:
    rest = np.random.default_rng(0).random((5, 3))
    markers = messages.cloud(STAMP, "gel", marker_points(rest + 0.5, rest, np.arange(5)))
    assert (markers.height, markers.width, markers.point_step, markers.row_step) == (1, 5, 40, 200)
    assert (markers.is_dense, markers.is_bigendian) == (False, False)
    fields = cloud_fields(markers)
    np.testing.assert_allclose(fields["dy"], 0.5, atol=1e-6)
    np.testing.assert_allclose(fields["z"], rest[:, 2] + 0.5, atol=1e-6)
    assert fields["id"].tolist() == [0, 1, 2, 3, 4]

    tracks = messages.cloud(STAMP, "eye", track_points(rest[:, :2], np.arange(5)))
    assert (tracks.point_step, tracks.is_dense) == (16, True)
    assert cloud_fields(tracks)["confidence"].tolist() == [1.0] * 5
    assert messages.cloud(STAMP, "eye", track_points(np.full((3, 2), np.nan), np.arange(3))).width == 0


def test_camera_info(messages: Any) -> None:
    camera = load_rig(Path(__file__).parent / "data" / "press_gel.yaml").cameras["side"]
    assert isinstance(camera, PinholeCamera)
    info = messages.camera_info(STAMP, "eye", camera)
    assert (info.distortion_model, len(info.d), info.k[4], info.p[5], info.p[10]) == (
        "plumb_bob", 5, 1400.0, 1400.0, 1.0,
    )  # fmt: skip
    data = camera.model_dump() | {"model": "fisheye", "distortion": (0.1, 0.0, 0.0, 0.0)}
    info = messages.camera_info(STAMP, "eye", FisheyeCamera.model_validate(data))
    assert (info.distortion_model, list(info.d)) == ("equidistant", [0.1, 0.0, 0.0, 0.0])


def test_diagnostics(messages: Any) -> None:
    reports = [Report("physics", "error", "It failed.", {"nan_count": "3"}), Report("commands", "ok", "fine")]
    array = messages.diagnostics(STAMP, "/thinshell_sim", "card_press", reports)
    assert [s.name for s in array.status] == ["/thinshell_sim: physics", "/thinshell_sim: commands"]
    assert [s.level for s in array.status] == [b"\x02", b"\x00"]
    assert (array.status[0].values[0].key, array.status[0].values[0].value) == ("nan_count", "3")


def test_markers_are_read_back_from_a_cloud_and_not_from_one_that_has_none(messages: Any) -> None:
    rest = np.arange(12.0).reshape(4, 3) * 1e-3
    moved = rest + 1e-4
    moved[2] = np.nan
    cloud = messages.cloud(STAMP, "gel", marker_points(moved, rest, np.array([5, 0, 2, 9])))
    layout = {field.name: (field.offset, field.datatype) for field in cloud.fields}
    ids, positions = marker_positions(bytes(cloud.data), cloud.point_step, layout)
    assert ids.tolist() == [5, 0, 9]
    np.testing.assert_allclose(positions, moved[[0, 1, 3]], atol=1e-9)
    for wrong in (
        {},
        {**layout, "id": (36, 7)},
        {**layout, "id": (38, 6)},
        {k: v for k, v in layout.items() if k != "z"},
    ):
        assert marker_positions(bytes(cloud.data), cloud.point_step, wrong)[0].size == 0
    assert marker_positions(bytes(cloud.data)[:-1], cloud.point_step, layout)[0].size == 0
