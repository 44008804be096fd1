"""What is wrong with a recording is named, and nothing else; sound recordings are accused of nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recordings_with_a_fault import FAULTS, RIG, SOUND, TURNED, Press, inverted, press, write, wrong_order
from scipy.spatial.transform import Rotation

from sim_core.errors import RecordingError
from sim_core.rigs import Rig, load_rig
from sysid.cli.app import main
from sysid.model.load import load_run
from sysid.observations.checks import Finding, examine
from sysid.observations.checks.two_publishers import two_levels
from sysid.observations.rig_topics import topics_of
from sysid.recording import Recording, read_recording
from sysid.recording.bag import open_bag
from sysid.recording.notes import Notes

ROOT = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
SHARED = ROOT / "data"


def read(bag: Path, rig: Rig) -> Recording:
    names, _ = topics_of(rig, open_bag(bag, Notes()).topics)
    return read_recording(bag, names, need_pose=False)


def rig_for(fault: Callable[[Press], None] | None = None) -> Rig:
    rig = load_rig(RIG)
    if fault not in (inverted, wrong_order):
        return rig
    finger = rig.end_effectors["finger"]
    start = finger.start.model_copy(update={"quaternion_xyzw": tuple(TURNED.as_quat().tolist())})
    return rig.model_copy(update={"end_effectors": {"finger": finger.model_copy(update={"start": start})}})


def findings(bag: Path, rig: Rig) -> list[Finding]:
    return list(examine(read(bag, rig), rig)[0])


def test_nothing_is_said_of_the_example(tmp_path: Path) -> None:
    assert findings(SOUND, load_rig(RIG)) == []
    assert findings(write(press(), tmp_path / "bag"), load_rig(RIG)) == []


@pytest.mark.parametrize(
    ("name", "fault"),
    [(name, fault) for name, faults in FAULTS.items() for fault in faults],
    ids=lambda v: getattr(v, "__name__", str(v)),
)
def test_the_one_thing_that_is_wrong_is_named(name: str, fault: Callable[[Press], None], tmp_path: Path) -> None:
    """By its name, and no other thing is."""
    recording = press()
    fault(recording)
    found = findings(write(recording, tmp_path / "bag"), rig_for(fault))
    assert {f.name for f in found} == {name}, [str(f) for f in found]
    for one in found:
        assert one.problem and (one.remedy or one.of_another_rig) and str(one).startswith(one.severity)


def shared_recordings() -> list[tuple[Path, str]]:
    """Recordings of others that are sound, with their rigs."""
    cases = [(bag, str(bag.parent / "rig.yaml")) for bag in sorted(SHARED.glob("foreign/*/rec_*"))]
    for bag in sorted(SHARED.glob("knit_fabric_stretch/*_pull*")):
        cases.append((bag, "knit_" + bag.name.rpartition("_")[0]))
    return [*cases, (SHARED / "tactip_shear" / "cr_tactip", "tactip_cr")]


@pytest.mark.slow
def test_sound_recordings_of_others_are_accused_of_nothing() -> None:
    cases = [(bag, rig) for bag, rig in shared_recordings() if bag.exists()]
    if len(cases) < 2:
        pytest.skip("the recordings of others are not here")
    accused = {
        f"{bag.parent.name}/{bag.name}": [str(f) for f in findings(bag, load_rig(rig)) if f.severity != "note"]
        for bag, rig in cases
    }
    assert {bag: said for bag, said in accused.items() if said} == {}


def test_faulty_readings_are_left_out_aloud(tmp_path: Path) -> None:
    recording = press()
    FAULTS["clipped"][0](recording)
    run = load_run(load_rig(RIG), write(recording, tmp_path / "bag"))
    gauge = next(m for m in run.measured if m.channel == "wrench_gel")
    at_the_end = np.abs(recording.wrench.values[:, 2]) == np.abs(recording.wrench.values[:, 2]).max()
    assert at_the_end.sum() > 3
    assert np.isnan(gauge.values[at_the_end, 2]).all() and np.isfinite(gauge.values[:, :2]).all()
    assert any("reads exactly" in text and "They are left out." in text for text in run.doubts)


def test_what_makes_a_fit_meaningless_stops_it_unless_allowed(tmp_path: Path) -> None:
    recording = press()
    FAULTS["two_publishers"][0](recording)
    bag = write(recording, tmp_path / "bag")
    with pytest.raises(RecordingError, match=r"0\.4 mm and 3 ms apart.*--despite two_publishers"):
        load_run(load_rig(RIG), bag)
    run = load_run(load_rig(RIG), bag, despite=["two_publishers"])
    assert any("two sources" in text for text in run.doubts)


def test_a_sensor_does_not_read_more_than_it_can() -> None:
    rig = load_rig(RIG)
    gauge = rig.sensors["wrench_gel"]
    largest = float(np.abs(read(SOUND, rig).wrenches["wrench_gel"].force).max())
    for range_n, reported in ((0.5 * largest, True), (1.01 * largest, False)):
        limited = rig.model_copy(
            update={"sensors": {**rig.sensors, "wrench_gel": gauge.model_copy(update={"range_n": range_n})}}
        )
        assert [f.name for f in findings(SOUND, limited)] == (["sensor_range"] if reported else [])


def test_inspect_prints_what_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = press()
    FAULTS["picture_size"][0](recording)
    bag = write(recording, tmp_path / "bag")
    assert main(["inspect", str(bag), "--rig", RIG]) == 0
    said = capsys.readouterr().out
    assert "stops a fit: /outside/marker_tracks: picture_size: camera_info says" in said
    assert "640 x 360 px, the rig 1280 x 720 px" in said
    assert main(["inspect", str(bag)]) == 0
    assert "picture_size" not in capsys.readouterr().out


def test_readings_in_steps_as_coarse_as_their_noise_are_no_lost_markers(tmp_path: Path) -> None:
    recording = press()
    recording.tracks.uv = np.round(recording.tracks.uv * 16.0) / 16.0
    found = findings(write(recording, tmp_path / "bag"), load_rig(RIG))
    assert [f.name for f in found if f.severity != "note"] == []


def test_a_machine_of_twenty_kilonewtons_is_not_accused(tmp_path: Path) -> None:
    recording, rig = press(), load_rig(RIG)
    scale = 2e4 / np.abs(recording.wrench.values[:, :3]).max()
    recording.wrench.values *= scale
    gauge = rig.sensors["wrench_gel"]
    noise = gauge.noise.model_copy(update={"force_n": scale * 0.002, "torque_nm": scale * 1e-5})
    strong = rig.model_copy(
        update={"sensors": {**rig.sensors, "wrench_gel": gauge.model_copy(update={"noise": noise})}}
    )
    bag = write(recording, tmp_path / "bag")
    assert findings(bag, strong) == [] and not any("forces up to" in note.text for note in read(bag, strong).warnings)


def test_a_pose_that_freezes_stops_a_fit_where_sensors_go_on(tmp_path: Path) -> None:
    """Of poses with noise at rest; those without may stand still."""
    recording = press()
    recording.pose.position += 2e-6 * np.random.default_rng(3).standard_normal(recording.pose.position.shape)
    assert findings(write(recording, tmp_path / "sound"), load_rig(RIG)) == []
    frozen = slice(int(np.searchsorted(recording.pose.t, 2.0)), int(np.searchsorted(recording.pose.t, 3.5)))
    recording.pose.position[frozen] = recording.pose.position[frozen.start]
    found = [f for f in findings(write(recording, tmp_path / "bag"), load_rig(RIG)) if f.name == "frozen_pose"]
    assert [f.severity for f in found] == ["stops a fit"]
    assert found[0].times[0] == pytest.approx(2.0, abs=0.02) and found[0].times[1] == pytest.approx(3.5, abs=0.02)


def test_positions_in_another_unit_are_found_wherever_a_motion_begins(tmp_path: Path) -> None:
    """Elsewhere than the rig's start in any unit, so that it remains open which: no motion is larger than the rig."""
    recording = press()
    recording.pose.position = (recording.pose.position + [0.05, -0.04, 0.02]) / 0.0254
    (found,) = findings(write(recording, tmp_path / "bag"), load_rig(RIG))
    assert found.name == "length_unit" and "moves 2.09 m, where the rig is 0.098 m large" in found.problem


