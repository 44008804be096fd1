"""Labelled presses: what their poses mean, which pins they show, and what is written of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError, RecordingError
from sim_core.rigs import Rig, load_rig
from sysid.model.load import load_run
from sysid.recording import RecordingWriter, read_recording
from sysid.vision.presses import (
    DOWN_S,
    SLIDE_S,
    baselines,
    pins_of,
    prepare,
    press_path,
    read_presses,
    write_presses,
)

COUNT = 140


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("tactip_cr")


def layout() -> np.ndarray:
    """Rings of 6 k pins around one, 18.25 px apart: the pins [px] as the rig's comment describes them."""
    pins = [np.zeros((1, 2))]
    for k in range(1, 11):
        angle = np.deg2rad(-0.36) + 2.0 * np.pi * np.arange(6 * k) / (6 * k)
        pins.append(18.249 * k * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.vstack(pins) + [211.46, 212.16]


def labels_of(count: int) -> np.ndarray:
    """Slide x, y and depth [m], tilts rx, ry and twist rz [rad], ``(n, 6)``."""
    draw = np.random.default_rng(3).uniform(-1.0, 1.0, (count, 6))
    return draw * [4e-3, 4e-3, 2e-3, 0.05, 0.05, 0.08] + [0.0, 0.0, 3e-3, 0.0, 0.0, 0.0]


def moved_by(labels: np.ndarray, pins: np.ndarray, roll: float) -> np.ndarray:
    """Pins ``(n, m, 2)`` [px] of a pad that goes by minus the label, seen by a camera rolled by ``roll`` [rad].

    Linear in the labels: what the plate holds goes by plus the label in the image's frame, turns with the twist, and is
    spread about a place that the tilts shift.
    """
    camera = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    arm = pins - pins.mean(axis=0)
    weight = np.exp(-np.sum(arm**2, axis=1) / (2.0 * 90.0**2))
    out = []
    for x, y, depth, rx, ry, rz in labels:
        spread = 40.0 * depth * arm + 0.8 * arm * (arm @ (camera @ [-ry, rx]))[:, None] / 90.0
        turned = rz * arm @ np.array([[0.0, 1.0], [-1.0, 0.0]])
        out.append(pins + weight[:, None] * (spread + turned + 3e3 * camera @ [x, y]))
    return np.array(out)


def tracked(folder: Path, labels: np.ndarray, *, roll: float = 0.4, shuffle: int = 0, missing: int = 0) -> Path:
    """A recording as 'thinshell track' writes it: the unloaded pad at 1 s, then an image a second."""
    pins = np.random.default_rng(shuffle).permutation(layout()) if shuffle else layout()
    frames = [pins, *moved_by(labels, pins, roll)]
    with RecordingWriter(folder) as bag:
        for k, uv in enumerate(frames):
            stamp = (k + 1) * 1_000_000_000
            bag.tracks("marker_tracks", stamp, uv, np.arange(len(pins)), np.ones(len(pins)), "camera")
            if k > missing:
                quaternion = Rotation.from_euler("xyz", labels[k - 1, 3:]).as_quat()
                bag.pose("target_pose", stamp, labels[k - 1, :3], quaternion, "plate")
    return folder


def test_labels_come_back_from_the_poses_that_they_are_packed_in(tmp_path: Path) -> None:
    labels = labels_of(COUNT)
    presses = read_presses(read_recording(tracked(tmp_path / "bag", labels)))
    np.testing.assert_allclose(presses.labels, labels, atol=1e-12)
    assert presses.number.tolist() == list(range(1, COUNT + 1))
    assert presses.number[presses.held_out].tolist() == list(range(5, COUNT + 1, 5))
    np.testing.assert_allclose(presses.rest, layout(), atol=1e-4)  # tracks are stored as 32-bit numbers


@pytest.mark.parametrize("missing", [1, 4])
def test_images_before_the_first_label_are_no_presses(tmp_path: Path, missing: int) -> None:
    labels = labels_of(COUNT)
    bag = tracked(tmp_path / "bag", labels, missing=missing)
    presses = read_presses(read_recording(bag))
    np.testing.assert_allclose(presses.labels, labels[missing:], atol=1e-12)
    assert presses.number[0] == missing + 1


def test_a_pad_that_was_tracked_without_unloaded_image_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="begin with the unloaded sensor"):
        read_presses(read_recording(tracked(tmp_path / "bag", labels_of(COUNT), missing=-1)))


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_path_of_a_press_goes_by_plus_or_minus_the_label(sense: float) -> None:
    labels = labels_of(3)
    path, readings = press_path(labels, sense)
    for label, reading in zip(labels, readings, strict=True):
        before, touched, at = (path.at(t) for t in (reading - SLIDE_S - DOWN_S, reading - SLIDE_S, reading))
        # From above straight down, then along the plate at one depth.
        np.testing.assert_allclose(before[0][:2], touched[0][:2], atol=1e-15)
        assert before[0][2] < 0.0
        assert touched[0][2] == at[0][2] == label[2]
        np.testing.assert_allclose(at[0][:2] - touched[0][:2], sense * label[:2], atol=1e-15)
        turned = Rotation.from_quat(at[1]) * Rotation.from_quat(touched[1]).inv()
        np.testing.assert_allclose(turned.as_rotvec(), [0.0, 0.0, sense * label[5]], atol=1e-12)
        # The tilt is there all the time: the plate's normal, seen from the pad, stays.
        normal = Rotation.from_euler("xyz", [*label[3:5], 0.0]).inv().apply([0.0, 0.0, 1.0])
        for _, quaternion in (before, touched, at):
            np.testing.assert_allclose(Rotation.from_quat(quaternion).inv().apply([0.0, 0.0, 1.0]), normal, atol=1e-12)


