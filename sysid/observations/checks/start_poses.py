"""First poses of a recording against where the rig starts: units, order of quaternions, another start.

A recording may begin anywhere within the motion that it shows, since its hand may have been at the rig's start too. One
that begins farther off never was there: its poses may be of another frame.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig
from sysid.observations.checks.finding import Finding
from sysid.observations.checks.rig_size import extent_of
from sysid.recording import Recording
from sysid.recording.streams import PoseStream
from sysid.settings.observations import OBSERVATIONS

UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
"""Lengths [m] that positions may be in instead of metres."""


def reach_of(rig: Rig, name: str, positions: np.ndarray, quaternions: np.ndarray) -> tuple[float, float]:
    """How far [m] and by how much [deg] a hand moves away from where it begins, at least what its mount is off by
    chance; ``positions`` ``(n, 3)`` [m], ``quaternions`` ``(n, 4)``."""
    effector = rig.end_effectors[name]
    turns = Rotation.from_quat(quaternions)
    moves = float(np.linalg.norm(positions - positions[0], axis=1).max())
    turned = float(np.degrees((turns[0].inv() * turns).magnitude().max()))
    chance = OBSERVATIONS.start_chance_sd
    return (
        max(moves, chance * float(np.linalg.norm(effector.offset_sd_m))),
        max(turned, chance * float(np.linalg.norm(effector.offset_sd_deg))),
    )


def start_poses(recording: Recording, rig: Rig) -> Iterator[Finding]:
    """Positions in another unit, quaternions in another order or inverted, and starts far from that of the rig."""
    for name, effector in rig.end_effectors.items():
        stream = recording.poses.get(name)
        if stream is None or not len(stream):
            continue
        start, turn = np.array(effector.start.position_m), effector.start.rotation()
        moves, turns = reach_of(rig, name, stream.position, stream.quaternion)
        yield from _position(rig, name, stream, start, effector.topics.length_unit is not None, moves)
        yield from _orientation(name, stream, turn, effector.topics.quaternion_order is not None, turns)
        yield from _degrees(name, stream)


def _position(
    rig: Rig, name: str, stream: PoseStream, start: np.ndarray, declared: bool, moves: float
) -> Iterator[Finding]:
    first = np.median(stream.position[:5], axis=0)
    off = float(np.linalg.norm(first - start))
    size, extent = float(np.linalg.norm(start)), extent_of(rig)
    near = {word: float(np.linalg.norm(first * metres - start)) for word, metres in UNITS.items()}
    for word, as_unit in () if declared else sorted(near.items(), key=lambda pair: pair[1]):
        at_start = size > OBSERVATIONS.unit_position_m and as_unit < 0.3 * size and as_unit < 0.05 * off
        too_large = min(off, moves) > extent and max(as_unit, moves * UNITS[word]) < extent
        if at_start or too_large:
            yield Finding(
                "length_unit",
                stream.topic,
                "stops a fit",
                f"{name} begins at {_show(first)} m, {off:.4g} m from its start in the rig at {_show(start)} m, and "
                f"moves {moves:.3g} m, where the rig is {extent:.2g} m large; read as {word} it begins {as_unit:.2g} m "
                "from there.",
                "Write `length_unit: mm` under `topics` of this end effector, or record metres."
                if word == "millimetres"
                else "Record metres.",
                values=(off,),
                bound=size,
                part=name,
            )
            return
    if off > moves:
        outside = off > extent
        yield Finding(
            "start_position",
            stream.topic,
            "warning" if outside else "note",
            f"{name} begins at {_show(first)} m, {off:.3g} m from its start in the rig at {_show(start)} m, and moves "
            f"{moves:.3g} m at most from there"
            + (f"; the rig is {extent:.3g} m large." if outside else ": it never is at that start."),
            "A motion may begin anywhere; if this one should not, look at the frame of the poses (`topics.tool`, "
            "`topics.base`) and at `start` in the rig.",
            values=(off,),
            bound=extent if outside else moves,
            part=name,
        )


def _orientation(name: str, stream: PoseStream, start: Rotation, declared: bool, turns: float) -> Iterator[Finding]:
    q = stream.quaternion[0]
    off = _degrees_between(Rotation.from_quat(q), start)
    readings = {
        "as w x y z": Rotation.from_quat(np.roll(q, -1)),
        "inverted (as the base seen from the end effector)": Rotation.from_quat(q).inv(),
    }
    for word, rotation in () if declared or off < OBSERVATIONS.start_far_deg else readings.items():
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
    if off > turns:
        yield Finding(
            "start_orientation",
            stream.topic,
            "note",
            f"{name} begins turned by {off:.3g} degrees against its start in the rig, and turns {turns:.2g} degrees at "
            "most from there: it never is at that start.",
            "A motion may begin anywhere; if this one should not, look at the frame of the poses (`topics.tool`, "
            "`topics.base`) and at `start` in the rig.",
            values=(off,),
            bound=turns,
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