@pytest.mark.parametrize(("degrees", "said"), [(1.5, []), (30.0, ["start_orientation"])])
def test_a_hand_that_begins_turned_is_said(degrees: float, said: list[str], tmp_path: Path) -> None:
    """Its mount is known to half a degree about each axis; it does not turn by itself."""
    recording = press()
    turn = Rotation.from_euler("y", degrees, degrees=True)
    recording.pose.quaternion = (Rotation.from_quat(recording.pose.quaternion) * turn).as_quat()
    found = findings(write(recording, tmp_path / "bag"), load_rig(RIG))
    assert [f.name for f in found] == said and all(f.severity == "note" for f in found)


def test_a_component_that_nothing_measures_is_left_out(tmp_path: Path) -> None:
    """As of a load cell of one axis, whose driver fills the others with zeros."""
    recording = press()
    recording.wrench.values[:, [0, 1, 3, 4, 5]] = 0.0
    bag = write(recording, tmp_path / "bag")
    (found,) = [f for f in findings(bag, load_rig(RIG)) if f.name == "constant"]
    assert "force x (0 N), force y (0 N), torque x" in found.problem and "`measures`" in found.remedy
    gauge = next(m for m in load_run(load_rig(RIG), bag).measured if m.channel == "wrench_gel")
    assert np.isnan(gauge.values[:, [0, 1, 3, 4, 5]]).all() and np.isfinite(gauge.values[:, 2]).all()


