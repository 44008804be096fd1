"""Recorded wrenches, marker clouds and image tracks."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_messages import (
    IDS,
    UV,
    WRENCH,
    XYZ,
    log_time,
    markers,
    notes,
    poses,
    read,
    store,
    tracks,
    wrench,
    wrenches,
)

from sim_core.errors import RecordingError
from sysid.recording import Recording, SensorTopic, TopicNames, read_recording


def test_components_that_are_not_finite_are_masked(tmp_path: Path) -> None:
    items = wrenches(m=(np.nan, np.inf, 0.5))
    recording = read(tmp_path, poses() + items)
    stream = recording.wrenches["sensor"]
    np.testing.assert_array_equal(stream.mask, np.tile([True, True, True, False, False, True], (20, 1)))
    assert np.isnan(stream.torque[:, :2]).all() and (stream.torque[:, 2] == 0.5).all()
    assert "never measured: torque_x, torque_y" in notes(recording) and "masked" not in notes(recording)


def test_readings_that_lack_a_component_are_counted(tmp_path: Path) -> None:
    items = wrenches(18) + wrenches(20, m=(np.nan, 0.0, 0.5))[18:]
    recording = read(tmp_path, poses() + items)
    assert "2 messages with NaN or infinite components, masked" in notes(recording)


def test_a_wrench_with_nothing_but_nan(tmp_path: Path) -> None:
    nan = (np.nan,) * 3
    items = [("/wrench", WRENCH, t, wrench(t, nan, nan)) for t in map(log_time, range(5))]
    with pytest.raises(RecordingError, match="every wrench holds only NaN"):
        read(tmp_path, poses() + items)


def test_torques_in_newton_millimetres_can_be_declared(tmp_path: Path) -> None:
    topics = TopicNames(wrench={"sensor": SensorTopic(length_unit="mm")})
    recording = read(tmp_path, poses() + wrenches(m=(5.0, 0, 0)), topics)
    np.testing.assert_allclose(recording.wrenches["sensor"].torque[:, 0], 0.005)
    np.testing.assert_allclose(recording.wrenches["sensor"].force[1, 2], 0.1)


def test_forces_of_another_unit_are_said(tmp_path: Path) -> None:
    items = [("/wrench", WRENCH, t, wrench(t, (0, 0, 2e4))) for t in map(log_time, range(5))]
    assert "look whether they are in newtons" in notes(read(tmp_path, poses() + items))


def assert_markers(recording: Recording) -> None:
    stream = recording.markers["sensor"]
    np.testing.assert_array_equal(stream.ids, [2, 4, 9])
    expected = np.stack([XYZ[axis] for axis in "xyz"], axis=-1)[[2, 0, 1]]
    np.testing.assert_allclose(stream.position, np.tile(expected, (6, 1, 1)), rtol=1e-6)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"order": ">"},
        {"gap": 3},
        {"rows": 3, "row_padding": 5},
        {"kinds": {"x": "f8", "y": "f8", "z": "f8", "id": "i2"}},
        {"kinds": {"id": "f4"}},
    ],
)
def test_layouts_of_a_cloud(tmp_path: Path, options: dict[str, Any]) -> None:
    recording = read(tmp_path, poses(6) + markers(lambda k: {**XYZ, "id": IDS}, **options))
    assert_markers(recording)
    assert recording.markers["sensor"].displacement is None
    assert recording.markers["sensor"].rest is None
    assert recording.notes == ()


def test_missing_rows_nan_and_doubled_ids(tmp_path: Path) -> None:
    def columns(k: int) -> dict[str, Any]:
        full = {**XYZ, "id": IDS.copy()}
        if k == 1:
            return {name: values[:2] for name, values in full.items()}
        if k == 2:
            full["y"] = np.array([0.0, np.nan, 0.001])
        if k == 3:
            full["id"][2] = 4
        return full

    recording = read(tmp_path, poses(6) + markers(columns))
    stream = recording.markers["sensor"]
    seen = np.isfinite(stream.position).all(axis=2)
    expected = np.ones((6, 3), dtype=bool)
    expected[1, 0] = expected[2, 2] = expected[3, 0] = False  # columns: ids 2, 4, 9
    np.testing.assert_array_equal(seen, expected)
    np.testing.assert_allclose(stream.position[3, 1], [0.0, 0.0, 0.003], rtol=1e-6)  # the first of two
    assert "1 point with NaN taken as missing markers" in notes(recording)
    assert "1 point with an id already used in its message dropped" in notes(recording)


def test_no_ids(tmp_path: Path) -> None:
    recording = read(tmp_path, poses(6) + markers(lambda k: XYZ))
    np.testing.assert_array_equal(recording.markers["sensor"].ids, [0, 1, 2])
    assert "markers are identified by their row" in notes(recording)


def test_no_ids_and_a_varying_number_of_rows(tmp_path: Path) -> None:
    items = markers(lambda k: {name: v[: 3 - (k == 2)] for name, v in XYZ.items()})
    with pytest.raises(RecordingError, match="no field id, and from 2 to 3 rows"):
        read(tmp_path, poses(6) + items)


def test_ids_that_are_not_stable(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="18 different ids, but 3 markers a message"):
        read(tmp_path, poses(6) + markers(lambda k: {**XYZ, "id": IDS + 100 * k}))


def test_ids_that_are_not_whole(tmp_path: Path) -> None:
    items = markers(lambda k: {**XYZ, "id": IDS + 0.5}, kinds={"id": "f4"})
    with pytest.raises(RecordingError, match="not whole"):
        read(tmp_path, poses(6) + items)


def test_missing_fields(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"has no field z \(it has x, y, id\)"):
        read(tmp_path, poses(6) + markers(lambda k: {"x": XYZ["x"], "y": XYZ["y"], "id": IDS}))


def test_a_cloud_shorter_than_it_states(tmp_path: Path) -> None:
    items = markers(lambda k: {**XYZ, "id": IDS})
    items[2][3].data = items[2][3].data[:-8]
    recording = read(tmp_path, poses(6) + items)
    assert len(recording.markers["sensor"]) == 5
    assert "s after the first of this topic, holds 40 bytes where 1 x 3 points of 16" in notes(recording)


def test_markers_that_are_never_finite(tmp_path: Path) -> None:
    nan = {axis: np.full(3, np.nan) for axis in "xyz"}
    with pytest.raises(RecordingError, match="no message holds a finite marker"):
        read(tmp_path, poses(6) + markers(lambda k: {**nan, "id": IDS}))


def test_markers_in_millimetres_are_refused_and_can_be_declared(tmp_path: Path) -> None:
    in_mm = {axis: 1e3 * values for axis, values in XYZ.items()}
    path = store(tmp_path / "bag", poses(6) + markers(lambda k: {**in_mm, "id": IDS}))
    with pytest.raises(RecordingError, match=r"/markers: .*look like millimetres"):
        read_recording(path)
    topics = TopicNames(markers={"sensor": SensorTopic(length_unit="mm")})
    assert_markers(read_recording(path, topics))


def test_displacements_in_millimetres_are_refused(tmp_path: Path) -> None:
    moved = {"dx": np.zeros(3), "dy": np.zeros(3), "dz": np.array([0.0, 2.0, 0.0])}
    with pytest.raises(RecordingError, match="move by up to 2 m"):
        read(tmp_path, poses(6) + markers(lambda k: {**XYZ, **moved, "id": IDS}))


def test_tracks_without_confidence(tmp_path: Path) -> None:
    recording = read(tmp_path, poses(6) + tracks({**UV, "id": IDS}))
    stream = recording.tracks["camera"]
    np.testing.assert_array_equal(stream.confidence, 1.0)
    np.testing.assert_array_equal(stream.uv[0], [[30.5, 6.0], [1.0, 4.0], [20.0, 5.0]])
    assert stream.camera_info is None
    assert "no confidence given: taken as 1" in notes(recording)
    assert "no camera_info for camera 'camera'" in notes(recording)


def test_confidence_outside_its_range(tmp_path: Path) -> None:
    recording = read(tmp_path, poses(6) + tracks({**UV, "id": IDS, "confidence": np.array([-1.0, 0.5, 100.0])}))
    np.testing.assert_array_equal(recording.tracks["camera"].confidence[0], [1.0, 0.0, 0.5])
    assert "confidence from -1 to 100 limited to 0..1" in notes(recording)


def test_tracks_with_other_field_names(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"has no field u, v \(it has x, y, id\)"):
        read(tmp_path, poses(6) + tracks({"x": UV["u"], "y": UV["v"], "id": IDS}))


@pytest.mark.parametrize("offset", [12, 2**31 - 4, 2**32 - 4])
def test_a_field_beyond_its_point_costs_its_message_alone(tmp_path: Path, offset: int) -> None:
    """numpy adds offset and size in 32 bits, and would read where there is nothing."""
    items = poses() + tracks({**UV, "id": IDS, "confidence": np.ones(3)})
    topic, _, _, message = items[-1]
    message.fields[0].offset = message.point_step if offset == 12 else offset
    recording = read(tmp_path, items)
    assert len(recording.tracks["camera"]) == sum(item[0] == topic for item in items) - 1
    assert "has fields that reach to byte" in notes(recording)


@pytest.mark.parametrize("change", ["name", "datatype"])
def test_one_cloud_of_other_fields_is_left_out(tmp_path: Path, change: str) -> None:
    """Without its id, or with ids that are no whole numbers, the other messages keep theirs."""
    items = poses() + tracks({**UV, "id": IDS, "confidence": np.ones(3)})
    field = next(f for f in items[-1][3].fields if f.name == "id")
    setattr(field, change, "number" if change == "name" else 7)
    stream = read(tmp_path, items).tracks["camera"]
    assert stream.ids.tolist() == sorted(int(k) for k in IDS)
    assert np.isnan(stream.uv[-1]).all() and np.isfinite(stream.uv[:-1]).all()
