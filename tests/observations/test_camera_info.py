"""What camera_info states of the pictures (REP 104) is used, or contradicted by name."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from sim_core.rigs import PinholeCamera, Rig, load_rig
from sysid.observations.checks import Finding, examine
from sysid.observations.checks.cameras import cameras
from sysid.observations.checks.identity import frames, pose_covariance
from sysid.observations.rig_topics import topics_of
from sysid.recording import CameraInfo, Recording, read_recording
from sysid.recording.bag import open_bag
from sysid.recording.notes import Notes

ROOT = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
FAULT = ROOT / "faults" / "camera_info_binning"
BAG = Path(__file__).resolve().parents[2] / "bags" / "press_post"


@pytest.fixture(scope="module")
def sound() -> Recording:
    return read_recording(BAG)


@pytest.fixture
def rig() -> Rig:
    return load_rig("card_press")


def camera(rig: Rig) -> PinholeCamera:
    found = rig.cameras["outside"]
    assert isinstance(found, PinholeCamera)
    return found


def states(sound: Recording, rig: Rig, **changes: object) -> Recording:
    """The recording with another camera_info: that of the rig, with changes."""
    known = camera(rig)
    info = CameraInfo(
        known.matrix(), np.zeros(5), "plumb_bob", known.width_px, known.height_px, "outside_optical_frame",
        np.eye(3), np.hstack([known.matrix(), np.zeros((3, 1))]),
    )  # fmt: skip
    (stream,) = sound.tracks.values()
    return replace(sound, tracks={"outside": replace(stream, camera_info=replace(info, **changes))})  # type: ignore[arg-type]


def found(recording: Recording, rig: Rig) -> list[Finding]:
    return list(cameras(recording, rig))


def names(findings: list[Finding]) -> list[tuple[str, str]]:
    return [(f.name, f.severity) for f in findings]


def test_the_calibration_of_the_rig_is_accused_of_nothing(sound: Recording, rig: Rig) -> None:
    assert found(states(sound, rig), rig) == []


def whole_sensor(rig: Rig, b: int, x: int = 0, y: int = 0) -> dict[str, object]:
    """The calibration of the sensor of which the pictures of the rig are a part: b x b pixels are one, from (x, y)."""
    known = camera(rig)
    K = known.matrix()
    # The centre of pixel u of the picture is that of columns b u to b u + b - 1 of the window.
    K[0] = b * K[0] + [0.0, 0.0, x + 0.5 * (b - 1)]
    K[1] = b * K[1] + [0.0, 0.0, y + 0.5 * (b - 1)]
    return {
        "K": K,
        "P": np.hstack([K, np.zeros((3, 1))]),
        "width": b * known.width_px + 2 * x,
        "height": b * known.height_px + 2 * y,
    }


@pytest.mark.parametrize("b", [1, 2, 4])
@pytest.mark.parametrize("place", [(0, 0), (400, 300)])
def test_binning_and_window_are_used(sound: Recording, rig: Rig, b: int, place: tuple[int, int]) -> None:
    known = camera(rig)
    roi = (*place, b * known.width_px, b * known.height_px) if any(place) else (0, 0, 0, 0)
    whole = whole_sensor(rig, b, *place)
    assert found(states(sound, rig, **whole, binning=(b, b), roi=roi), rig) == []
    assert bool(found(states(sound, rig, **whole), rig)) == (b > 1 or any(place))


def test_the_matrix_of_a_binned_window_projects_as_the_sensor_does() -> None:
    K = np.array([[1500.0, 0.0, 640.0], [0.0, 1400.0, 350.0], [0.0, 0.0, 1.0]])
    info = CameraInfo(K, np.zeros(5), "plumb_bob", 1280, 720, "c", binning=(2, 4), roi=(200, 100, 640, 400))
    seen = info.recorded()
    assert (seen.width, seen.height) == (320, 100)
    # Sensor pixels 230, 231 and 132 to 135 make picture pixel (15, 8); its centre is where that of the block is.
    ray = np.linalg.solve(K, [230.5, 133.5, 1.0])
    np.testing.assert_allclose(seen.K @ ray, [15.0, 8.0, 1.0], atol=1e-12)


def test_a_cropped_picture_is_no_picture_of_the_whole_sensor(sound: Recording, rig: Rig) -> None:
    said = found(states(sound, rig, roi=(100, 0, 1080, 720)), rig)
    assert ("picture_size", "stops a fit") in names(said)
    assert "roi 1080 x 720 px from column 100 and row 0 on" in said[0].problem


def test_binning_that_the_tracks_contradict_is_not_used(sound: Recording, rig: Rig) -> None:
    """A driver that scales its calibration and states the binning all the same."""
    said = found(states(sound, rig, binning=(2, 2)), rig)
    assert names(said) == [("camera_binning", "warning")]
    assert "binning 2 x 2" in said[0].problem and "640 x 360 px" in said[0].problem


def test_a_distortion_that_the_rig_lacks_is_said_in_pixels(sound: Recording, rig: Rig) -> None:
    D = np.array([-0.2, 0.05, 0.001, -0.002, 0.0])
    said = found(states(sound, rig, D=D), rig)
    assert names(said) == [("distortion", "warning")]
    assert "`distortion: [-0.2, 0.05, 0.001, -0.002, 0]`" in said[0].remedy
    (tracks,) = sound.tracks.values()
    uv = tracks.uv[np.isfinite(tracks.uv).all(axis=-1)]
    known = camera(rig).matrix()
    rays = np.column_stack([np.linalg.solve(known, np.column_stack([uv, np.ones(len(uv))]).T).T])
    moved = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), known, D)[0].reshape(-1, 2)
    worst = float(np.linalg.norm(moved - uv, axis=1).max())
    assert 0.95 * worst < said[0].values[0] < 1.5 * worst

    knowing = camera(rig).model_copy(update={"distortion": tuple(D.tolist())})
    same = rig.model_copy(update={"cameras": {"outside": knowing}})
    assert found(states(sound, rig, D=D), same) == []
    assert names(found(states(sound, rig), same)) == [("distortion", "warning")]


def test_a_rig_of_rectified_pictures_is_noted(sound: Recording, rig: Rig) -> None:
    K = camera(rig).matrix() * np.array([[1.1, 1.0, 1.0], [1.0, 1.1, 1.0], [1.0, 1.0, 1.0]])
    P = np.hstack([camera(rig).matrix(), np.zeros((3, 1))])
    assert names(found(states(sound, rig, K=K, P=P, D=np.array([-0.2, 0, 0, 0, 0])), rig)) == [
        ("rectified_pictures", "note")
    ]
    topics = camera(rig).topics.model_copy(update={"image": "outside/image_rect"})
    of_rectified = rig.model_copy(update={"cameras": {"outside": camera(rig).model_copy(update={"topics": topics})}})
    stated = states(sound, rig, K=K, P=P, D=np.array([-0.2, 0, 0, 0, 0]))
    assert found(stated, of_rectified) == []
    turned = cv2.Rodrigues(np.array([0.0, 0.1, 0.0]))[0]
    assert names(
        found(
            replace(
                stated,
                tracks={
                    "outside": replace(
                        stated.tracks["outside"], camera_info=replace(stated.tracks["outside"].camera_info, R=turned)
                    )
                },
            ),
            of_rectified,
        )
    ) == [  # type: ignore[type-var]
        ("rectified_pictures", "warning")
    ]


def test_frames_of_poses_are_compared_with_the_default_too(sound: Recording, rig: Rig) -> None:
    def read(frame: str) -> Iterator[Finding]:
        (name,) = rig.end_effectors
        pose = next(iter(sound.poses.values()))
        return frames(replace(sound, poses={name: replace(pose, frame_id=frame)}), rig)

    assert list(read("base_link")) == []
    (said,) = read("map")
    assert "'map'" in said.problem and "'base_link'" in said.problem


def test_what_a_covariance_states_is_compared_with_what_the_rig_says(sound: Recording, rig: Rig) -> None:
    (name,) = rig.end_effectors
    pose = next(iter(sound.poses.values()))

    def stated(sd: tuple[float, float] | None) -> list[Finding]:
        return list(pose_covariance(replace(sound, poses={name: replace(pose, stated_sd=sd)}), rig))

    assert stated(None) == [] and stated((1e-4, 1e-3)) == []
    assert "0.02 m" in stated((0.02, 1e-3))[0].problem


@pytest.mark.skipif(not FAULT.is_dir(), reason="the shared inputs are not here")
def test_a_binned_recording_agrees_with_a_right_rig() -> None:
    rig, bag = load_rig(str(FAULT / "rig.yaml")), FAULT / "binning_rig_half"
    recording = read_recording(bag, topics_of(rig, open_bag(bag, Notes()).topics)[0])
    assert not [f for f in examine(recording, rig)[0] if f.severity != "note"]
