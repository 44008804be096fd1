"""Mistakes of set-up are named with the line that mends the rig, and sound recordings are accused of none."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from graded_setups import FOREIGN, SETUPS, cases, graded, judged, setups, sound, table
from mistaken_setups import flange, makers, picture_flipped, tool_turned, wrench_sign
from scipy.spatial.transform import Rotation
from sound_recordings import accusations, of_others, simulated

from sim_core.rigs import Rig, load_rig, rig_to_yaml
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.cli.app import main
from sysid.model.load import lined_up, load_run
from sysid.observations.checks import examine
from sysid.observations.recorded_axes import in_rig_axes
from sysid.recording import Recording
from sysid.settings.setup_check import SETUP_CHECK
from sysid.setup_check.check import check_setup
from sysid.setup_check.evidence import Quantity, evidence
from sysid.setup_check.mistakes import axes_of, commonness, signed_permutations
from sysid.setup_check.pose_mistakes import begins_elsewhere, pose_mistakes
from sysid.uncertainty.goodness_of_fit import no_success

SHARED = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
FAULTS = SHARED / "faults"

needs_faults = pytest.mark.skipif(not FAULTS.is_dir(), reason=f"no folder {FAULTS}: set THINSHELL_SHARED")

STRIP, PULL = SETUPS[0]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(STRIP)


@pytest.fixture(scope="module")
def recording(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return sound(rig, PULL, tmp_path_factory.mktemp("sound"))


def mended(rig: Rig, lines: str, folder: Path) -> Rig:
    """The rig with lines such as ``sensors.load_cell.force_axes: [-x, -y, -z]`` written into its file."""
    data = yaml.safe_load(rig_to_yaml(rig))
    for line in re.split(r", (?=sensors\.|cameras\.|end_effectors\.)", lines):
        path, value = line.split(": ", 1)
        *parents, key = path.split(".")
        inner = data
        for parent in parents:
            inner = inner.setdefault(parent, {})
        inner[key] = yaml.safe_load(value)
    file = folder / "mended.yaml"
    file.write_text(yaml.safe_dump(data))
    return load_rig(file)


def test_a_sound_recording_is_accused_of_nothing(rig: Rig, recording: Recording, tmp_path: Path) -> None:
    findings, comparison, _ = judged(rig, recording, tmp_path)
    assert not findings and comparison is not None
    assert comparison.named == []
    (run,) = [lined_up(rig, examine(recording, rig)[1], (), tmp_path)]
    assert check_setup(rig, run).findings == ()


@pytest.mark.parametrize("make", [wrench_sign, flange, picture_flipped])
def test_the_line_that_is_printed_mends_the_rig(make, rig: Rig, recording: Recording, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    wrong = make(rig, recording, np.random.default_rng(3)).recording
    _, comparison, _ = judged(rig, wrong, tmp_path)
    assert comparison is not None and comparison.named
    line = comparison.named[0].mistake.line
    better = mended(rig, line, tmp_path)
    _, comparison, _ = judged(better, in_rig_axes(better, wrong), tmp_path)
    assert comparison is not None and comparison.named == [], line
    assert all(e.error < 0.1 for e in comparison.as_written.values())


def test_random_mistakes_are_named(tmp_path: Path) -> None:
    found = list(cases(8, 5, tmp_path, only=STRIP))
    assert {g.outcome for g in found} <= {"first", "equal", "note", "no effect"}, table(found)
    assert sum(g.outcome == "first" for g in found) >= 4, table(found)


def test_a_hand_that_begins_turned_speaks_for_a_turned_tool(tmp_path: Path) -> None:
    """The ball turns about its middle: readings alone would be explained by a turned sensor as well."""
    (setup,) = setups(tmp_path, "glove_finger")
    found = graded(setup, tool_turned(setup.rig, setup.recording, np.random.default_rng(3)))
    assert found.made.detail == "z 30" and found.outcome == "first", found.said


@needs_faults
@pytest.mark.parametrize(
    ("folder", "bag", "words", "line"),
    [
        ("flange_for_tool", "tcp_offset_mini", "the flange, say", "topics.tool: {position_m: [0, 0, -0.1034]}"),
        ("wrench_axes", "wrench_neg_mini", "reports what acts by it", "force_axes: [-x, -y, -z]"),
        ("wrench_axes", "wrench_left_mini", "reports what acts by it", "force_axes: [-x, -y, -z]"),
    ],
)
def test_recordings_of_mistaken_rigs_are_named(
    folder: str, bag: str, words: str, line: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    rig, place = str(FAULTS / folder / "rig.yaml"), str(FAULTS / folder / bag)
    assert main(["inspect", place, "--rig", rig]) == 0
    said = capsys.readouterr().out
    assert "stops a fit" in said and words in said and line in said
    assert main(["fit", rig, place, "--params", "strip.E", "--out", str(tmp_path / "out")]) == 2
    assert "--despite setup" in capsys.readouterr().err


@needs_faults
def test_pictures_that_are_there_twice_are_no_mistake_of_the_rig() -> None:
    rig = load_rig(str(FAULTS / "frames_twice" / "rig.yaml"))
    run = load_run(rig, FAULTS / "frames_twice" / "tracks_each_twice")
    assert any("repeat all that the one before says" in doubt for doubt in run.doubts)
    (tracks,) = (m for m in run.measured if m.kind == "tracks")
    assert np.isnan(tracks.values[1::2]).all() and np.isfinite(tracks.values[::2]).all()
    assert check_setup(rig, run).findings == ()


@needs_faults
@pytest.mark.slow
def test_a_fit_of_a_mistaken_rig_is_no_success(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    rig, bag = (str(FAULTS / "wrench_axes" / name) for name in ("rig.yaml", "wrench_neg_mini"))
    given = ["fit", rig, bag, "--params", "strip.E", "--out", str(tmp_path / "out"), "--despite", "setup"]
    assert main(given) in (3, 4)
    assert "This is no success" in capsys.readouterr().out


def test_no_success_names_what_is_missed_and_what_was_tried() -> None:
    said = no_success({"the force of wrist": 11.0, "the torque of wrist": 9.0}, ["150 mistakes of set-up."])
    assert "11 times the noise in the force of wrist (more than 10 times)" in said
    assert "torque" not in said and said.endswith("Tried to explain it: 150 mistakes of set-up.")
    assert no_success({"the force of wrist": 9.9}, []) == ""


def test_evidence_is_that_of_the_shape_and_not_of_the_size() -> None:
    """A prediction ten times too large is as good, but for its size; a reversed or a turned one is none."""
    t = np.linspace(0.0, 1.0, 16)
    truth = np.column_stack([np.sin(3.0 * t), t**2, np.zeros(16)])
    seen = truth + 0.01 * np.random.default_rng(0).standard_normal(truth.shape)
    force = Quantity("gauge", "force", np.arange(3), seen, 0.01, 1.0, 2.0, 3.0, False)
    right, large, reversed_, turned = (
        evidence([force], [p]) for p in (truth, 10.0 * truth, -truth, truth[:, [1, 0, 2]])
    )
    assert large.size == pytest.approx(0.1, rel=0.03) and right.size == pytest.approx(1.0, rel=0.03)
    assert right.log - large.log == pytest.approx(0.5 * (np.log(10.0) / 2.0) ** 2, abs=0.1)
    assert right.log - max(reversed_.log, turned.log) > 20.0
    assert right.error < 0.1 < 0.5 < reversed_.error


def test_signed_permutations_are_all_axes() -> None:
    found = signed_permutations()
    assert len({matrix.tobytes() for matrix in found}) == 48
    assert sum(np.linalg.det(matrix) > 0.0 for matrix in found) == 24
    assert np.array_equal(found[0], np.eye(3))


def test_one_act_is_more_common_than_two() -> None:
    """9 turns about an axis, 3 reversals, 3 exchanges, all reversed, and nothing at all."""
    common = [axes_of(m) for m in signed_permutations() if commonness(m) == 1.0]
    assert len(common) == 17 and "[z, -y, x]" not in common
    assert {"[-y, x, z]", "[x, -y, z]", "[y, x, z]", "[-x, -y, -z]"} <= set(common)


def test_poses_of_all_hands_may_be_given_in_another_base() -> None:
    rig = load_rig("proof_bench")
    turn, offset = Rotation.from_euler("z", 90.0, degrees=True), np.array([0.1, -0.3, 0.2])
    true, recorded = {}, {}
    for name, effector in rig.end_effectors.items():
        t = np.linspace(0.0, 1.0, 11)
        position = effector.start.position() + np.outer(np.maximum(t - 0.5, 0.0), [0.0, 0.004, -0.002])
        quaternion = np.tile(effector.start.rotation().as_quat(), (11, 1))
        true[name] = PoseTrajectory.from_samples(t, position, quaternion)
        turned = (turn * Rotation.from_quat(quaternion)).as_quat()
        recorded[name] = PoseTrajectory.from_samples(t, turn.apply(position) + offset, turned)
    assert not begins_elsewhere(rig, true) and begins_elsewhere(rig, recorded)
    found = [
        m for m in pose_mistakes(rig, recorded, 0.003)[: SETUP_CHECK.most_rollouts] if m.kind == "base for base_link"
    ]
    (best,) = [m for m in found if m.line.count("topics.base") == 2]
    assert best.poses is not None
    mended = best.poses(recorded)
    for name, right in true.items():
        np.testing.assert_allclose(mended[name].positions, right.positions, atol=1e-9)
        off = (Rotation.from_quat(mended[name].quaternions).inv() * Rotation.from_quat(right.quaternions)).magnitude()
        assert off.max() < 1e-6


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("foreign", "seed"), [(False, 1), (True, 2)])
def test_ninety_five_of_a_hundred_mistakes_are_named(foreign: bool, seed: int, tmp_path: Path) -> None:
    if foreign and not FOREIGN.is_dir():
        pytest.skip("the recordings of others are not here")
    found = list(cases(100, seed, tmp_path, foreign=foreign))
    seen = [g for g in found if g.outcome != "no effect"]
    assert not [g for g in seen if g.outcome == "silent"], table(found)
    assert sum(g.outcome in ("first", "equal", "note") for g in seen) >= 0.95 * len(seen), table(found)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_sound_recordings_are_accused_of_nothing(tmp_path: Path) -> None:
    sources = [*simulated(tmp_path, 11), *of_others(3)]
    accused = {str(bag): found for rig, bag in sources if (found := accusations(rig, bag))}
    assert accused == {} and len(sources) >= 5


def test_makers_know_what_a_recording_has(recording: Recording) -> None:
    assert wrench_sign in makers(recording) and flange in makers(recording)
