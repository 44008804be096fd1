"""Recordings of rerun: what is written is read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.rigs import PinholeCamera, Pose, load_rig
from sysid.cli.app import main
from sysid.show.rerun_export import TIMELINE, write_rrd
from sysid.show.subject import Marks, Subject, resting, still

RISE_M = 0.0004
TURN_RAD = 0.02
APART_PX = 3.0


def pressed(measured: bool) -> Subject:
    """A card carried down and turned in three states over a gel whose markers lie in a turned frame; measured readings
    that differ from the simulated ones."""
    rig = load_rig("card_press")
    turned = rig.sensors["gel_markers"].model_copy(update={"pose": Pose(position_m=(0, 0, 0.01), rpy_deg=(0, 0, 90))})
    subject = still(rig.model_copy(update={"sensors": {**rig.sensors, "gel_markers": turned}}))
    layout = subject.layout
    down, spin = np.array([0.0, 0.0, -RISE_M]), Rotation.from_rotvec([0.0, 0.0, TURN_RAD])
    frames = [
        {n: (origin + k * down, spin**k * turn) if n == "finger" else (origin, turn)
         for n, (origin, turn) in layout.start.items()}
        for k in range(3)
    ]  # fmt: skip
    x = np.stack([layout.carried(f) for f in frames])
    wrenches = {"force_plate": np.arange(18.0).reshape(3, 6)}
    found = replace(
        subject, times=np.array([0.0, 0.1, 0.2]), states=resting(layout, x, frames), frames=tuple(frames),
        what="recording", wrenches=wrenches,
    )  # fmt: skip
    if not measured:
        return found
    steps = np.arange(3)
    markers = {}
    for name, marks in found.markers.items():
        values = found.predicted_markers(name, steps) + [0.0, 0.0, 1e-4]
        values[1, 0] = np.nan
        markers[name] = Marks(marks.channel, marks.bodies, marks.tracked, marks.ids, values)
    tracks = {}
    for name, marks in found.tracks.items():
        seen = np.stack([found.pixels(name, k) for k in steps]) + [APART_PX, 0.0]
        tracks[name] = Marks(marks.channel, marks.bodies, marks.tracked, marks.ids, seen)
    other = {"force_plate": wrenches["force_plate"] + 0.5}
    other["force_plate"][0] = np.nan
    return replace(found, markers=markers, tracks=tracks, measured_wrenches=other)


def read(path: Path) -> dict[str, list[tuple[float, dict[str, Any]]]]:
    """Entities of a file: times [s] and components, in order."""
    chunk = pytest.importorskip("rerun.chunk", reason="rerun-sdk, of the extra 'rerun', is not installed")
    found: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    for part in chunk.RrdReader(path).stream().to_chunks():
        batch = part.to_record_batch()
        names = batch.schema.names
        times = np.full(batch.num_rows, np.nan)
        if TIMELINE in names:
            times = 1e-9 * np.array([value.value for value in batch.column(TIMELINE)], dtype=float)
        columns = {n: batch.column(n).to_pylist() for n in names if ":" in n}
        for row, time in enumerate(times.tolist()):
            values = {n: v[row] for n, v in columns.items()}
            found.setdefault(part.entity_path, []).append((time, values))
    return {name: sorted(rows, key=lambda r: r[0]) for name, rows in found.items()}


def values_of(rows: list[tuple[float, dict[str, Any]]], component: str) -> list[np.ndarray]:
    return [np.array(next(v for n, v in values.items() if n.endswith(f":{component}"))) for _, values in rows]


PROC = Path("/proc")
"""In it, nobody can make a file."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    pytest.importorskip("rerun", reason="rerun-sdk, of the extra 'rerun', is not installed")
    return tmp_path / "press.rrd"


