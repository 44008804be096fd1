"""Discrete mistakes of set-up that are made in sound recordings, in terms of messages, without the tables that the
check has. ``graded_setups.py`` draws them at random and grades what the check says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig
from sysid.recording import Recording


@dataclass(frozen=True)
class MistakenRecording:
    """A mistake that was made: its kind, what findings name it, and the recording."""

    kind: str
    detail: str
    names: tuple[str, ...]
    recording: Recording


Make = Callable[[Rig, Recording, np.random.Generator], MistakenRecording]


def _channel(draw: np.random.Generator, group: dict) -> str:
    return str(draw.choice(sorted(group)))


def _with_wrench(recording: Recording, name: str, force: np.ndarray, torque: np.ndarray) -> Recording:
    w = recording.wrenches[name]
    return replace(
        recording,
        wrenches={**recording.wrenches, name: replace(w, force=w.force @ force.T, torque=w.torque @ torque.T)},
    )


def wrench_sign(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.wrenches)
    which = draw.choice(["both", "force"])
    torque = -np.eye(3) if which == "both" else np.eye(3)
    return MistakenRecording("wrench sign", which, ("wrench reversed", "force reversed"),
                _with_wrench(recording, name, -np.eye(3), torque))  # fmt: skip


def wrench_quarter_turn(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name, axis, angle = _channel(draw, recording.wrenches), str(draw.choice(list("xyz"))), draw.choice([90, -90, 180])
    turn = np.rint(Rotation.from_euler(axis, angle, degrees=True).as_matrix())
    return MistakenRecording(
        "wrench axes turned", f"{axis} {angle}", ("wrench axes turned",), _with_wrench(recording, name, turn, turn)
    )


def wrench_left_handed(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.wrenches)
    flip = np.diag(np.where(np.arange(3) == draw.integers(3), -1.0, 1.0))
    return MistakenRecording("wrench left-handed", str(np.diag(flip)), ("wrench axes left-handed",),
                _with_wrench(recording, name, flip, flip))  # fmt: skip


def wrench_axes_swapped(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.wrenches)
    a, b = draw.choice(3, 2, replace=False)
    order = np.arange(3)
    order[[a, b]] = order[[b, a]]
    return MistakenRecording("wrench axes swapped", str(order), ("wrench axes left-handed",),
                _with_wrench(recording, name, np.eye(3)[order], np.eye(3)[order]))  # fmt: skip


def wrench_mount(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name, axis, angle = _channel(draw, recording.wrenches), str(draw.choice(list("xyz"))), draw.choice([30, -30])
    turn = Rotation.from_euler(axis, angle, degrees=True).as_matrix()
    return MistakenRecording(
        "wrench 30 degrees", f"{axis} {angle}", ("wrench mount turned",), _with_wrench(recording, name, turn, turn)
    )


def force_unit(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.wrenches)
    unit = str(draw.choice(["mN", "gf", "kgf"]))
    factor = {"mN": 1e3, "gf": 1e3 / 9.80665, "kgf": 1.0 / 9.80665}[unit] * np.eye(3)
    return MistakenRecording("force unit", unit, ("force unit", "force_unit", "force_size", "force_noise"),
                _with_wrench(recording, name, factor, factor))  # fmt: skip


def torque_unit(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.wrenches)
    return MistakenRecording("torque unit", "N mm", ("torque unit", "torque_unit"),
                _with_wrench(recording, name, np.eye(3), 1e3 * np.eye(3)))  # fmt: skip


def _with_markers(recording: Recording, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    m = recording.markers[name]
    return replace(recording, markers={**recording.markers, name: replace(m, position=change(m.position))})


def marker_axes(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.markers)
    if draw.random() < 0.5:
        flip = np.diag(np.where(np.arange(3) == draw.integers(3), -1.0, 1.0))
        names = ("marker axes left-handed", "turned", "mirrored", "marker_order")
        return MistakenRecording("marker axes", str(np.diag(flip)), names,
                    _with_markers(recording, name, lambda p: p @ flip.T))  # fmt: skip
    axis, angle = str(draw.choice(list("xyz"))), draw.choice([90, 180, 30])
    turn = Rotation.from_euler(axis, angle, degrees=True).as_matrix()
    return MistakenRecording("marker axes", f"{axis} {angle}",
                ("marker axes turned", "marker mount turned", "turned", "marker_order"),
                _with_markers(recording, name, lambda p: p @ turn.T))  # fmt: skip


def marker_displacements(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.markers)
    return MistakenRecording("displacements", "x for dx", ("displacements for positions", "marker_scale"),
                _with_markers(recording, name, lambda p: p - p[:1]))  # fmt: skip


def picture_flipped(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.tracks)
    camera, tracks = rig.cameras[name], recording.tracks[name]
    how = str(draw.choice(["u", "v", "both", "transposed"]))
    uv = tracks.uv.copy()
    if how in ("u", "both"):
        uv[..., 0] = camera.width_px - 1 - uv[..., 0]
    if how in ("v", "both"):
        uv[..., 1] = camera.height_px - 1 - uv[..., 1]
    if how == "transposed":
        uv = uv[..., ::-1]
    return MistakenRecording("picture flipped", how,
                ("picture mirrored", "picture turned", "mirrored", "turned", "marker_order"),
                replace(recording, tracks={**recording.tracks, name: replace(tracks, uv=uv)}))  # fmt: skip


def camera_mount(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.tracks)
    camera, tracks = rig.cameras[name], recording.tracks[name]
    angle = np.radians(draw.choice([30, -30]))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = np.array([camera.cx_px, camera.cy_px])
    return MistakenRecording("camera 30 degrees", f"{np.degrees(angle):.0f}", ("camera turned", "turned"), replace(
        recording, tracks={**recording.tracks, name: replace(tracks, uv=(tracks.uv - middle) @ turn.T + middle)}
    ))  # fmt: skip


def _with_poses(
    recording: Recording, name: str, change: Callable[[np.ndarray, Rotation], tuple[np.ndarray, Rotation]]
) -> Recording:
    changed = {}
    for group in ("poses", "target_poses"):
        streams = dict(getattr(recording, group))
        if name in streams:
            position, rotation = change(streams[name].position, Rotation.from_quat(streams[name].quaternion))
            streams[name] = replace(streams[name], position=position, quaternion=rotation.as_quat())
        changed[group] = streams
    return replace(recording, **changed)


def flange(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.poses)
    offset = draw.uniform(0.03, 0.25) * np.eye(3)[draw.choice(3, p=[0.15, 0.15, 0.7])] * draw.choice([-1, 1])
    turn = Rotation.from_euler("z", draw.choice([0, 0, 45, -45]), degrees=True)
    return MistakenRecording("flange for tool", f"{np.round(offset, 3)} {turn.magnitude():.2f}",
                ("flange for tool", "tool turned"),
                _with_poses(recording, name, lambda p, r: (p + r.apply(offset), r * turn)))  # fmt: skip


def tool_turned(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name, axis, angle = _channel(draw, recording.poses), str(draw.choice(list("xyz"))), draw.choice([30, -30, 90, 180])
    turn = Rotation.from_euler(axis, angle, degrees=True)
    return MistakenRecording("tool turned", f"{axis} {angle}", ("tool turned", "flange for tool", "quaternion_order"),
                _with_poses(recording, name, lambda p, r: (p, r * turn)))  # fmt: skip


def other_base(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.poses)
    offset = draw.uniform(-0.5, 0.5, 3)
    turn = Rotation.from_euler("z", draw.choice([0, 90, -90, 180, 30]), degrees=True)
    return MistakenRecording("base for base_link", f"{np.round(offset, 2)} {turn.magnitude():.2f}",
                ("base for base_link", "base axes turned"),
                _with_poses(recording, name, lambda p, r: (turn.apply(p) + offset, turn * r)))  # fmt: skip


def base_left_handed(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.poses)
    flip = np.where(np.arange(3) == draw.integers(3), -1.0, 1.0)
    return MistakenRecording("base left-handed", str(flip), ("base axes left-handed",),
                _with_poses(recording, name, lambda p, r: (p * flip, r)))  # fmt: skip


def pose_millimetres(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    name = _channel(draw, recording.poses)
    return MistakenRecording("pose unit", "mm", ("length_unit", "pose unit"),
                _with_poses(recording, name, lambda p, r: (1e3 * p, r)))  # fmt: skip


def fingers(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    one, other = draw.choice(sorted(recording.poses), 2, replace=False)
    poses = dict(recording.poses)
    poses[one], poses[other] = poses[other], poses[one]
    return MistakenRecording("fingers swapped", f"{one} {other}", ("fingers swapped",), replace(recording, poses=poses))


def milliseconds(rig: Rig, recording: Recording, draw: np.random.Generator) -> MistakenRecording:
    def slow(group: dict) -> dict:
        return {name: replace(stream, t=1e3 * stream.t, arrival=None) for name, stream in group.items()}

    return MistakenRecording("time unit", "ms", ("time_unit", "rate"), replace(
        recording, poses=slow(recording.poses), target_poses=slow(recording.target_poses),
        wrenches=slow(recording.wrenches), markers=slow(recording.markers), tracks=slow(recording.tracks),
    ))  # fmt: skip


def makers(recording: Recording) -> list[Make]:
    """What can be done wrong in a recording."""
    found: list[Make] = []
    if recording.wrenches:
        found += [wrench_sign, wrench_quarter_turn, wrench_left_handed, wrench_axes_swapped, wrench_mount, force_unit,
                  torque_unit]  # fmt: skip
    if recording.markers:
        found += [marker_axes, marker_displacements]
    if recording.tracks:
        found += [picture_flipped, camera_mount]
    if recording.poses:
        found += [flange, flange, tool_turned, other_base, base_left_handed, pose_millimetres, milliseconds]
    if len(recording.poses) > 1:
        found += [fingers]
    return found
