"""Markers that are put on anew for each recording, pictures with a moving crop, gauges along one axis."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import RecordingError
from sim_core.rigs import Rig, Sight, load_rig, parse_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import simulate
from sysid.fit.engine import Engine
from sysid.fit.placement import placed_sights
from sysid.fit.runs import load_run
from sysid.simulate import write_trace

PINS = ((0.002, 0.02, 0.0), (-0.001, -0.018, 0.0), (0.012, 0.001, 0.0), (-0.013, 0.0, 0.0), (0.001, 0.0, 0.0))


def knit(cells: tuple[int, int] = (6, 6), **pixels: float) -> Rig:
    """A coarse knitted sheet; ``pixels``: changes to its camera."""
    data = load_rig("knit_acrylic_stockinette_y").model_dump()
    data["bodies"]["knit"]["shape"]["cells"] = cells
    data["cameras"]["video"].update(pixels)
    return parse_rig(data, "test")


def with_pins(rig: Rig, positions: tuple[tuple[float, float, float], ...]) -> Rig:
    """The rig with its pins elsewhere."""
    camera = rig.cameras["video"]
    sight = camera.sees[0]
    moved = Sight(body="knit", points=sight.points.model_copy(update={"positions_m": positions}))
    return rig.model_copy(update={"cameras": {"video": camera.model_copy(update={"sees": (moved,)})}})


def record(rig: Rig, folder: Path, stretch: tuple[float, ...], times: tuple[float, ...]) -> Path:
    """A bag of a pull without noise. ``stretch``: way of the clamp from its start [m]."""
    start = np.array(rig.end_effectors["puller"].start.position_m)
    positions = start + np.outer(stretch, [0.0, 1.0, 0.0])
    poses = {
        "puller": PoseTrajectory.from_samples(
            np.array(times), positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1))
        )
    }
    trace = simulate(build_scene(rig), poses, np.arange(0.0, times[-1] + 0.1, 0.5))
    write_trace(rig, trace, poses, folder, lambda channel, kind, stamps, clean: np.zeros(clean.shape))
    return folder


def test_markers_are_located_in_the_first_frame(tmp_path: Path) -> None:
    # Other pins than the rig says, another crop, and a sheet that is stretched when the recording begins.
    there = with_pins(knit(cx_px=300.0, cy_px=20.0), PINS)
    bag = record(there, tmp_path / "bag", (0.002, 0.006), (0.0, 2.0))
    rig = knit()
    run = load_run(rig, bag)
    located = np.array(run.sights["video"][0].points.positions_m)
    np.testing.assert_allclose(located, PINS, atol=1e-6)
    prediction = Engine().predict(run.seen_by(rig), run)
    video = next(m for m in run.measured if m.channel == "video")
    difference = video.values - prediction.values["video"]
    assert np.isnan(difference[:, 10:]).all()  # the origin marker itself is not compared
    np.testing.assert_allclose(difference[:, :10], 0.0, atol=0.02)


def test_only_the_measured_components_are_compared(tmp_path: Path) -> None:
    bag = record(knit(), tmp_path / "bag", (0.0, 0.004), (0.0, 1.0))
    gauge = next(m for m in load_run(knit(), bag).measured if m.channel == "gauge")
    assert np.isfinite(gauge.values).all(axis=0).tolist() == [False, True, False, False, False, False]
    # The stretched sheet pulls the top clamp down, along +y of the picture.
    assert gauge.values[-1, 1] > 1.0


def test_a_marker_off_the_sheet_is_an_error(tmp_path: Path) -> None:
    bag = record(knit(), tmp_path / "bag", (0.0, 0.001), (0.0, 1.0))
    with pytest.raises(RecordingError, match=r"marker 0 is first seen at .* but knit reaches from"):
        load_run(knit(scale_m_per_px=3e-4), bag)


def test_the_rig_says_how_long_a_gap_may_be(tmp_path: Path) -> None:
    rig = knit()
    bag = record(rig, tmp_path / "bag", (0.0, 0.001), (0.0, 1.0))
    puller = rig.end_effectors["puller"]
    strict = puller.model_copy(update={"topics": puller.topics.model_copy(update={"max_gap_s": 0.005})})
    with pytest.raises(RecordingError, match="has a gap of"):
        load_run(rig.model_copy(update={"end_effectors": {"puller": strict}}), bag)


def test_markers_are_located_where_the_clamps_stand_at_that_frame(tmp_path: Path) -> None:
    # The camera starts a second after the pull, when the sheet is already stretched.
    there = with_pins(knit(), PINS)
    whole = record(there, tmp_path / "bag", (0.0, 0.006), (0.0, 2.0))
    run = load_run(there, whole)
    video = next(m for m in run.measured if m.channel == "video")
    begin = int(np.argmin(np.abs(video.t - 1.0)))
    late = replace(video, t=video.t[begin:], values=video.values[begin:])
    absent = replace(video, values=np.where(video.t[:, None] < late.t[0], np.nan, video.values))
    for m in (late, absent):
        sights, notes = placed_sights(knit(), run.poses, [m])
        np.testing.assert_allclose(np.array(sights["video"][0].points.positions_m), PINS, atol=1e-6)
        assert notes == ()


def test_markers_are_located_by_where_the_camera_really_stands(tmp_path: Path) -> None:
    askew = {"offset_rz_deg": 3.0, "offset_x_m": 0.004}
    bag = record(with_pins(knit(**askew), PINS), tmp_path / "bag", (0.0, 0.004), (0.0, 1.0))
    located = np.array(load_run(knit(**askew), bag).sights["video"][0].points.positions_m)
    np.testing.assert_allclose(located, PINS, atol=1e-6)