def test_pins_get_the_numbers_of_the_rig(rig: Rig) -> None:
    order = np.random.default_rng(1).permutation(331)
    extra = np.array([[2.0, 2.0]])
    numbers, apart = pins_of(rig, "inside", np.vstack([layout()[order], extra]))
    assert numbers.tolist() == [*order, -1]
    assert apart < 0.1


def test_a_layout_that_is_not_the_rigs_is_refused(rig: Rig) -> None:
    with pytest.raises(RecordingError, match="Correct the places of the pins"):
        pins_of(rig, "inside", layout() + [9.0, 0.0])
    with pytest.raises(RecordingError, match="1 of the 331 pins"):
        pins_of(rig, "inside", layout()[1:])


def test_baselines_find_what_is_linear(tmp_path: Path) -> None:
    labels = labels_of(COUNT)
    presses = read_presses(read_recording(tracked(tmp_path / "bag", labels)))
    train, test = np.flatnonzero(~presses.held_out)[:8], np.flatnonzero(presses.held_out)
    still, few, many, curved = baselines(presses, train, test)
    moved = moved_by(labels[test], layout(), 0.4) - layout()
    assert still.miss_px == pytest.approx(np.sqrt(np.mean(moved**2)), rel=1e-6)
    assert still.miss_px > 1.0
    for found in (few, many, curved):
        assert found.miss_px < 1e-3


def test_presses_are_written_as_a_recording_of_the_rig(tmp_path: Path, rig: Rig) -> None:
    labels = labels_of(COUNT)
    presses = read_presses(read_recording(tracked(tmp_path / "bag", labels, shuffle=5)))
    numbers, _ = pins_of(rig, "inside", presses.rest)
    rows = np.array([4, 17])
    write_presses(presses, rows, -1.0, rig, numbers, tmp_path / "out")
    run = load_run(rig, tmp_path / "out")
    (inside,) = run.measured
    expected = moved_by(labels[rows], layout(), 0.4)
    np.testing.assert_allclose(inside.values.reshape(2, -1, 2), expected, atol=1e-4)
    for t, row in zip(inside.t, rows, strict=True):
        np.testing.assert_allclose(run.poses["finger"].at(t)[0], [0.0, 0.0, labels[row, 2]], atol=1e-12)
        np.testing.assert_allclose(run.poses["finger"].at(t - SLIDE_S)[0], labels[row, :3], atol=1e-12)
    assert any("images 5, 18" in note and "made up" in note for note in run.notes)


def test_the_command_finds_the_sense_and_holds_out(tmp_path: Path, rig: Rig) -> None:
    bag = tracked(tmp_path / "bag", labels_of(COUNT), roll=0.4)
    text = prepare(rig, bag, tmp_path / "out", 2.0, 4, 2)
    assert "slid by minus the labelled slide" in text
    shown = float(text.split("the pad's x points ")[1].split(" deg")[0])
    assert shown == pytest.approx(np.rad2deg(0.4), abs=2.0)
    named = text.split("images ")[-1]
    held_out = [int(word) for word in named.split(" to fit, ")[1].split(" held out")[0].split(", ")]
    fitted = [int(word) for word in named.split(" to fit")[0].split(", ")]
    assert [n % 5 for n in held_out] == [0, 0]
    assert len(fitted) == 4
    assert all(n % 5 for n in fitted)
    tilt = np.rad2deg(np.linalg.norm(labels_of(COUNT)[np.array(fitted + held_out) - 1, 3:5], axis=1))
    assert tilt.max() < 2.0
    with pytest.raises(RecordingError, match="fewer than the 130"):
        prepare(rig, bag, tmp_path / "more", 2.0, 130, 2)
    with pytest.raises(ConfigError, match="0 cameras"):
        prepare(load_rig("forming").model_copy(update={"cameras": {}}), bag, tmp_path / "none", 2.0, 4, 2)


def test_a_recording_without_tracks_has_to_be_tracked(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "bag") as bag:
        for k in range(1, 4):
            bag.pose("target_pose", k * 1_000_000_000, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), "plate")
            bag.wrench("wrench", k * 1_000_000_000, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), "sensor")
    with pytest.raises(RecordingError, match="thinshell track"):
        read_presses(read_recording(tmp_path / "bag"))
