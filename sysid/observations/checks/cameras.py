"""What a recording itself states of its cameras, against the rig."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sim_core.errors import RecordingError
from sim_core.rigs import FisheyeCamera, OrthographicCamera, PinholeCamera, Rig
from sysid.observations.checks.finding import Finding
from sysid.recording import CameraInfo, Recording, TrackStream
from sysid.settings.observations import OBSERVATIONS

MODELS = {"plumb_bob": "pinhole", "rational_polynomial": "pinhole", "equidistant": "fisheye", "": "pinhole"}
"""Models of the rig by those of ``camera_info``."""

Lens = PinholeCamera | FisheyeCamera


def cameras(recording: Recording, rig: Rig) -> Iterator[Finding]:
    """Model, size of the picture, intrinsics and distortion of each camera, and tracks outside of the picture."""
    for name, camera in rig.cameras.items():
        tracks, images = recording.tracks.get(name), recording.images.get(name)
        stream = tracks if tracks is not None else images
        if stream is None:
            continue
        known = (camera.width_px, camera.height_px)
        seen = None
        if images is not None and len(images):
            try:
                image = images.image(0)
                seen = (image.shape[1], image.shape[0])
            except RecordingError:
                pass
        info = stream.camera_info if tracks is None else tracks.camera_info
        if info is not None:
            rectified = _rectified(images.topic if images is not None else camera.topics.image)
            whole = replace(info, binning=(1, 1), roi=(0, 0, 0, 0))
            if _contradicted(info.recorded(), tracks, seen) and (info.width, info.height) == known:
                yield Finding(
                    "camera_binning",
                    stream.topic,
                    "warning",
                    f"camera_info states {_part(info)} for {name}, so pictures of "
                    f"{_times(info.recorded())}; {'the first picture has' if seen else 'its tracks reach over'} "
                    f"{_times(whole)}, as width and height of camera_info and the rig say. The binning and roi that it "
                    "states are not used.",
                    "REP 104 counts width, height, K and roi in pixels of the whole sensor at full resolution: correct "
                    "the driver, or leave the rig as it is where it is of these pictures.",
                    part=name,
                )
                info = whole
            yield from _size(name, stream.topic, "camera_info", info, known)
            if isinstance(camera, PinholeCamera | FisheyeCamera):
                yield from _lens(name, stream.topic, info, rectified, camera, tracks)
        if images is not None and seen is not None and seen != known:
            yield _other_size(name, images.topic, "its first picture", seen, known)
        if tracks is not None and not (isinstance(camera, OrthographicCamera) and camera.origin_id is not None):
            share, reach = _outside(tracks, known)
            if share > OBSERVATIONS.outside_picture_share:
                yield Finding(
                    "tracks_outside",
                    tracks.topic,
                    "warning",
                    f"{100 * share:.0f} % of the tracks of {name} are outside of its picture of {known[0]} x "
                    f"{known[1]} px: they reach over {reach} px (more than "
                    f"{100 * OBSERVATIONS.outside_picture_share:g} %).",
                    "Give width_px, height_px and intrinsics of the picture in which they were tracked.",
                    values=(share,),
                    bound=OBSERVATIONS.outside_picture_share,
                    part=name,
                )


def _rectified(topic: str) -> bool:
    """Whether pictures of a topic are rectified, by the names of image_proc."""
    return any(word.startswith("image_rect") for word in topic.split("/"))


def _outside(tracks: TrackStream, size: tuple[int, int]) -> tuple[float, str]:
    """Share of the tracks outside of a picture of ``size`` [px], and over what they reach."""
    seen = tracks.uv[np.isfinite(tracks.uv).all(axis=-1)]
    if not len(seen):
        return 0.0, ""
    outside = ((seen < -0.5) | (seen > np.array(size) - 0.5)).any(axis=1)
    reach = ", ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(seen.min(axis=0), seen.max(axis=0), strict=True))
    return float(outside.mean()), reach


def _contradicted(info: CameraInfo, tracks: TrackStream | None, seen: tuple[int, int] | None) -> bool:
    """Whether pictures or tracks show that the pictures are larger than camera_info, binned and cut, says."""
    if not (info.width and info.height):
        return False
    if seen is not None:
        return seen != (info.width, info.height)
    share, _ = (0.0, "") if tracks is None else _outside(tracks, (info.width, info.height))
    return share > OBSERVATIONS.outside_picture_share


def _part(info: CameraInfo) -> str:
    """Which part of the sensor pictures show, in words; '' for all of it."""
    x, y, width, height = info.roi
    parts = [f"binning {info.binning[0]} x {info.binning[1]}"] if info.binning != (1, 1) else []
    if (width and height) or x or y:
        parts.append(f"roi {width} x {height} px from column {x} and row {y} on")
    return " and ".join(parts)


def _times(info: CameraInfo) -> str:
    return f"{info.width} x {info.height} px"


def _size(name: str, topic: str, source: str, info: CameraInfo, known: tuple[int, int]) -> Iterator[Finding]:
    shown = info.recorded()
    if not (shown.width and shown.height) or (shown.width, shown.height) == known:
        return
    part = _part(info)
    words = f"{source} ({_times(info)} with {part})" if part else source
    yield _other_size(name, topic, words, (shown.width, shown.height), known)


def _other_size(name: str, topic: str, source: str, size: tuple[int, int], known: tuple[int, int]) -> Finding:
    return Finding(
        "picture_size",
        topic,
        "stops a fit",
        f"{source} says that the picture of {name} is {size[0]} x {size[1]} px, the rig {known[0]} x {known[1]} px.",
        "Give the intrinsics of the picture that was recorded: binning scales fx, fy, cx and cy, cropping shifts cx "
        "and cy.",
        values=(float(size[0]), float(size[1])),
        bound=float(known[0]),
        part=name,
    )


def _lens(
    name: str, topic: str, info: CameraInfo, rectified: bool, camera: Lens, tracks: TrackStream | None
) -> Iterator[Finding]:
    raw, plain = info.recorded(), info.recorded(rectified=True)
    if rectified and not info.P.any():
        yield Finding(
            "rectified_pictures",
            topic,
            "warning",
            f"The pictures of {name} are rectified, and camera_info has no P: its intrinsics cannot be compared with "
            "the rig.",
            "Record the camera_info of the rectified pictures.",
            part=name,
        )
        return
    model = "pinhole" if rectified else MODELS[info.model]
    if model != camera.model and (rectified or np.any(info.D)):
        found = "rectified" if rectified else info.model
        yield Finding(
            "camera_model",
            topic,
            "stops a fit",
            f"camera_info says that {name} is a {model} camera ({found}), the rig a {camera.model} one.",
            f"Write `model: {model}` and its distortion into the rig.",
            part=name,
        )
        return
    of_rectified = not rectified and bool(info.P.any()) and not any(camera.distortion) and bool(np.any(info.D))
    if of_rectified and _agrees(plain.K, camera) and not _agrees(raw.K, camera):
        yield Finding(
            "rectified_pictures",
            topic,
            "note",
            f"The rig has the intrinsics of {name} that camera_info gives for rectified pictures (P), and no "
            "distortion: that is right only if the markers were tracked in rectified pictures.",
            "",
            part=name,
        )
        rectified = True
    shown = plain if rectified else raw
    yield from _intrinsics(name, topic, shown, "P" if rectified else "K", camera)
    yield from _distortion(name, topic, shown, camera, tracks)
    if rectified and info.R.any():
        turn = float(np.degrees(np.arccos(np.clip(0.5 * (np.trace(info.R) - 1.0), -1.0, 1.0))))
        if turn > max(camera.offset_sd_deg) * OBSERVATIONS.camera_apart_sd and turn > OBSERVATIONS.camera_turn_deg:
            yield Finding(
                "rectified_pictures",
                topic,
                "warning",
                f"Rectified pictures of {name} are those of a camera that is turned by {turn:.2g} degrees against "
                f"its optical frame {info.frame_id!r} (R of camera_info; more than {OBSERVATIONS.camera_turn_deg:g}).",
                "Give the pose of the turned camera in the rig: that of the optical frame times the transpose of R.",
                values=(turn,),
                bound=OBSERVATIONS.camera_turn_deg,
                part=name,
            )


def _agrees(K: np.ndarray, camera: Lens) -> bool:
    known = camera.matrix()
    return bool(
        np.abs(np.diag(K)[:2] / np.diag(known)[:2] - 1.0).max() <= OBSERVATIONS.camera_same_focal
        and np.abs(K[:2, 2] - known[:2, 2]).max() <= OBSERVATIONS.camera_same_centre_px
    )


def _intrinsics(name: str, topic: str, info: CameraInfo, word_of: str, camera: Lens) -> Iterator[Finding]:
    for word, found, known in (("fx", info.K[0, 0], camera.fx_px), ("fy", info.K[1, 1], camera.fy_px)):
        off = abs(found / known - 1.0)
        bound = max(OBSERVATIONS.camera_apart_sd * camera.scale_sd, OBSERVATIONS.camera_same_focal)
        if off > bound:
            yield Finding(
                "focal_length",
                topic,
                "stops a fit" if off > OBSERVATIONS.camera_focal_difference else "warning",
                f"camera_info gives {word} = {found:.5g} px ({word_of}) for {name}, the rig {known:.5g} px, "
                f"{100 * off:.2g} % apart (more than {100 * bound:.2g} %).",
                "Write the calibrated focal length of the picture that was recorded into the rig.",
                values=(float(found),),
                bound=known,
                part=name,
            )
            break
    centre = np.array([info.K[0, 2], info.K[1, 2]])
    known_centre = np.array([camera.cx_px, camera.cy_px])
    apart = max(OBSERVATIONS.camera_apart_sd * camera.centre_sd_px, OBSERVATIONS.camera_same_centre_px)
    if np.abs(centre - known_centre).max() > apart:
        yield Finding(
            "principal_point",
            topic,
            "warning",
            f"camera_info puts the principal point of {name} at ({centre[0]:.5g}, {centre[1]:.5g}) px, the rig at "
            f"({known_centre[0]:.5g}, {known_centre[1]:.5g}) px.",
            "Write the calibrated principal point of the picture that was recorded into the rig.",
            values=(float(centre[0]), float(centre[1])),
            bound=apart,
            part=name,
        )


def _distortion(name: str, topic: str, info: CameraInfo, camera: Lens, tracks: TrackStream | None) -> Iterator[Finding]:
    """Where the two distortions put the same rays, with the focal lengths of the rig, over the part of the picture in
    which there are markers."""
    if not np.any(info.D) and not any(camera.distortion):
        return
    import cv2

    low, high = np.zeros(2), np.array([camera.width_px, camera.height_px]) - 1.0
    if tracks is not None and np.isfinite(tracks.uv).any():
        low = np.nanmin(tracks.uv, axis=(0, 1)).clip(low, high)
        high = np.nanmax(tracks.uv, axis=(0, 1)).clip(low, high)
    pixels = np.stack(np.meshgrid(*np.linspace(low, high, OBSERVATIONS.camera_rays).T), axis=-1).reshape(-1, 1, 2)
    fisheye, matrix, zero = isinstance(camera, FisheyeCamera), camera.matrix(), np.zeros(3)
    undistorted, projected = (
        (cv2.fisheye.undistortPoints, cv2.fisheye.projectPoints)
        if fisheye
        else (cv2.undistortPoints, cv2.projectPoints)
    )
    given = info.D if len(info.D) else np.zeros(4)
    rays = undistorted(pixels, matrix, np.asarray(camera.distortion)).reshape(-1, 1, 2)
    rays = np.concatenate([rays, np.ones((len(rays), 1, 1))], axis=-1)
    places = projected(rays, zero, zero, matrix, given)[0].reshape(-1, 2)
    off = np.linalg.norm(places - pixels[:, 0], axis=1)
    bound = camera.noise.position_px or OBSERVATIONS.camera_same_centre_px
    worst = float(np.nanmax(off)) if np.isfinite(off).any() else np.inf
    if not worst > bound:
        return
    known = "none" if not any(camera.distortion) else _numbers(camera.distortion)
    stated = _numbers(info.D) if np.any(info.D) else "none"
    room = len(camera.distortion)
    written = "[" + ", ".join(f"{v:.6g}" for v in [*given, *[0.0] * room][:room]) + "]"
    yield Finding(
        "distortion",
        topic,
        "warning",
        f"camera_info gives the distortion {stated} ({info.model or 'no model'}) for {name}, the rig {known}: markers "
        f"are up to {worst:.3g} px apart (more than {bound:.2g} px).",
        f"Write `distortion: {written}` into the rig; if the markers were tracked in rectified pictures, write the "
        "intrinsics of these."
        if not np.any(given[room:])
        else "The rig has no coefficients of this model beyond the first five: track markers in rectified pictures, or "
        "calibrate as plumb_bob.",
        values=(worst,),
        bound=bound,
        part=name,
    )


def _numbers(values: np.ndarray | tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"