def test_torques_in_another_unit_are_found_by_their_noise(tmp_path: Path) -> None:
    """Where the lever arm is short enough to be plausible."""
    recording = press()
    force = recording.wrench.values[:, :3]
    noise = 1e-5 * np.random.default_rng(4).standard_normal(force.shape)
    recording.wrench.values[:, 3:] = 1000.0 * (1e-5 * force + noise)
    found = findings(write(recording, tmp_path / "bag"), load_rig(RIG))
    assert [f.name for f in found] == ["torque_unit"] and "newton millimetres" in found[0].problem


def test_markers_that_change_places_out_of_sight_are_named(tmp_path: Path) -> None:
    recording = press()
    recording.tracks.uv[70:80, [4, 5]] = np.nan
    recording.tracks.uv[80:, [4, 5]] = recording.tracks.uv[80:, [5, 4]]
    assert [f.name for f in findings(write(recording, tmp_path / "bag"), load_rig(RIG))] == ["markers_exchanged"]


def test_a_jump_of_the_orientation_is_said(tmp_path: Path) -> None:
    recording = press()
    recording.pose.quaternion[300:340] = [0.0, 0.0, 1.0, 0.0]
    notes = read(write(recording, tmp_path / "bag"), load_rig(RIG)).warnings
    assert ["2 jumps of the orientation, the largest 180 degrees" in note.text for note in notes] == [True]


def test_round_off_of_a_simulated_force_is_not_taken_for_two_sources() -> None:
    """A sensor in touch with nothing reads sums of zero, which jump between two neighbouring numbers."""
    to_and_fro = np.where(np.arange(400) % 2, 1e-3, -1e-3)[:, None] * np.ones(3)
    found = two_levels(to_and_fro)
    assert found is not None and found[1] == pytest.approx(2e-3)
    assert two_levels(1e-15 * to_and_fro) is None
