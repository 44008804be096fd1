"""Tares and resets that a recording tells of: undone where they can be, and else said."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import RecordingError
from sim_core.rigs import load_rig
from sysid.model.load import load_runs
from sysid.observations.checks import examine
from sysid.observations.rig_topics import topics_of
from sysid.recording import Recording, RecordingWriter, read_recording
from sysid.recording.bag import open_bag
from sysid.recording.message_types import EVENTS, TYPESTORE
from sysid.recording.notes import Notes

TRUE = np.array([0.5, -0.2, 3.0, 0.01, 0.02, -0.03])
ZERO = np.array([0.4, 0.1, 2.5, 0.0, 0.015, -0.02])

Event = tuple[str, float, dict[str, str]]


def tare(t: float, zero: np.ndarray = ZERO) -> Event:
    return "tare", t, {"/tactile/left/wrench": " ".join(map(str, zero))}


def recorded(path: Path, events: Sequence[Event], seconds: float = 4.0, moves: bool = True) -> Path:
    """A press of the rig card_press whose readings are less what its events take off."""
    types = TYPESTORE.types
    offsets: list[tuple[float, np.ndarray]] = []
    for name, t, values in events:
        numbers = [float(v) for text in values.values() for v in text.split()] if name == "tare" else []
        zero = np.array(numbers) if len(numbers) == 6 else np.zeros(6)
        offsets += [(t, zero)] if name != "skip" else []
    with RecordingWriter(path) as bag:
        for k in range(int(100 * seconds)):
            t = 1.0 + 0.01 * k
            z = 0.056 - (2e-4 * min(k, 20) if moves else 0.0)
            bag.pose("current_pose", round(1e9 * t), (0.03, 0.0, z), (0, 0, 0, 1), "base_link")
            off = next((value for at, value in reversed(offsets) if 0.01 * k > at), np.zeros(6))
            read = TRUE * min(k, 20) + 1e-3 * np.random.default_rng(k).standard_normal(6) - off
            bag.wrench("tactile/left/wrench", round(1e9 * t), read[:3], read[3:], "tactile_left_gel")
        for name, t, values in events:
            nanoseconds = round(1e9 * (1.0 + t))
            stamp = types["builtin_interfaces/msg/Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            pairs = [types["diagnostic_msgs/msg/KeyValue"](key=k, value=v) for k, v in values.items()]
            status = types["diagnostic_msgs/msg/DiagnosticStatus"](
                level=0, name=f"/thinshell_sim: {name}", message="", hardware_id="card_press", values=pairs
            )
            bag._add("events", max(nanoseconds, 0), EVENTS, types[EVENTS](header=header, status=[status]))
    return path


def forces(recording: Recording) -> np.ndarray:
    (wrench,) = recording.wrenches.values()
    return np.hstack([wrench.force, wrench.torque])


def read(path: Path) -> Recording:
    return read_recording(path, need_pose=False)


@pytest.mark.parametrize("events", [[("reset", -0.5, {}), tare(2.0)], [tare(-0.5), tare(2.0, 3.0 * ZERO), tare(3.0)]])
def test_readings_after_a_tare_have_the_zero_of_those_before(events: list[Event], tmp_path: Path) -> None:
    found = read(recorded(tmp_path / "tared", events))
    before = np.zeros(6) if events[0][0] == "reset" else ZERO
    expected = 20 * TRUE - before
    assert np.allclose(forces(found)[100], expected, atol=0.01)
    assert np.allclose(forces(found)[250], expected, atol=0.01) and np.allclose(forces(found)[-1], expected, atol=0.01)
    assert any("undone: all readings have the zero of the first one" in note.text for note in found.notes)
    assert [f.name for f in examine(found)[0] if f.name == "tare"] == []
    assert not any("not used" in note.text for note in found.notes)


def test_a_tare_after_one_that_is_not_known_is_said(tmp_path: Path) -> None:
    found = read(recorded(tmp_path / "tared", [tare(2.0)]))
    assert np.allclose(forces(found)[-1], 20 * TRUE - ZERO, atol=0.01)
    (finding,) = [f for f in examine(found)[0] if f.name == "tare"]
    assert finding.severity == "warning" and "at 2.000 s" in finding.problem and "BAG@0:2.000" in finding.remedy


def test_a_tare_that_is_no_six_numbers_is_left_out_aloud(tmp_path: Path) -> None:
    found = read(recorded(tmp_path / "a", [("reset", -0.5, {}), ("tare", 2.0, {"/tactile/left/wrench": "1 2"})]))
    assert any("tare of /tactile/left/wrench that is not six numbers" in note.text for note in found.notes)


def test_a_reset_in_the_middle_stops_a_fit_but_not_one_of_a_window_next_to_it(tmp_path: Path) -> None:
    rig = load_rig("card_press")
    bag = recorded(tmp_path / "reset", [("reset", -0.5, {}), ("reset", 2.0, {})])
    with pytest.raises(RecordingError, match=r"put back to its start at 2\.000 s.*BAG@0:2\.00 and BAG@2\.30:3\.99"):
        load_runs(rig, [bag], [])
    with pytest.raises(RecordingError, match="put back to its start"):
        load_runs(rig, [Path(f"{bag}@1:3")], [])
    runs, _ = load_runs(rig, [Path(f"{bag}@0:2")], [])
    assert runs[0].end < 2.0
    assert load_runs(rig, [bag], [], despite=["reset"])[0][0].end > 3.0


def test_a_reset_before_anything_moves_is_nothing(tmp_path: Path) -> None:
    found = read(recorded(tmp_path / "early", [("reset", -0.5, {}), ("reset", 2.0, {})], moves=False))
    assert [f.name for f in examine(found)[0] if f.name == "reset"] == []


def test_where_a_replay_parted_from_its_prediction_is_known_of_the_recording_and_of_a_window_of_it(
    tmp_path: Path,
) -> None:
    events = [("parted", 1.5, {"lasts_s": "0.6"}), ("parted", 3.0, {"lasts_s": "0"})]
    bag, rig = recorded(tmp_path / "replayed", events), load_rig("card_press")
    (run,) = load_runs(rig, [bag], [])[0]
    assert np.allclose(run.parted, [(1.5, 2.1), (3.0, 3.0)], atol=1e-6)
    (part,) = load_runs(rig, [Path(f"{bag}@1.8:2.9")], [])[0]
    assert np.allclose(part.parted, [(0.0, 0.3)], atol=1e-6)


def test_time_that_stamps_leave_out_is_a_warning_where_things_move_by_themselves(tmp_path: Path) -> None:
    bag = recorded(tmp_path / "slow", [("skip", 1.0, {"left_out_s": "0.7"}), ("skip", 2.0, {"left_out_s": "0.8"})])
    rig = load_rig("card_press")
    still = rig.model_copy(update={"solver": rig.solver.model_copy(update={"inertia": False})})
    for one, severity in ((rig, "warning"), (still, "note")):
        names, _ = topics_of(one, open_bag(bag, Notes()).topics)
        (finding,) = [
            f for f in examine(read_recording(bag, names, need_pose=False), one)[0] if f.name == "time_left_out"
        ]
        assert finding.severity == severity and finding.values == (1.5,) and "1.5 s" in finding.problem


def test_a_simulator_says_that_its_poses_are_exact(tmp_path: Path) -> None:
    declared = read_recording(recorded(tmp_path / "declared", [("reset", -0.5, {"poses": "exact"}), tare(1.0)]))
    assert [event.exact_poses for event in declared.events] == [True, False]
    assert not read_recording(recorded(tmp_path / "untold", [("reset", -0.5, {})])).events[0].exact_poses
