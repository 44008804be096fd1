"""Where everything of a rig stands, without a simulation: bodies meshed at their places, frames of mounts and cameras.

Nothing is assembled here, so that a rig that cannot be simulated (bodies that go through each other, a clamp that holds
no node) can still be looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.effects import amended
from sim_core.rigs import WORLD, Affine, Rig, Sheet
from sim_core.rigs.observers import Camera
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.assembly import BuiltBody, build_body
from sim_core.scene.offset import with_offsets
from sim_core.scene.scene import Frame
from sim_core.sensing.observe import Tracked, locate


@dataclass(frozen=True)
class Layout:
    """``bodies``: meshed, in the order of the rig, nodes numbered as in :class:`sim_core.scene.Scene`; ``start``: true
    frames of the mounts at the start poses."""

    rig: Rig
    bodies: dict[str, BuiltBody]
    start: dict[str, Frame]

    @property
    def rest(self) -> np.ndarray:
        """All nodes at the start, nothing strained [m] ``(N, 3)``."""
        return np.vstack([body.rest for body in self.bodies.values()])

    def mount_of(self, body: str) -> str:
        """The mount in whose frame the pose of a body is given."""
        spec = self.rig.bodies[body]
        return WORLD if isinstance(spec, Sheet | Affine) else spec.mount or WORLD

    def body_frame(self, body: str, frames: Mapping[str, Frame]) -> Frame:
        """Rest frame of a body when the mounts are at ``frames``."""
        return self.rig.bodies[body].pose.within(frames[self.mount_of(body)])

    def camera_frame(self, camera: Camera, frames: Mapping[str, Frame]) -> Frame:
        """Optical frame of a camera, where it truly is."""
        return within(frames[camera.mount], camera.truly(camera.pose.position(), camera.pose.rotation()))

    def carried(self, frames: Mapping[str, Frame]) -> np.ndarray:
        """Where the nodes would be [m] ``(N, 3)`` if every body followed its mount and nothing were strained."""
        parts = []
        for name, body in self.bodies.items():
            (here, turn), (was, turned) = frames[self.mount_of(name)], self.start[self.mount_of(name)]
            parts.append(here + (turn * turned.inv()).apply(body.rest - was))
        return np.vstack(parts)

    def tracked(self, body: str, local: np.ndarray) -> Tracked:
        """Material points of a body, given in its rest coordinates [m] ``(n, 3)``, as weights on nodes."""
        return locate(self.bodies[body], local)

    def frames_along(self, poses: Mapping[str, PoseTrajectory], times: np.ndarray) -> list[dict[str, Frame]]:
        """True frames of all mounts at times [s] when the end effectors follow ``poses``."""
        sampled = {name: trajectory.sample(times) for name, trajectory in poses.items()}
        return [
            {
                **self.start,
                **with_offsets(self.rig, {n: (p[k], Rotation.from_quat(q[k])) for n, (p, q) in sampled.items()}),
            }
            for k in range(len(times))
        ]


def within(frame: Frame, placed: Frame) -> Frame:
    """A frame given in another, in the world."""
    return frame[0] + frame[1].apply(placed[0]), frame[1] * placed[1]


def lay_out(rig: Rig) -> Layout:
    """Mesh all bodies of a rig where they stand at the start, its effects on poses and sizes included."""
    rig = amended(rig)
    nominal: dict[str, Frame] = {WORLD: (np.zeros(3), Rotation.identity())}
    nominal.update({n: (e.start.position(), e.start.rotation()) for n, e in rig.end_effectors.items()})
    start = with_offsets(rig, nominal)
    bodies: dict[str, BuiltBody] = {}
    count = 0
    for name, spec in rig.bodies.items():
        carrier = start[(spec.mount or WORLD) if not isinstance(spec, Sheet | Affine) else WORLD]
        bodies[name] = build_body(rig, name, carrier, count, 1)
        count += len(bodies[name].nodes)
    return Layout(rig, bodies, start)
