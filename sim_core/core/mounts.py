"""Where the mounts of a scene are, as the core takes it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.commands import CommandChain, driven_frames
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Frame, Scene
from sim_core.sensing.observe import frame_of


def mount_row(frames: Mapping[str, Frame]) -> np.ndarray:
    """Origins [m] and rotations of mounts ``(mounts, 12)``."""
    return np.stack([np.r_[origin, rotation.as_matrix().ravel()] for origin, rotation in frames.values()])


def mount_places(scene: Scene, poses: Mapping[str, PoseTrajectory], times: np.ndarray) -> np.ndarray:
    """True origins [m] and rotations of the mounts of a scene along ``poses`` of end effectors, ``(t, mounts, 12)``."""
    mounts, count = list(scene.start), len(times)
    tracks = {name: trajectory.sample(times) for name, trajectory in poses.items()}
    driven = None
    if CommandChain(scene.rig):
        commanded = [{name: frame_of(p[k], q[k]) for name, (p, q) in tracks.items()} for k in range(count)]
        driven = driven_frames(scene.rig, commanded, times)
    out = np.empty((count, len(mounts), 12))
    for m, name in enumerate(mounts):
        if driven is not None and name in driven[0]:
            origin = np.stack([f[name][0] for f in driven])
            turn = Rotation.concatenate([f[name][1] for f in driven])
        elif name in tracks:
            origin, turn = tracks[name][0], Rotation.from_quat(tracks[name][1])
        else:
            origin, turn = np.repeat(scene.start[name][0][None], count, axis=0), scene.start[name][1]
        offset = scene.rig.end_effectors[name].offset() if name in scene.rig.end_effectors else np.zeros(6)
        if offset.any():
            origin, turn = origin + turn.apply(offset[:3]), turn * Rotation.from_rotvec(offset[3:])
        out[:, m, :3] = origin
        out[:, m, 3:] = turn.as_matrix().reshape(-1, 9)
    return out
