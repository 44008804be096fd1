"""Tables as laboratories and their programs write them: read, or all that is wrong said in the words of the file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from recording_messages import notes

from sim_core.errors import RecordingError
from sim_core.rigs import load_rig
from sysid.model.load import load_run
from sysid.recording import Recording, SensorTopic, TopicNames, read_recording
from sysid.recording.topics import EETopics

ROOT = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared")) / "faults"
FAULT = ROOT / "csv_of_a_lab"

PLAIN = "time [s],x [mm],force_z [N]\n0.00,1.5,0.25\n0.01,2.5,0.5\n0.02,3.5,0.75\n"


def read(tmp_path: Path, text: str | bytes, topics: TopicNames | None = None, name: str = "pull.csv") -> Recording:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_recording(path, topics)


def assert_plain(recording: Recording) -> None:
    np.testing.assert_allclose(recording.poses["ee"].t, [0.0, 0.01, 0.02], atol=1e-9)
    np.testing.assert_allclose(recording.poses["ee"].position[:, 0], [1.5e-3, 2.5e-3, 3.5e-3], atol=1e-12)
    np.testing.assert_allclose(recording.wrenches["sensor"].force[:, 2], [0.25, 0.5, 0.75], atol=1e-12)
    assert [note.words for note in recording.warnings] == ["current_pose: y, z not in the table, taken as 0"]


GERMAN = PLAIN.replace(",", ";").replace(".", ",")
SAME = {
    "plain": PLAIN,
    "windows": PLAIN.replace("\n", "\r\n"),
    "trailing separator": PLAIN.replace("\n", ",\n"),
    "trailing separators of rows": PLAIN.replace("\n", ",,\n").replace("[N],,", "[N]"),
    "trailing separator of the header": PLAIN.replace("[N]\n", "[N],\n"),
    "decimal commas": GERMAN,
    "decimal commas, trailing": GERMAN.replace("\n", ";\n"),
    "tabs": PLAIN.replace(",", "\t"),
    "tabs and decimal commas": PLAIN.replace(",", "\t").replace(".", ","),
    "quoted decimal commas": "time [s],x [mm],force_z [N]\n"
    + "\n".join(f'"0,0{k}","{k + 1},5","{0.25 * (k + 1)}"'.replace("0.", "0,") for k in range(3)),
    "remarks and a preamble": "# made by hand\nOperator: N. N.\nDate;3 May\n\n" + PLAIN,
    "a line of units": PLAIN.replace("time [s],x [mm],force_z [N]\n", "Time,x,Fz\n(s),(mm),(N)\n"),
    "units in round brackets": PLAIN.replace("[", "(").replace("]", ")"),
    "units behind a slash": PLAIN.replace("time [s],x [mm],force_z [N]", "t/s,x / mm,Fz / N"),
    "other words": PLAIN.replace("time [s],x [mm],force_z [N]", "Time (sec),Position X [mm],Force Z [Newton]"),
    "blank lines": PLAIN.replace("\n", "\n\n"),
}


@pytest.mark.parametrize("text", SAME.values(), ids=SAME.keys())
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_one_table_as_several_programs_write_it(tmp_path: Path, text: str, encoding: str) -> None:
    assert_plain(read(tmp_path, text.encode(encoding)))


def test_units_with_signs_of_their_own(tmp_path: Path) -> None:
    text = "time [ms],x [\N{MICRO SIGN}m],yaw [\N{DEGREE SIGN}],torque_x [N\N{MIDDLE DOT}mm]\n0,5,90,1\n1,6,90,2\n"
    recording = read(tmp_path, text.encode("latin-1"))
    np.testing.assert_allclose(recording.poses["ee"].position[:, 0], [5e-6, 6e-6], atol=1e-15)
    np.testing.assert_allclose(recording.wrenches["sensor"].torque[:, 0], [1e-3, 2e-3])


PLOTJUGGLER = (
    "__time,/current_pose/header/stamp,/current_pose/pose/orientation/w,/current_pose/pose/orientation/x,"
    "/current_pose/pose/orientation/y,/current_pose/pose/orientation/z,/current_pose/pose/position/x,"
    "/current_pose/pose/position/y,/current_pose/pose/position/z,/ft_sensor/wrench/force/x,/ft_sensor/wrench/force/y,"
    "/ft_sensor/wrench/force/z,/joint_states/panda_joint1/position\n"
    "1700000000.010000000,1700000000.01,1,0,0,0,0.5,0.0,0.25,,,,0.1\n"
    "1700000000.015000000,,,,,,,,,1.0,2.0,3.0,\n"
    "1700000000.020000000,1700000000.02,1,0,0,0,0.75,0.0,0.25,,,,0.2\n"
    "1700000000.025000000,,,,,,,,,4.0,5.0,6.0,\n"
)


def test_what_plotjuggler_writes(tmp_path: Path) -> None:
    names = TopicNames(
        ee={"ee": EETopics(current_pose="current_pose")}, wrench={"s": SensorTopic(topic="ft_sensor")},
        markers={}, tracks={}, images={},
    )  # fmt: skip
    recording = read(tmp_path, PLOTJUGGLER, names)
    np.testing.assert_allclose(recording.poses["ee"].position, [[0.5, 0.0, 0.25], [0.75, 0.0, 0.25]], atol=1e-12)
    np.testing.assert_allclose(recording.wrenches["s"].force, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_allclose(recording.wrenches["s"].t - recording.poses["ee"].t, [0.005, 0.005], atol=1e-6)
    assert "columns not read: /current_pose/header/stamp, /joint_states/panda_joint1/position" in notes(recording)


MACHINE = "Zeit;Kraft [mN];Weg (mm);Kanal 7\n0,0;250;1,5;9\n0,01;500;2,5;9\n0,02;750;3,5;9\n"
MEANT = {"Zeit": "time [s]", "Kraft": "wrench.force_z", "Weg (mm)": "current_pose.x"}


def test_names_of_columns_are_mapped(tmp_path: Path) -> None:
    """Units of the file count; a name may be given with its unit or without."""
    recording = read(tmp_path, MACHINE, TopicNames(columns=MEANT))
    np.testing.assert_allclose(recording.poses["ee"].position[:, 0], [1.5e-3, 2.5e-3, 3.5e-3], atol=1e-12)
    np.testing.assert_allclose(recording.wrenches["sensor"].force[:, 2], [0.25, 0.5, 0.75], atol=1e-12)
    assert "columns not read: Kanal 7" in notes(recording)
    with pytest.raises(
        RecordingError, match=r"'Kraft \[mN\]' is not known.*'Weg \(mm\)' is not known.*'Kanal 7'.*no column of times"
    ):
        read(tmp_path, MACHINE)


def test_names_that_are_known_need_no_mapping_next_to_others(tmp_path: Path) -> None:
    text = MACHINE.replace("Zeit", "time [s]")
    recording = read(tmp_path, text, TopicNames(columns={name: MEANT[name] for name in ("Kraft", "Weg (mm)")}))
    assert_plain(recording)


def test_all_that_is_wrong_is_said_at_once(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time [s],x [furlong],Force [mN],x [m]\n\n# later\n0,1,2,3\n1,one,2,3\n2,1,2,two\n")
    (tmp_path / "b.csv").write_text("x [m]\n0\n1\n")
    with pytest.raises(RecordingError) as caught:
        read_recording(tmp_path)
    text = str(caught.value)
    for words in (
        "the column 'x [furlong]' has the unit 'furlong'",
        "'Force [mN]' is not known. Is it force_x, force_y or force_z?",
        "line 6 has 'two' for 'x [m]'", "b.csv: it has no column of times among x [m]", "table_columns",
    ):  # fmt: skip
        assert words in text


def test_commas_between_columns_and_in_numbers_are_said(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="commas part the columns and the decimals") as caught:
        read(tmp_path, "time [s],x [m]\n0,0,0615\n0,01,0,0616\n")
    assert "line 2 has 3 cells, the header 2: '0,0,0615'" in str(caught.value)
    assert "table_columns" not in caught.value.remedy


def test_thousands_are_not_guessed(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"line 3 has '1,234' for 'force_z \[N\]'"):
        read(tmp_path, 'time [s],force_z [N]\n0,999.5\n1,"1,234"\n')


def test_times_of_day(tmp_path: Path) -> None:
    text = "timestamp [s],x [m],force_x [N]\n2026-05-03 12:00:00.500,0.1,1\n2026-05-03 12:00:01.000,0.1,2\n"
    recording = read(tmp_path, text + "2026-05-03T12:00:02+00:00,0.1,3\n")
    np.testing.assert_allclose(recording.poses["ee"].t, [0.0, 0.5, 1.5], atol=1e-6)


@pytest.mark.skipif(not FAULT.is_dir(), reason="the shared inputs are not here")
def test_shared_tables() -> None:
    rig = load_rig(str(FAULT / "rig.yaml"))
    run = load_run(rig, FAULT / "trailing_sep")
    assert len(run.poses["gripper"].times) == 431 and not [d for d in run.doubts if "frame" in d or "camera_info" in d]
    with pytest.raises(RecordingError, match="commas part the columns and the decimals"):
        load_run(rig, FAULT / "comma_comma")
