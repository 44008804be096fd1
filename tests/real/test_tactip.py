"""The rig of a TacTip against presses of one, which are not part of the project."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_core.rigs import Rig, load_rig, with_parameters
from sysid.model.load import load_run
from sysid.model.predictor import SerialPredictor
from sysid.recording import Recording, read_recording
from sysid.vision import track_recording, write_tracked_recording
from sysid.vision.presses import Presses, pins_of, read_presses, write_presses

SHARED = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
DATA = SHARED / "data" / "tactip_shear" / "cr_tactip"

FITTED = {
    "dome-plate.friction": 0.404,
    "dome.nu": -0.054,
    "finger.offset_z": -4e-6,
    "finger.offset_rx": 0.12,
    "finger.offset_ry": 0.56,
    "finger.offset_rz": -1.13,
}
"""Values that a fit of eight other presses found (README); the rig starts from others."""

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"no folder {DATA}: set THINSHELL_SHARED to the folder that holds data/"
)

HELD_OUT = (145, 950, 4430, 2770)
"""Images of held-out presses, from 2 to 5 mm deep."""


def only(recording: Recording, numbers: tuple[int, ...]) -> Recording:
    """The unloaded image and those with the given numbers."""
    ((camera, images),) = recording.images.items()
    ((effector, poses),) = recording.poses.items()

    def rows(t: np.ndarray) -> np.ndarray:
        return np.flatnonzero(np.isin(np.rint(t + 1e-9 * recording.t0_ns).astype(int) - 1, (0, *numbers)))

    chosen = {effector: poses.take(rows(poses.t))}
    return replace(recording, images={camera: images.take(rows(images.t))}, poses=chosen, target_poses=chosen)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("tactip_cr")


@pytest.fixture(scope="module")
def presses(tmp_path_factory: pytest.TempPathFactory) -> Presses:
    recording = only(read_recording(DATA, need_pose=False), HELD_OUT)
    bag = write_tracked_recording(recording, [track_recording(recording)], tmp_path_factory.mktemp("pins") / "tracked")
    return read_presses(read_recording(bag, need_pose=False))


def miss_px(rig: Rig, presses: Presses, sense: float, folder: Path) -> float:
    """Root mean square by which the rig misses the pins of the presses."""
    numbers, _ = pins_of(rig, "inside", presses.rest)
    write_presses(presses, np.arange(len(presses)), sense, rig, numbers, folder)
    run = load_run(rig, folder)
    (seen,) = run.measured
    return float(np.sqrt(np.nanmean((SerialPredictor().predict(rig, run).values["inside"] - seen.values) ** 2)))


def test_the_unloaded_image_shows_the_pins_of_the_rig(rig: Rig, presses: Presses) -> None:
    numbers, apart = pins_of(rig, "inside", presses.rest)
    assert sorted(numbers) == list(range(331))
    assert apart < 0.5
    assert presses.number.tolist() == sorted(HELD_OUT)
    assert presses.held_out.all()


def test_what_a_fit_of_other_presses_found_predicts_these(rig: Rig, presses: Presses, tmp_path: Path) -> None:
    still = float(np.sqrt(np.nanmean((presses.uv - presses.rest) ** 2)))
    fitted = with_parameters(rig, FITTED)
    after = miss_px(fitted, presses, -1.0, tmp_path / "after")
    assert after < 0.4 * still
    assert after < miss_px(rig, presses, -1.0, tmp_path / "before")
    # The pad slid by minus the label, as the images of all presses show.
    assert after < 0.7 * miss_px(fitted, presses, 1.0, tmp_path / "other_way")
    # The model of one soft solid does not explain the pins, and must not look as if it did.
    assert after > 4.0 * rig.cameras["inside"].noise.position_px
