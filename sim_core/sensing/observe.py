"""Readings of all sensors and cameras at one instant, without noise, rate or delay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.contact.rigid import RigidContact
from sim_core.geometry import sheets, solids
from sim_core.rigs import MarkerSensor, Pose, Rig, Rigid, WrenchSensor, marker_positions, seen_points
from sim_core.scene.scene import Frame, Scene
from sim_core.sensing.camera import project


@dataclass(frozen=True)
class _Tracked:
    """Material points as weights on nodes, ``(n, k)`` each."""

    nodes: np.ndarray
    weights: np.ndarray

    def positions(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("nk,nkj->nj", self.weights, x[self.nodes]))


def _within(frame: Frame, pose: Pose) -> Frame:
    origin, rotation = frame
    return origin + rotation.apply(pose.position()), rotation * pose.rotation()


class Observer:
    """Sensors and cameras of a scene. ``kinds``: channel name to 'wrench', 'markers' or 'tracks'."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.kinds: dict[str, str] = {}
        self.ids: dict[str, np.ndarray] = {}
        self._tracked: dict[str, list[_Tracked]] = {}
        rig = scene.rig
        for name, sensor in rig.sensors.items():
            if isinstance(sensor, WrenchSensor):
                self.kinds[name] = "wrench"
            else:
                self.kinds[name] = "markers"
                local, ids = marker_positions(sensor.points, rig.bodies[sensor.body])
                self._tracked[name] = [self._locate(sensor.body, local)]
                self.ids[name] = ids
        bodies = {n: b for n, b in rig.bodies.items() if not isinstance(b, Rigid)}
        for name, camera in rig.cameras.items():
            self.kinds[name] = "tracks"
            seen = seen_points(camera.sees, bodies)
            self._tracked[name] = [self._locate(body, local) for body, local, _ in seen]
            self.ids[name] = np.concatenate([ids for _, _, ids in seen])

    def _locate(self, body: str, local: np.ndarray) -> _Tracked:
        built = self._scene.bodies[body]
        if isinstance(built.mesh, sheets.SheetMesh):
            element, weights = sheets.locate(built.mesh, local)
            nodes = built.mesh.triangles[element]
        else:
            assert isinstance(built.mesh, solids.TetMesh)
            element, weights = solids.locate(built.mesh, local)
            nodes = built.mesh.tets[element]
        return _Tracked(nodes + int(built.nodes[0]), weights)

    def read(self, rig: Rig, frames: Mapping[str, Frame]) -> dict[str, np.ndarray]:
        """Readings at the positions that the scene's system holds.

        ``rig``: same geometry as the scene's (intrinsics may differ); ``frames``: of the mounts now.
        Wrench: force [N] and torque [N m] on the sensor, ``(6,)``; markers [m] ``(n, 3)`` in the
        sensor's frame; tracks [px] ``(n, 2)``.
        """
        x = self._scene.system.x
        forces: np.ndarray | None = None
        out: dict[str, np.ndarray] = {}
        for name, sensor in rig.sensors.items():
            if isinstance(sensor, WrenchSensor):
                if forces is None:
                    forces = -self._scene.system.static_gradient()
                out[name] = self._wrench(sensor, frames, forces)
            elif isinstance(sensor, MarkerSensor):
                origin, rotation = _within(self._scene.body_frame(sensor.body, frames), sensor.pose)
                out[name] = rotation.inv().apply(self._tracked[name][0].positions(x) - origin)
        for name, camera in rig.cameras.items():
            origin, rotation = _within(frames[camera.mount], camera.pose)
            points = np.vstack([t.positions(x) for t in self._tracked[name]])
            out[name] = project(camera, rotation.inv().apply(points - origin))
        return out

    def _wrench(self, sensor: WrenchSensor, frames: Mapping[str, Frame], forces: np.ndarray) -> np.ndarray:
        """Sum of what the terms do to the nodes that the sensor holds, about its frame's origin."""
        scene = self._scene
        if sensor.on in scene.rig.end_effectors:
            nodes, frame = scene.carried(sensor.on), frames[sensor.on]
        elif sensor.on in scene.bodies:
            body = scene.bodies[sensor.on]
            held = scene.held(sensor.on) if body.mesh is not None else np.ones(1, dtype=bool)
            nodes, frame = body.nodes[held], scene.body_frame(sensor.on, frames)
        else:
            nodes = scene.holders[sensor.on]
            clamp = next(c for c in scene.rig.clamps if c.name == sensor.on)
            frame = frames[clamp.mount]
        origin, rotation = _within(frame, sensor.pose)
        force = forces[nodes].sum(axis=0)
        torque = np.cross(scene.system.x[nodes] - origin, forces[nodes]).sum(axis=0)
        for term in scene.system.terms:
            if isinstance(term, RigidContact) and np.isin(term.body_node, nodes):
                at, push = term.sample_forces()
                body_at = scene.system.x[term.body_node]
                torque -= np.cross(at - body_at, push).sum(axis=0)
        return np.concatenate([rotation.inv().apply(force), rotation.inv().apply(torque)])


def frame_of(position: np.ndarray, quaternion: np.ndarray) -> Frame:
    """Frame from a position [m] and a quaternion x y z w."""
    return np.asarray(position, dtype=float), Rotation.from_quat(quaternion)
