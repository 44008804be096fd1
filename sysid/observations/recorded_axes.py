"""What a recording holds, in the units and axes of the rig, where the rig says that it was recorded in others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import MarkerSensor, Rig, WrenchSensor
from sim_core.rigs.observers import NEWTONS
from sysid.recording import Recording
from sysid.recording.streams import PoseStream


def matrix_of(axes: Sequence[str], names: str = "xyz") -> np.ndarray:
    """The signed permutation ``(n, n)`` M of recorded components M v of true ones v."""
    matrix = np.zeros((len(axes), len(axes)))
    for row, axis in enumerate(axes):
        matrix[row, names.index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return matrix


def in_rig_axes(rig: Rig, recording: Recording) -> Recording:
    """The recording with poses of the end effectors themselves in the base frame, and readings in newtons along the
    axes of their sensors and pictures."""
    wrenches, markers, tracks = dict(recording.wrenches), dict(recording.markers), dict(recording.tracks)
    for name, sensor in rig.sensors.items():
        if isinstance(sensor, WrenchSensor) and name in wrenches:
            w, newtons = wrenches[name], NEWTONS[sensor.force_unit]
            force, torque = (matrix_of(axes) for axes in (sensor.force_axes, sensor.torque_axes))
            if newtons == 1.0 and np.array_equal(force, np.eye(3)) and np.array_equal(torque, np.eye(3)):
                continue
            turned = np.hstack([_turned(newtons * w.force, force), _turned(newtons * w.torque, torque)])
            wrenches[name] = replace(w, force=turned[:, :3], torque=turned[:, 3:], mask=np.isfinite(turned))
        elif isinstance(sensor, MarkerSensor) and name in markers and sensor.axes != ("x", "y", "z"):
            m, axes = markers[name], matrix_of(sensor.axes)
            position, displacement, pull = (
                None if v is None else _turned(v, axes) for v in (m.position, m.displacement, m.force)
            )
            assert position is not None
            markers[name] = replace(m, position=position, displacement=displacement, force=pull)
    for name, camera in rig.cameras.items():
        if name in tracks and camera.picture_axes != ("u", "v"):
            plane = matrix_of(camera.picture_axes, "uv")
            middle = 0.5 * (np.array([camera.width_px, camera.height_px]) - 1.0)
            recorded = np.abs(plane) @ middle
            tracks[name] = replace(tracks[name], uv=_turned(tracks[name].uv - recorded, plane) + middle)
    poses = {name: _of_effector(rig, name, stream) for name, stream in recording.poses.items()}
    targets = {name: _of_effector(rig, name, stream) for name, stream in recording.target_poses.items()}
    return replace(recording, poses=poses, target_poses=targets, wrenches=wrenches, markers=markers, tracks=tracks)


def _turned(values: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """True vectors ``(..., n)`` of recorded ones; a component that is missing makes only those missing that it is."""
    source = np.argmax(np.abs(matrix), axis=0)
    return np.asarray(values[..., source] * matrix[source, np.arange(len(matrix))])


def _of_effector(rig: Rig, name: str, stream: PoseStream) -> PoseStream:
    """Poses base * P * tool."""
    if name not in rig.end_effectors:
        return stream
    topics = rig.end_effectors[name].topics
    if topics.axes == ("x", "y", "z") and not any(np.any(p.matrix() != np.eye(4)) for p in (topics.base, topics.tool)):
        return stream
    position, rotation = _turned(stream.position, matrix_of(topics.axes)), Rotation.from_quat(stream.quaternion)
    position = topics.base.rotation().apply(position) + topics.base.position()
    rotation = topics.base.rotation() * rotation
    position = position + rotation.apply(topics.tool.position())
    quaternion = (rotation * topics.tool.rotation()).as_quat()
    flips = np.where(np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0, -1.0, 1.0)
    quaternion = quaternion * np.cumprod(np.concatenate([[1.0], flips]))[:, None]
    return replace(stream, position=position, quaternion=quaternion)
