"""Pose topics to pose streams: units, frames, orientation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sim_core.errors import RecordingError
from sysid.recording.arrays import Floats
from sysid.recording.messages import Series
from sysid.recording.notes import Notes, plural
from sysid.recording.streams import PoseStream
from sysid.recording.times import note_gaps
from sysid.recording.topics import EETopics

FARTHEST_M = 20.0
"""No end effector is farther from its base frame than this."""

WIDEST_M = 3.0
"""No end effector of a table-top rig moves over more than this."""

FASTEST_M_S = 3.0
"""Speeds beyond this are worth a remark."""

_UNIT_TOLERANCE = 1e-9
_ZERO_QUATERNION = 1e-3
_HALF_TURN_X = 0.99
_JUMP_M_S, _JUMP_M = 2.0, 0.01
_JUMP_RAD_S, _JUMP_RAD = 10.0, 0.2


def pose_content(message: Any) -> tuple[float, ...]:
    """Return position and orientation of any message that holds one pose, shape (7,), and behind them the six variances
    of one that states them.

    Raises:
        ValueError: a number is not finite, or the orientation is zero.
    """
    if hasattr(message, "transform"):
        p, q = message.transform.translation, message.transform.rotation
    else:
        pose = getattr(message, "pose", message)
        pose = getattr(pose, "pose", pose)
        p, q = pose.position, pose.orientation
    values = (p.x, p.y, p.z, q.x, q.y, q.z, q.w)
    if not all(map(math.isfinite, values)):
        raise ValueError("holds NaN or infinity")
    if math.hypot(*values[3:]) < _ZERO_QUATERNION:
        raise ValueError("has an orientation of zero (the identity is x=0, y=0, z=0, w=1)")
    covariance = getattr(getattr(message, "pose", None), "covariance", None)
    return values if covariance is None else (*values, *np.diag(np.reshape(covariance, (6, 6))).tolist())


def pose_stream(series: Series, declared: EETopics, t0_ns: int, notes: Notes) -> PoseStream:
    """Check the poses of one topic and put them into metres and x y z w.

    Raises:
        RecordingError: units or orientation cannot be trusted without a declaration.
    """
    topic, t = series.topic, series.seconds(t0_ns)
    values = np.array(series.rows, dtype=np.float64)
    position = _metres(topic, t, values[:, :3], declared, notes)
    quaternion = _unit_quaternions(topic, values[:, 3:7], declared, notes)
    _note_jumps(topic, t, position, notes)
    _note_turns(topic, t, quaternion, notes)
    note_gaps(topic, t, notes)
    return PoseStream(
        topic=topic,
        frame_id=series.frame_id,
        t=t,
        arrival=series.arrival(t0_ns),
        position=position,
        quaternion=quaternion,
        stated_sd=_stated_sd(values[:, 7:], declared),
    )


def _stated_sd(variances: Floats, declared: EETopics) -> tuple[float, float] | None:
    """Usual standard deviations of position [m] and orientation [rad] that messages state; None where they state none
    (variances of zero, below zero or not finite)."""
    stated = np.isfinite(variances).all(axis=1) & (variances > 0.0).all(axis=1) if variances.shape[1] else np.zeros(0)
    if not stated.any():
        return None
    sd = np.sqrt(np.median(variances[stated], axis=0))
    return float(sd[:3].max()) * (1e-3 if declared.length_unit == "mm" else 1.0), float(sd[3:].max())


def check_pair(measured: PoseStream, commanded: PoseStream, declared: EETopics, notes: Notes) -> None:
    """Compare the measured and the commanded pose of one end effector.

    Raises:
        RecordingError: they agree only if one of them is w-first.
    """
    if measured.frame_id != commanded.frame_id:
        notes.warning(
            commanded.topic,
            f"in frame {commanded.frame_id!r} while {measured.topic} is in {measured.frame_id!r}",
        )
        return
    a, b = measured.quaternion[0], commanded.quaternion[0]
    if declared.quaternion_order is not None or _angle(a, b) < np.radians(60.0):
        return
    for stream, other in ((measured, b), (commanded, a)):
        mine = stream.quaternion[0]
        if _angle(np.roll(mine, -1), other) < np.radians(10.0):
            raise RecordingError(
                f"{stream.topic}: the first orientation {_show(mine)} agrees with the other pose of this end "
                "effector only when read as w x y z.",
                "Rewrite that topic as x y z w, or leave it out; if both are right, declare "
                "`quaternion_order: xyzw` for this end effector.",
            )
    degrees = float(np.degrees(_angle(a, b)))
    notes.warning(commanded.topic, f"starts {degrees:.0f} degrees away from {measured.topic}")


def _metres(topic: str, t: Floats, position: Floats, declared: EETopics, notes: Notes) -> Floats:
    if declared.length_unit == "mm":
        notes.info(topic, "positions scaled from mm to m, as declared")
        return position * 1e-3
    if declared.length_unit is None:
        smooth = position
        if len(t) > 2:  # a single wild sample is a jump, not a matter of units
            smooth = np.median([position[:-2], position[1:-1], position[2:]], axis=0)
        farthest = float(np.linalg.norm(smooth, axis=1).max())
        widest = float(np.ptp(smooth, axis=0).max())
        if farthest > FARTHEST_M or widest > WIDEST_M:
            raise RecordingError(
                f"{topic}: positions reach {farthest:.4g} m from the frame's origin and span {widest:.4g} m "
                f"(plausible: {FARTHEST_M:g} m and {WIDEST_M:g} m); they look like millimetres.",
                "Write `length_unit: mm` under `topics` of this end effector in the rig, or `length_unit: m` if metres "
                "are right.",
            )
        if len(t) > 2:
            speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / np.diff(t)
            moving = speed[speed > 0.0]
            if len(moving) and float(np.median(moving)) > FASTEST_M_S:
                notes.warning(
                    topic,
                    f"usual speed {float(np.median(moving)):.3g} m/s: looks like millimetres or wrong stamps",
                )
    return position


def _unit_quaternions(topic: str, raw: Floats, declared: EETopics, notes: Notes) -> Floats:
    norm = np.linalg.norm(raw, axis=1)
    quaternion = raw
    off = np.abs(norm - 1.0)
    if float(off.max()) > _UNIT_TOLERANCE:
        quaternion = raw / norm[:, None]
        if float(off.max()) > 1e-6:
            notes.warning(
                topic,
                f"quaternions normalised (norms from {float(norm.min()):.6g} to {float(norm.max()):.6g})",
            )
    if declared.quaternion_order == "wxyz":
        notes.info(topic, "quaternions reordered from w x y z, as declared")
        quaternion = np.roll(quaternion, -1, axis=1)
    elif declared.quaternion_order is None:
        _refuse_w_first(topic, quaternion, notes)
    signs = np.sign(np.sum(quaternion[1:] * quaternion[:-1], axis=1))
    signs[signs == 0.0] = 1.0
    if (signs < 0.0).any():
        notes.info(topic, f"{plural(int((signs < 0.0).sum()), 'sign flip')} of the quaternion removed")
        quaternion = quaternion * np.concatenate(([1.0], np.cumprod(signs)))[:, None]
    return quaternion


def _refuse_w_first(topic: str, quaternion: Floats, notes: Notes) -> None:
    """Refuse what a w-first identity looks like.

    Angles between samples are the same in either order, so only the value itself can tell: a first
    quaternion of (1, 0, 0, 0) is either a half turn about x or a w-first identity.
    """
    first = quaternion[0]
    if abs(abs(first[0]) - 1.0) < _UNIT_TOLERANCE and not first[1:].any():
        raise RecordingError(
            f"{topic}: the first orientation is x y z w = {_show(first)}, a half turn about x, which is also "
            "what the identity looks like when written w x y z.",
            "Write `quaternion_order: wxyz` under `topics` of this end effector in the rig, or "
            "`quaternion_order: xyzw` if the half turn is right.",
        )
    if abs(first[0]) > _HALF_TURN_X:
        notes.warning(
            topic,
            f"starts near a half turn about x ({_show(first)}); if it should start near the identity, the "
            "quaternions are w-first: write `quaternion_order: wxyz` under `topics` of the end effector",
        )


def _note_jumps(topic: str, t: Floats, position: Floats, notes: Notes) -> None:
    if len(t) < 3:
        return
    step = np.linalg.norm(np.diff(position, axis=0), axis=1)
    jump = (step > _JUMP_M) & (step > _JUMP_M_S * np.diff(t)) & (step > 20.0 * np.median(step))
    if jump.any():
        k = int(np.argmax(np.where(jump, step, 0.0)))
        count = int(jump.sum())
        notes.warning(
            topic,
            f"{plural(count, 'jump')} of the position, the largest {step[k]:.4g} m within "
            f"{t[k + 1] - t[k]:.4g} s at t={t[k]:.4g} s; kept as recorded",
        )


def _note_turns(topic: str, t: Floats, quaternion: Floats, notes: Notes) -> None:
    if len(t) < 3:
        return
    step = 2.0 * np.arccos(np.minimum(1.0, np.abs(np.sum(quaternion[1:] * quaternion[:-1], axis=1))))
    jump = (step > _JUMP_RAD) & (step > _JUMP_RAD_S * np.diff(t)) & (step > 20.0 * np.median(step))
    if jump.any():
        k = int(np.argmax(np.where(jump, step, 0.0)))
        notes.warning(
            topic,
            f"{plural(int(jump.sum()), 'jump')} of the orientation, the largest {np.degrees(step[k]):.3g} degrees "
            f"within {t[k + 1] - t[k]:.4g} s at t={t[k]:.4g} s; kept as recorded",
        )


def _angle(a: Floats, b: Floats) -> float:
    """Angle of the rotation between two unit quaternions [rad]."""
    return 2.0 * float(np.arccos(min(1.0, abs(float(a @ b)))))


def _show(quaternion: Floats) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in quaternion) + ")"
