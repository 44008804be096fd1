"""What a recording itself states of its cameras, against the rig."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.errors import RecordingError
from sim_core.rigs import FisheyeCamera, OrthographicCamera, PinholeCamera, Rig
from sysid.observations.checks.finding import Finding
from sysid.recording import CameraInfo, Recording
from sysid.settings.observations import OBSERVATIONS

MODELS = {"plumb_bob": "pinhole", "rational_polynomial": "pinhole", "equidistant": "fisheye", "": "pinhole"}
"""Models of the rig by those of ``camera_info``."""


def cameras(recording: Recording, rig: Rig) -> Iterator[Finding]:
    """Model, size of the picture and intrinsics of each camera, and tracks outside of the picture."""
    for name, camera in rig.cameras.items():
        tracks, images = recording.tracks.get(name), recording.images.get(name)
        stream = tracks if tracks is not None else images
        if stream is None:
            continue
        known = (camera.width_px, camera.height_px)
        info = stream.camera_info if tracks is None else tracks.camera_info
        if info is not None:
            yield from _size(name, stream.topic, "camera_info", (info.width, info.height), known)
            if isinstance(camera, PinholeCamera | FisheyeCamera):
                yield from _lens(name, stream.topic, info, camera)
        if images is not None and len(images):
            try:
                image = images.image(0)
            except RecordingError:
                continue
            yield from _size(name, images.topic, "its first picture", (image.shape[1], image.shape[0]), known)
        if tracks is not None and not (isinstance(camera, OrthographicCamera) and camera.origin_id is not None):
            seen = tracks.uv[np.isfinite(tracks.uv).all(axis=-1)]
            outside = ((seen < -0.5) | (seen > np.array(known) - 0.5)).any(axis=1)
            if len(seen) and outside.mean() > OBSERVATIONS.outside_picture_share:
                reach = ", ".join(
                    f"{a:.4g} to {b:.4g}" for a, b in zip(seen.min(axis=0), seen.max(axis=0), strict=True)
                )
                yield Finding(
                    "tracks_outside",
                    tracks.topic,
                    "warning",
                    f"{100 * outside.mean():.0f} % of the tracks of {name} are outside of its picture of {known[0]} x "
                    f"{known[1]} px: they reach over {reach} px (more than "
                    f"{100 * OBSERVATIONS.outside_picture_share:g} %).",
                    "Give width_px, height_px and intrinsics of the picture in which they were tracked.",
                    values=(float(outside.mean()),),
                    bound=OBSERVATIONS.outside_picture_share,
                    part=name,
                )


def _size(name: str, topic: str, source: str, size: tuple[int, int], known: tuple[int, int]) -> Iterator[Finding]:
    if not all(size) or size == known:
        return
    yield Finding(
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


def _lens(name: str, topic: str, info: CameraInfo, camera: PinholeCamera | FisheyeCamera) -> Iterator[Finding]:
    model = MODELS[info.model]
    if model != camera.model and np.any(info.D):
        yield Finding(
            "camera_model",
            topic,
            "stops a fit",
            f"camera_info says that {name} is a {model} camera ({info.model}), the rig a {camera.model} one.",
            f"Write `model: {model}` and its distortion into the rig.",
            part=name,
        )
        return
    for word, found, known in (("fx", info.K[0, 0], camera.fx_px), ("fy", info.K[1, 1], camera.fy_px)):
        off = abs(found / known - 1.0)
        if off > max(OBSERVATIONS.camera_apart_sd * camera.scale_sd, 1e-3):
            yield Finding(
                "focal_length",
                topic,
                "stops a fit" if off > OBSERVATIONS.camera_focal_difference else "warning",
                f"camera_info gives {word} = {found:.5g} px for {name}, the rig {known:.5g} px, {100 * off:.2g} % "
                f"apart (more than {100 * OBSERVATIONS.camera_apart_sd * camera.scale_sd:.2g} %).",
                "Write the calibrated focal length into the rig.",
                values=(float(found),),
                bound=known,
                part=name,
            )
            break
    centre = np.array([info.K[0, 2], info.K[1, 2]])
    known_centre = np.array([camera.cx_px, camera.cy_px])
    if np.abs(centre - known_centre).max() > max(OBSERVATIONS.camera_apart_sd * camera.centre_sd_px, 1.0):
        yield Finding(
            "principal_point",
            topic,
            "warning",
            f"camera_info puts the principal point of {name} at ({centre[0]:.5g}, {centre[1]:.5g}) px, the rig at "
            f"({known_centre[0]:.5g}, {known_centre[1]:.5g}) px.",
            "Write the calibrated principal point of the picture that was recorded into the rig.",
            values=(float(centre[0]), float(centre[1])),
            bound=OBSERVATIONS.camera_apart_sd * camera.centre_sd_px,
            part=name,
        )
