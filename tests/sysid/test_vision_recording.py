"""From a bag with images to a bag with tracks, report and pictures; and the same on real recordings."""

from __future__ import annotations

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from sim_core.errors import RecordingError
from sysid.recording import RecordingWriter, read_recording
from sysid.vision import overlay, slide_sign, track_recording, write_tracked_recording
from sysid.vision.command import track
from sysid.vision.from_recording import tracks_topic

SHARED = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
TACTIP = SHARED / "data" / "tactip_shear"
GELSIGHT = SHARED / "data" / "gelsight_mini" / "20250414_170810"

SIZE = (240, 200)


def picture(centres: np.ndarray, diameter: float = 9.0) -> np.ndarray:
    """Return a binary image with a disc at each centre."""
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    gap = ((u[..., None] - centres[:, 0]) ** 2 + (v[..., None] - centres[:, 1]) ** 2).min(axis=2)
    return np.where(gap <= diameter**2 / 4.0, 255, 0).astype(np.uint8)


def layout() -> np.ndarray:
    u, v = np.meshgrid(np.linspace(45, 195, 9), np.linspace(35, 165, 8))
    return np.stack([u.ravel(), v.ravel()], axis=1) + np.random.default_rng(1).uniform(-0.5, 0.5, (72, 2))


def pressed(points: np.ndarray, shift: np.ndarray, depth: float) -> np.ndarray:
    arm = points - [120.0, 100.0]
    weight = np.exp(-np.sum(arm**2, axis=1) / (2.0 * 80.0**2))[:, None]
    return np.asarray(points + weight * (depth * shift + 0.03 * depth * arm))


def press_bag(path: Path, *, presses: int = 11, blank: int | None = None, missing: int | None = None) -> np.ndarray:
    """Write a rest image and presses with poses; return the true dot positions, shape (n, 72, 2)."""
    rng, points = np.random.default_rng(2), layout()
    truth = [points]
    with RecordingWriter(path) as bag:
        bag.camera_info("gel/camera_info", 10**9, np.zeros((3, 3)), np.zeros(5), "plumb_bob", *SIZE, "cam")
        bag.image_compressed("gel/image/compressed", 10**9, picture(points), "cam")
        for k in range(presses):
            stamp = (2 + k) * 10**9
            shift, depth = rng.uniform(-6, 6, 2), rng.uniform(0.4, 1.5)
            moved = pressed(points, shift, depth)
            shown = np.delete(moved, 40, axis=0) if missing == k + 1 else moved
            image = np.zeros((SIZE[1], SIZE[0]), np.uint8) if blank == k + 1 else picture(shown)
            bag.image_compressed("gel/image/compressed", stamp, image, "cam")
            position = (1e-3 * shift[0], 1e-3 * shift[1], 1e-3 * depth)
            bag.pose("target_pose", stamp, position, (0.0, 0.0, 0.0, 1.0), "plate")
            truth.append(moved)
    return np.array(truth)


def test_a_recording_with_images_becomes_one_with_tracks(tmp_path: Path) -> None:
    truth = press_bag(tmp_path / "source", missing=3)
    before = {p.name: p.read_bytes() for p in (tmp_path / "source").iterdir()}
    recording = read_recording(tmp_path / "source")
    result = track_recording(recording)
    assert result.report.markers == 72
    assert "unloaded" in result.report.reference
    assert result.report.overall_rate == pytest.approx(1.0 - 1.0 / truth[..., 0].size)
    assert [remark.frame for remark in result.report.incomplete] == [3]
    assert "1 not seen" in result.report.incomplete[0].reason
    assert result.report.cycle.rate == 1.0
    order = np.linalg.norm(result.tracks.reference.uv[:, None] - truth[0][None], axis=2).argmin(axis=1)
    error = np.linalg.norm(result.stream.uv - truth[:, order], axis=2)
    assert np.nanmax(error) < 0.5
    assert np.isnan(error[3, order == 40]).all()

    out = write_tracked_recording(recording, [result], tmp_path / "tracked")
    again = read_recording(out)
    stream = next(iter(again.tracks.values()))
    assert stream.topic == "/gel/marker_tracks"
    assert not again.images
    np.testing.assert_allclose(stream.uv, result.stream.uv, atol=1e-4)
    np.testing.assert_allclose(stream.confidence, result.stream.confidence, atol=1e-6)
    np.testing.assert_array_equal(stream.ids, np.arange(72))
    pose, source_pose = next(iter(again.poses.values())), next(iter(recording.poses.values()))
    np.testing.assert_allclose(pose.position, source_pose.position)
    np.testing.assert_allclose(pose.t + 1e-9 * again.t0_ns, source_pose.t + 1e-9 * recording.t0_ns)
    assert "/gel/camera_info" in again.provenance.topic_types
    assert {p.name: p.read_bytes() for p in (tmp_path / "source").iterdir()} == before


