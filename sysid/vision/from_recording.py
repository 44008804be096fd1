"""Tracks from the images of a recording, and a recording with these tracks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sim_core.errors import RecordingError, nearest_match
from sysid.recording import ImageStream, PoseStream, Recording, RecordingWriter, TrackStream
from sysid.vision.detect import DetectionParameters, Detections, detect_markers
from sysid.vision.motion import PoseCheck, explain_by_poses, pattern_motion
from sysid.vision.reference import choose_reference
from sysid.vision.report import TrackingReport, make_report
from sysid.vision.track import FrameTracks, TrackParameters, track_frames

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many images are done, and how many there are."""

_AXES = "xyz"


@dataclass(frozen=True)
class TrackingResult:
    """Tracks of one camera and what they are worth."""

    camera: str
    """Name of the camera."""
    stream: TrackStream
    """The tracks, as a recording with tracks has them."""
    tracks: FrameTracks
    """The tracks with reference, misfits and starts."""
    report: TrackingReport
    """Rates, checks and failures."""
    image_size: tuple[int, int]
    """Width and height of the images [px]."""
    broken: int = 0
    """Images that could not be decoded and were skipped."""


def track_recording(
    recording: Recording,
    camera: str | None = None,
    *,
    reference: str | int = "auto",
    depth_axis: str | None = None,
    effector: str | None = None,
    detection: DetectionParameters | None = None,
    tracking: TrackParameters | None = None,
    held_out: NDArray[np.bool_] | None = None,
    cycle_frames: int = 100,
    progress: Progress | None = None,
) -> TrackingResult:
    """Detect and track the markers in the images of one camera.

    Main arguments: the recording, and the camera's name (None when there is one camera only).
    Other arguments: ``reference`` as in ``choose_reference``; ``depth_axis`` is the pose axis that says how
    deep a press is: ``x``, ``y`` or ``z``, with ``-`` when deeper is less; ``effector`` is the end effector
    that carries or touches the sensor (None when there is one only); ``held_out`` marks the images that
    test the pose check, shape ``(n,)``, every fifth by default; ``cycle_frames`` is the number of images in
    the cycle check.
    """
    name, images = _camera(recording, camera)
    tracking = tracking or TrackParameters()
    images, detections, broken = _detect(images, detection, progress)
    if held_out is not None and broken:
        held_out = np.delete(held_out, broken)
    poses = _poses_at(images.t, _effector(recording, effector))
    posed: NDArray[np.bool_] = np.asarray(np.isfinite(poses).all(axis=1))
    column, sign = _depth(depth_axis)
    depth = None if column is None else sign * poses[:, column]
    layout = choose_reference(detections, choice=reference, posed=posed if posed.any() else None, depth=depth)

    def report_progress(done: int, total: int) -> None:
        if progress is not None:
            progress("track", done, total)

    tracks = track_frames(detections, layout, tracking, progress=report_progress)
    if held_out is None:
        held_out = np.arange(len(images)) % 5 == 0
    linear = _pose_check(tracks, poses, held_out, None)
    report = make_report(
        name,
        images.t,
        detections,
        tracks,
        tracking,
        cycle_frames=cycle_frames,
        pose_check=linear,
        pose_check_by_depth=None if column is None else _pose_check(tracks, poses, held_out, column),
    )
    stream = TrackStream(
        topic=tracks_topic(images.topic),
        frame_id=images.frame_id,
        t=images.t,
        ids=np.arange(len(tracks.reference)),
        uv=tracks.uv,
        confidence=tracks.confidence,
        camera_info=images.camera_info,
    )
    return TrackingResult(name, stream, tracks, report, detections[0].image_size, len(broken))


def tracks_topic(image_topic: str) -> str:
    """Return the topic of tracks that belongs to an image topic: in the same namespace."""
    return f"{_namespace(image_topic)}/marker_tracks"


def write_tracked_recording(recording: Recording, results: list[TrackingResult], out: str | Path) -> Path:
    """Write a recording with the tracks, poses, wrenches, 3-D markers and camera infos; images stay behind.

    The source is not touched; ``out`` must not exist. Returns the path of the new bag.
    """
    t0 = recording.t0_ns

    def stamps(t: NDArray[np.float64]) -> list[int]:
        return [t0 + round(1e9 * float(value)) for value in t]

    with RecordingWriter(out) as bag:
        pose_streams = {s.topic: s for s in (*recording.poses.values(), *recording.target_poses.values())}
        for pose in pose_streams.values():
            for k, stamp in enumerate(stamps(pose.t)):
                bag.pose(pose.topic, stamp, pose.position[k], pose.quaternion[k], pose.frame_id)
        for wrench in recording.wrenches.values():
            for k, stamp in enumerate(stamps(wrench.t)):
                bag.wrench(wrench.topic, stamp, wrench.force[k], wrench.torque[k], wrench.frame_id)
        for cloud in recording.markers.values():
            rest = cloud.rest
            if rest is None:
                continue
            for k, stamp in enumerate(stamps(cloud.t)):
                forces = None if cloud.force is None else cloud.force[k]
                bag.markers(cloud.topic, stamp, cloud.position[k], rest, cloud.ids, cloud.frame_id, forces=forces)
        for result in results:
            _write_tracks(bag, result, stamps(result.stream.t))
    return Path(out)


