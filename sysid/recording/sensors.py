"""Wrench, camera and image topics to streams."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sim_core.errors import RecordingError
from sysid.recording.bag import MessageSet
from sysid.recording.images import ImageStream
from sysid.recording.message_types import CAMERA_INFO
from sysid.recording.messages import Series, read_table
from sysid.recording.notes import Notes
from sysid.recording.streams import CameraInfo, WrenchStream
from sysid.recording.times import note_gaps
from sysid.recording.topics import SensorTopic

_ORTHONORMAL = 1e-3
"""Difference of R times its transpose from the identity, of round-off in files of calibrations."""

_COMPONENTS = tuple(f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz")

LARGEST_N = 1e4
"""Forces beyond this are worth a remark."""

TRIED = 5
"""Images that are tried; where none of them can be decoded the topic is of no use."""

_FIELDS = ("K", "D", "model", "width", "height", "R", "P", "binning", "roi")
"""Fields of a calibration that stay the same over a recording."""
_COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8,), "equidistant": (4,)}


def wrench_content(message: Any) -> tuple[float, ...]:
    """Return force and torque of a WrenchStamped or a Wrench, shape (6,)."""
    wrench = getattr(message, "wrench", message)
    f, m = wrench.force, wrench.torque
    return (f.x, f.y, f.z, m.x, m.y, m.z)


def wrench_stream(series: Series, declared: SensorTopic, t0_ns: int, notes: Notes) -> WrenchStream:
    """Mask what is not finite and put torques into newton metres.

    Raises:
        RecordingError: no component is ever finite.
    """
    topic, t = series.topic, series.seconds(t0_ns)
    values = np.array(series.rows, dtype=np.float64)
    mask = np.isfinite(values)
    if not mask.any():
        raise RecordingError(f"{topic}: every wrench holds only NaN or infinity.", "Check the force sensor.")
    values = np.where(mask, values, np.nan)
    never = ~mask.any(axis=0)
    if never.any():
        notes.info(topic, f"never measured: {', '.join(np.array(_COMPONENTS)[never])}")
    lacking = ~(mask | never).all(axis=1)
    if lacking.any():
        notes.count("warning", topic, "message", "with NaN or infinite components, masked", t[lacking])
    if declared.length_unit == "mm":
        notes.info(topic, "torques scaled from N mm to N m, as declared")
        values[:, 3:] *= 1e-3
    largest = float(np.nanmax(np.abs(np.where(mask, values, 0.0))[:, :3]))
    if largest > LARGEST_N:
        notes.info(topic, f"forces up to {largest:.4g} N: look whether they are in newtons")
    note_gaps(topic, t, notes)
    return WrenchStream(
        topic=topic,
        frame_id=series.frame_id,
        t=t,
        arrival=series.arrival(t0_ns),
        force=values[:, :3],
        torque=values[:, 3:],
        mask=mask,
    )


def read_camera_info(topic: str, source: MessageSet, notes: Notes) -> CameraInfo | None:
    """Read a camera's calibration; None when it states none (K = 0).

    Raises:
        RecordingError: the calibration changes, or its distortion model is not known.
    """
    table = read_table(topic, CAMERA_INFO, source, _camera_info, notes)
    first: CameraInfo = table.rows[0]
    if not np.any(first.K):
        notes.info(topic, "K is zero: the camera is not calibrated")
        return None
    for k, other in enumerate(table.rows[1:], start=1):
        changed = [name for name in _FIELDS if not _same(getattr(other, name), getattr(first, name))]
        if changed:
            raise RecordingError(
                f"{topic}: the calibration changes during the recording: {', '.join(changed)} at message {k + 1} of "
                f"{len(table.rows)}.",
                "Cut the recording where it changes, or record the right camera_info only.",
            )
    if not np.isfinite(first.K).all() or first.K[0, 0] <= 0.0 or first.K[1, 1] <= 0.0:
        raise RecordingError(
            f"{topic}: focal lengths {first.K[0, 0]:g} and {first.K[1, 1]:g} px.", "Calibrate the camera."
        )
    x, y, width, height = first.roi
    if first.width and first.height and (x + width > first.width or y + height > first.height):
        raise RecordingError(
            f"{topic}: roi of {width} x {height} px from column {x} and row {y} on is not within the {first.width} x "
            f"{first.height} px of the camera.",
            "REP 104 counts roi in pixels of the whole sensor at full resolution: record it so.",
        )
    if first.R.any() and not np.allclose(first.R @ first.R.T, np.eye(3), atol=_ORTHONORMAL):
        notes.warning(topic, "R is no rotation: not used")
    if first.P.any() and not np.isfinite(first.P).all():
        notes.warning(topic, "P is not finite: not used")
        first = replace(first, P=np.zeros((3, 4)))
    if first.model not in _COEFFICIENTS and (first.model or np.any(first.D)):
        raise RecordingError(
            f"{topic}: distortion model {first.model!r} is not known.",
            f"Use one of: {', '.join(_COEFFICIENTS)}.",
        )
    if len(first.D) and len(first.D) not in _COEFFICIENTS.get(first.model, (len(first.D),)):
        raise RecordingError(
            f"{topic}: {len(first.D)} distortion coefficients for {first.model}.",
            f"{first.model} has {' or '.join(str(n) for n in _COEFFICIENTS[first.model])}.",
        )
    return first


def _same(one: Any, other: Any) -> bool:
    return np.array_equal(one, other, equal_nan=True) if isinstance(one, np.ndarray) else bool(one == other)


def image_stream(series: Series, msgtype: str, camera: CameraInfo | None, t0_ns: int, notes: Notes) -> ImageStream:
    """Keep where the images are; of the pixels some are read, as a check.

    Raises:
        RecordingError: none of them can be decoded.
    """
    t = series.seconds(t0_ns)
    note_gaps(series.topic, t, notes)
    stream = ImageStream(
        topic=series.topic,
        frame_id=series.frame_id,
        t=t,
        arrival=series.arrival(t0_ns),
        msgtype=msgtype,
        source=series.source,
        camera_info=camera,
    )
    some = np.unique(np.linspace(0, len(t) - 1, min(TRIED, len(t))).astype(int))
    tried = [image for _, image in stream.take(some).decoded()]
    if tried and all(isinstance(image, RecordingError) for image in tried):
        assert isinstance(tried[0], RecordingError)
        raise tried[0]
    return stream


def _camera_info(message: Any) -> CameraInfo:
    roi = message.roi
    return CameraInfo(
        K=np.array(message.k, dtype=np.float64).reshape(3, 3),
        D=np.array(message.d, dtype=np.float64),
        model=str(message.distortion_model),
        width=int(message.width),
        height=int(message.height),
        frame_id=str(message.header.frame_id),
        R=np.array(message.r, dtype=np.float64).reshape(3, 3),
        P=np.array(message.p, dtype=np.float64).reshape(3, 4),
        binning=(max(1, int(message.binning_x)), max(1, int(message.binning_y))),
        roi=(int(roi.x_offset), int(roi.y_offset), int(roi.width), int(roi.height)),
    )
