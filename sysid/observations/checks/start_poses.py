"""First poses of a recording against where the rig starts: units, order of quaternions, another start."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig
from sysid.observations.checks.finding import Finding
from sysid.recording import Recording
from sysid.recording.streams import PoseStream
from sysid.settings.observations import OBSERVATIONS

UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
"""Lengths [m] that positions may be in instead of metres."""


def start_poses(recording: Recording, rig: Rig) -> Iterator[Finding]:
    """Positions in another unit, quaternions in another order or inverted, and starts far from that of the rig."""
    for name, effector in rig.end_effectors.items():
        stream = recording.poses.get(name)
        if stream is None or not len(stream):
            continue
        start, turn = np.array(effector.start.position_m), effector.start.rotation()
        yield from _position(name, stream, start, effector.topics.length_unit is not None)
        yield from _orientation(name, stream, turn, effector.topics.quaternion_order is not None)
        yield from _degrees(name, stream)


def _position(name: str, stream: PoseStream, start: np.ndarray, declared: bool) -> Iterator[Finding]:
    first = np.median(stream.position[:5], axis=0)
    off = float(np.linalg.norm(first - start))
    size = float(np.linalg.norm(start))
    for word, metres in () if declared else UNITS.items():
        as_unit = float(np.linalg.norm(first * metres - start))
        if size > OBSERVATIONS.unit_position_m and as_unit < 0.3 * size and as_unit < 0.05 * off:
            yield Finding(
                "length_unit",
                stream.topic,
                "stops a fit",
                f"{name} begins at {_show(first)} m, {off:.4g} m from its start in the rig at {_show(start)} m; read "
                f"as {word} it begins {as_unit:.2g} m from there.",
                "Write `length_unit: mm` under `topics` of this end effector, or record metres."
                if word == "millimetres"
                else "Record metres.",
                values=(off,),
                bound=size,
                part=name,
            )
            return
    if off > OBSERVATIONS.start_far_m:
        yield Finding(
            "start_position",
            stream.topic,
            "warning",
            f"{name} begins at {_show(first)} m, {off:.3g} m from its start in the rig at {_show(start)} m (more than "
            f"{OBSERVATIONS.start_far_m:g} m).",
            "Look at the frame of the poses and at `start` in the rig.",
            values=(off,),
            bound=OBSERVATIONS.start_far_m,
            part=name,
        )


def _orientation(name: str, stream: PoseStream, start: Rotation, declared: bool) -> Iterator[Finding]:
    q = stream.quaternion[0]
    off = _degrees_between(Rotation.from_quat(q), start)
    if off < OBSERVATIONS.start_far_deg:
        return
    readings = {
        "as w x y z": Rotation.from_quat(np.roll(q, -1)),
        "inverted (as the base seen from the end effector)": Rotation.from_quat(q).inv(),
    }
    for word, rotation in () if declared else readings.items():
        near = _degrees_between(rotation, start)
        if near < OBSERVATIONS.start_near_deg:
            yield Finding(
                "quaternion_order",
                stream.topic,
                "stops a fit",
                f"{name} begins turned by {off:.0f} degrees against its start in the rig; its first quaternion "
                f"{_show(q)} read {word} is {near:.1f} degrees from there.",
                "Write `quaternion_order: wxyz` under `topics` of this end effector in the rig, or `xyzw` if so it is."
                if word.startswith("as w")
                else "Publish the pose of the end effector in the base frame.",
                values=(off,),
                bound=OBSERVATIONS.start_far_deg,
                part=name,
            )
            return
    yield Finding(
        "start_orientation",
        stream.topic,
        "note",
        f"{name} begins turned by {off:.0f} degrees against its start in the rig (more than "
        f"{OBSERVATIONS.start_far_deg:g} degrees).",
        "A motion may begin anywhere; if this one should not, look at the tool frame of the robot and at `start`.",
        values=(off,),
        bound=OBSERVATIONS.start_far_deg,
        part=name,
    )


def _degrees(name: str, stream: PoseStream) -> Iterator[Finding]:
    if len(stream) < 20:
        return
    turns = Rotation.from_quat(stream.quaternion)
    speed = (turns[1:] * turns[:-1].inv()).magnitude() / np.diff(stream.t)
    turning = speed[speed > 1e-3]
    if len(turning) < 10:
        return
    usual = float(np.median(turning))
    if usual > OBSERVATIONS.fast_turn_rad_s:
        yield Finding(
            "angle_unit",
            stream.topic,
            "stops a fit",
            f"{name} turns at {usual:.3g} rad/s as a rule (more than {OBSERVATIONS.fast_turn_rad_s:g} rad/s): angles "
            f"in degrees were taken for radians, with which it would be {usual * np.pi / 180:.2g} rad/s.",
            "Convert the angles to radians before making quaternions.",
            values=(usual,),
            bound=OBSERVATIONS.fast_turn_rad_s,
            part=name,
        )


def _degrees_between(a: Rotation, b: Rotation) -> float:
    return float(np.degrees((a * b.inv()).magnitude()))


def _show(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"