def test_bodies_hands_and_markers_are_where_they_are(path: Path) -> None:
    subject = pressed(measured=True)
    write_rrd(subject, path)
    there = read(path)
    for surface in subject.skins:
        rows = there[f"/world/bodies/{surface.body}"]
        assert [time for time, _ in rows] == pytest.approx([0.0, 0.1, 0.2])
        x, frames = subject.states.positions[2], subject.frames[2]
        np.testing.assert_allclose(
            values_of(rows, "vertex_positions")[2], surface.vertices(subject.layout, x, frames), atol=1e-7
        )
    for hand in subject.rig.end_effectors:
        places = values_of(there[f"/world/hands/{hand}"], "translation")
        np.testing.assert_allclose(places[2].ravel() - places[0].ravel(), [0.0, 0.0, -2.0 * RISE_M], atol=1e-7)
        turns = [Rotation.from_quat(q.ravel()) for q in values_of(there[f"/world/hands/{hand}"], "quaternion")]
        np.testing.assert_allclose((turns[2] * turns[0].inv()).as_rotvec(), [0.0, 0.0, 2.0 * TURN_RAD], atol=1e-6)
    assert list(subject.markers) == ["gel_markers"]
    for name in subject.markers:
        simulated = values_of(there[f"/world/markers/{name}/simulated"], "positions")
        measured = values_of(there[f"/world/markers/{name}/measured"], "positions")
        assert np.linalg.norm(measured[0] - simulated[0], axis=1) == pytest.approx(1e-4, rel=1e-2)
        assert len(measured[1]) == len(simulated[1]) - 1, "a marker that was lost is left out"


def test_cameras_stand_where_they_look_from_and_see_what_was_tracked(path: Path) -> None:
    subject = pressed(measured=True)
    write_rrd(subject, path)
    there = read(path)
    camera = subject.rig.cameras["outside"]
    assert isinstance(camera, PinholeCamera)
    rows = there["/world/cameras/outside"]
    poses = [row for row in rows if np.isfinite(row[0]) and any("translation" in n and v for n, v in row[1].items())]
    origin, _ = subject.layout.camera_frame(camera, subject.frames[0])
    np.testing.assert_allclose(values_of(poses, "translation")[0].ravel(), origin, atol=1e-7)
    lens = [row for row in rows if any("image_from_camera" in n and v for n, v in row[1].items())]
    matrix = values_of(lens, "image_from_camera")[0].ravel()
    assert matrix[[0, 4]].tolist() == [camera.fx_px, camera.fy_px]
    simulated, measured = (
        values_of(there[f"/pictures/outside/{kind}"], "positions")[0] for kind in ("simulated", "measured")
    )
    np.testing.assert_allclose(measured - simulated, np.tile([APART_PX, 0.0], (len(simulated), 1)), atol=1e-3)


def test_wrenches_are_there_where_they_were_measured(path: Path) -> None:
    write_rrd(pressed(measured=True), path)
    there = read(path)
    assert [v.ravel().tolist() for v in values_of(there["/wrenches/force_plate/force/simulated"], "scalars")] == [
        [0.0, 1.0, 2.0], [6.0, 7.0, 8.0], [12.0, 13.0, 14.0],
    ]  # fmt: skip
    measured = there["/wrenches/force_plate/torque/measured"]
    assert [time for time, _ in measured] == pytest.approx([0.1, 0.2])
    assert values_of(measured, "scalars")[0].ravel().tolist() == [9.5, 10.5, 11.5]


def test_without_a_recording_there_is_the_simulation_alone(path: Path) -> None:
    write_rrd(pressed(measured=False), path)
    assert not [name for name in read(path) if "measured" in name]


def test_what_cannot_be_written_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk, of the extra 'rerun', is not installed")
    (tmp_path / "there.rrd").touch()
    for out, words in (("there.rrd", "exists already"), ("there.txt", "does not end with .rrd"), ("no/a.rrd", "no")):
        assert main(["rerun", "gel_sensor", "press_twist", "--out", str(tmp_path / out)]) == 2
        assert words in capsys.readouterr().err


def test_the_extra_is_named_where_it_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["rerun", "gel_sensor", "press_twist", "--out", str(tmp_path / "a.rrd")]) == 2
    assert "thinshell_ros[rerun]" in capsys.readouterr().err


@pytest.mark.skipif(not PROC.is_dir(), reason="there is no /proc")
def test_a_file_that_the_system_refuses_is_named() -> None:
    pytest.importorskip("rerun", reason="rerun-sdk, of the extra 'rerun', is not installed")
    with pytest.raises(ConfigError, match=r"/proc/a.rrd cannot be written.*Name a file"):
        write_rrd(pressed(measured=False), PROC / "a.rrd")