def _write_tracks(bag: RecordingWriter, result: TrackingResult, stamps: list[int]) -> None:
    stream, info = result.stream, result.stream.camera_info
    width, height = result.image_size
    bag.camera_info(
        f"{_namespace(stream.topic)}/camera_info",
        stamps[0],
        np.zeros((3, 3)) if info is None else info.recorded().K,
        np.zeros(5) if info is None else info.D,
        "plumb_bob" if info is None else info.model,
        width,
        height,
        stream.frame_id,
    )
    for k, stamp in enumerate(stamps):
        bag.tracks(stream.topic, stamp, stream.uv[k], stream.ids, stream.confidence[k], stream.frame_id)


def _camera(recording: Recording, camera: str | None) -> tuple[str, ImageStream]:
    images = recording.images
    if not images:
        raise RecordingError(
            f"{recording.provenance.path} holds no images.",
            "Give a recording with an image topic, or a rig that names it (--rig).",
        )
    if camera is None:
        if len(images) > 1:
            raise RecordingError(
                f"{recording.provenance.path} holds images of {len(images)} cameras.",
                "Name one: " + ", ".join(sorted(images)) + ".",
            )
        camera = next(iter(images))
    if camera not in images:
        raise RecordingError(f"There are no images of a camera {camera!r}.", nearest_match(camera, images))
    return camera, images[camera]


def _detect(
    images: ImageStream, parameters: DetectionParameters | None, progress: Progress | None
) -> tuple[ImageStream, list[Detections], list[int]]:
    """The images that can be decoded, the markers in each, and which images were skipped."""
    found: list[Detections] = []
    broken: list[int] = []
    fault: RecordingError | None = None
    for k, (_, image) in enumerate(images.decoded()):
        if isinstance(image, RecordingError):
            broken.append(k)
            fault = fault or image
        else:
            found.append(detect_markers(image, parameters))
        if progress is not None:
            progress("detect", k + 1, len(images))
    if fault is not None and not found:
        raise fault
    return images.take(np.delete(np.arange(len(images)), broken)), found, broken


def _effector(recording: Recording, effector: str | None) -> PoseStream | None:
    if effector is None:
        return next(iter(recording.poses.values())) if len(recording.poses) == 1 else None
    if effector not in recording.poses:
        raise RecordingError(f"There is no end effector {effector!r}.", nearest_match(effector, recording.poses))
    return recording.poses[effector]


def _poses_at(t: NDArray[np.float64], stream: PoseStream | None) -> NDArray[np.float64]:
    """Return position [m] and rotation vector from the mean orientation [rad] at times ``t`` [s], ``(n, 6)``.

    An image takes the nearest pose within half the usual least time between images; else its row is NaN.
    """
    poses = np.full((len(t), 6), np.nan)
    if stream is None or not len(stream):
        return poses
    spacing = float(np.percentile(np.diff(t), 5)) if len(t) > 1 else 1.0
    after = np.clip(np.searchsorted(stream.t, t), 0, len(stream) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(stream.t[after] - t) <= np.abs(stream.t[before] - t), after, before)
    near = np.abs(stream.t[nearest] - t) <= 0.5 * spacing
    rotation = Rotation.from_quat(stream.quaternion)
    turned = (rotation * rotation.mean().inv()).as_rotvec()
    poses[near] = np.concatenate([stream.position, turned], axis=1)[nearest[near]]
    return poses


def _depth(axis: str | None) -> tuple[int | None, float]:
    if axis is None:
        return None, 1.0
    name = axis.lstrip("+-")
    if name not in tuple(_AXES):
        raise RecordingError(f"The depth axis {axis!r} is not known.", "Give x, y or z, with - for minus.")
    return _AXES.index(name), -1.0 if axis.startswith("-") else 1.0


def _pose_check(
    tracks: FrameTracks, poses: NDArray[np.float64], held_out: NDArray[np.bool_], depth: int | None
) -> PoseCheck | None:
    """Return the check, or None where there are too few frames with poses for one."""
    known = np.isfinite(poses).all(axis=1) & ~tracks.failed
    if min((known & held_out).sum(), (known & ~held_out).sum()) < 26:
        return None
    motion = pattern_motion(tracks.reference.uv, tracks.uv)
    return explain_by_poses(motion, np.where(known[:, None], poses, np.nan), held_out, depth=depth)


def _namespace(topic: str) -> str:
    """Return what stands before ``image``, ``image/compressed`` or another last word of a topic."""
    words = topic.strip("/").split("/")
    drop = 2 if words[-1] == "compressed" and len(words) > 1 else 1
    return "".join(f"/{word}" for word in words[:-drop])
