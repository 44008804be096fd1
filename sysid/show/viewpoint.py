"""From where a rig is looked at, and what the pictures frame."""

from __future__ import annotations

import numpy as np

from sim_core.rigs import Plane, Rigid
from sysid.show.subject import Subject

AZIMUTH_DEG, ELEVATION_DEG = 32.0, 22.0
"""Of the picture, from straight on to the longer side."""

AROUND = 0.12
"""How much of what is rigid is framed beyond all that is not, as a share of their extent."""


def upward(subject: Subject) -> np.ndarray:
    """Against gravity; without gravity, out of a plane; else +z."""
    gravity = np.array(subject.rig.gravity_m_s2)
    if np.linalg.norm(gravity) > 0.0:
        return np.asarray(-gravity / np.linalg.norm(gravity))
    for name, body in subject.rig.bodies.items():
        if isinstance(body, Rigid) and isinstance(body.shape, Plane):
            return np.asarray(subject.layout.body_frame(name, subject.frames[0])[1].apply([0.0, 0.0, 1.0]))
    return np.array([0.0, 0.0, 1.0])


def framed(subject: Subject) -> np.ndarray:
    """Points [m] ``(n, 3)`` that the main picture shows: all that is simulated at all times, where it is to be, and
    what is near of the rest."""
    soft: list[np.ndarray] = list(subject.sought.values())
    hard: list[np.ndarray] = []
    some = np.unique(np.linspace(0, len(subject.times) - 1, 9).round().astype(int))
    for k in some:
        x, frames = subject.states.positions[k], subject.frames[k]
        for skin in subject.skins:
            if skin.kind != "plane":
                (hard if skin.nodes is None else soft).append(skin.vertices(subject.layout, x, frames))
    points = np.vstack(soft or hard or [np.array([[-0.01] * 3, [0.01] * 3])])
    if soft and hard:
        low, high = points.min(axis=0), points.max(axis=0)
        room = AROUND * float((high - low).max())
        near = np.clip(np.vstack(hard), low - room, high + room)
        points = np.vstack([points, near])
    return points


def direction(subject: Subject, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Viewing direction and up, unit vectors: onto the wider side, from where the first fixed camera is if there is
    one."""
    up = upward(subject)
    axes = np.eye(3)[[k for k in range(3) if k != int(np.argmax(np.abs(up)))]]
    depth = axes[int(np.argmin([np.ptp(points @ a) for a in axes]))]
    for camera in subject.rig.cameras.values():
        _, rotation = subject.layout.camera_frame(camera, subject.frames[0])
        looks = float(rotation.apply([0.0, 0.0, 1.0]) @ depth)
        if abs(looks) > 0.2:
            depth = depth * np.sign(looks)
            break
    else:
        depth = depth * (1.0 if depth.sum() > 0.0 else -1.0)
    side = np.cross(depth, up)
    azimuth, elevation = np.deg2rad([AZIMUTH_DEG, ELEVATION_DEG])
    level = np.cos(azimuth) * depth - np.sin(azimuth) * side
    return np.cos(elevation) * level - np.sin(elevation) * up, up