def test_the_command_writes_bag_report_and_overlay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    press_bag(tmp_path / "source", blank=4)
    track(tmp_path / "source", tmp_path / "out", depth_axis="z", pictures=3)
    text = capsys.readouterr().out
    assert "72 markers in 12 images" in text
    assert "Images given up: 1." in text
    assert "the image is uniform" in text
    content = json.loads((tmp_path / "out" / "tracking.json").read_text())
    assert content["failures"][0]["frame"] == 4
    assert content["rate"][4] == 0.0
    assert len(content["reference_uv_px"]) == 72
    sheet = cv2.imread(str(tmp_path / "out" / "overlay.png"))
    assert sheet.shape == (600, 3 * 720, 3)
    assert read_recording(tmp_path / "out" / "tracked").tracks
    with pytest.raises(RecordingError, match="exists already"):
        track(tmp_path / "source", tmp_path / "out")


def test_no_images_an_unknown_camera_or_axis_are_refused(tmp_path: Path) -> None:
    press_bag(tmp_path / "source")
    recording = read_recording(tmp_path / "source")
    with pytest.raises(RecordingError, match="no images of a camera 'lef'"):
        track_recording(recording, "lef")
    with pytest.raises(RecordingError, match="depth axis 'w'"):
        track_recording(recording, depth_axis="w")
    tracked = write_tracked_recording(recording, [track_recording(recording)], tmp_path / "tracked")
    with pytest.raises(RecordingError, match="holds no images"):
        track_recording(read_recording(tracked))


def test_an_overlay_shows_arrows_lost_markers_and_numbers() -> None:
    points = layout()
    uv = points + [4.0, 0.0]
    uv[7] = np.nan
    drawn = overlay(picture(points), uv, points, place=points + [4.0, 0.0], scale=4)
    assert drawn.shape == (4 * SIZE[1], 4 * SIZE[0], 3)
    u, v = (4 * (points[7] + [4.0, 0.0]) + 2).round().astype(int)
    assert tuple(drawn[v, u]) == (255, 60, 60)
    u, v = (4 * (points[30] + [4.0, 0.0]) + 2).round().astype(int)
    assert tuple(drawn[v, u]) == (0, 230, 0)


@pytest.mark.parametrize(
    ("topic", "expected"),
    [
        ("/image/compressed", "/marker_tracks"),
        ("/left/image", "/left/marker_tracks"),
        ("/a/b/image/compressed", "/a/b/marker_tracks"),
        ("/image", "/marker_tracks"),
    ],
)
def test_tracks_stand_next_to_their_images(topic: str, expected: str) -> None:
    assert tracks_topic(topic) == expected


needs_tactip = pytest.mark.skipif(
    not TACTIP.is_dir(), reason=f"no folder {TACTIP}: set THINSHELL_SHARED to the folder that holds data/"
)


@needs_tactip
@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "rate", "slide", "least"),
    [
        ("cr_tactip", 0.999, -1.0, {"displacement_u": 0.85, "displacement_v": 0.85, "contact_u": 0.95}),
        ("franka_tactip_1", 0.99, 1.0, {"displacement_u": 0.92, "displacement_v": 0.92, "contact_u": 0.85}),
    ],
)
def test_pins_of_a_tactip(part: str, rate: float, slide: float, least: dict[str, float]) -> None:
    recording = read_recording(TACTIP / part, need_pose=False)
    name, images = next(iter(recording.images.items()))
    number = np.rint(images.t + 1e-9 * recording.t0_ns - 1.0).astype(int)
    result = track_recording(recording, name, depth_axis="z", held_out=number % 5 == 0, cycle_frames=40)
    report = result.report
    assert report.markers == 331
    assert report.overall_rate > rate
    assert report.rate.min() > 0.9
    assert not report.failures
    assert report.folded.max() == 0.0
    assert report.flipped.max() < 0.06
    assert report.cycle.rate > 0.9999
    check = report.pose_check_by_depth
    assert check is not None
    for motion, bound in least.items():
        assert check.r_squared[motion] > bound
    verdict = slide_sign(check)
    assert verdict.alignment * slide > 0.98
    assert verdict.twist * slide > 0.0
    assert verdict.upright


@pytest.mark.skipif(
    not GELSIGHT.is_dir(), reason=f"no folder {GELSIGHT}: set THINSHELL_SHARED to the folder that holds data/"
)
def test_a_gel_without_markers_is_said_to_have_none() -> None:
    recording = read_recording(GELSIGHT, need_pose=False)
    with pytest.raises(RecordingError, match="No marker pattern in any of 41 images"):
        track_recording(recording)
