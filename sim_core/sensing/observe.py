"""Readings of all sensors and cameras at one instant, without noise, rate or delay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.energies.affine import coordinates
from sim_core.geometry import sheets, solids
from sim_core.geometry.surface_points import locate_near
from sim_core.rigs import (
    WORLD,
    Affine,
    Disc,
    Dome,
    Gel,
    OrthographicCamera,
    Pose,
    Rigid,
    Sheet,
    SheetFile,
    Sight,
    WrenchSensor,
    marker_positions,
    seen_points,
    track_ids,
)
from sim_core.scene.assembly import BuiltBody
from sim_core.scene.scene import Frame, Scene
from sim_core.sensing.camera import Camera, project

ON_FLAT, ON_CURVED = 1e-6, 0.1
"""How far points may lie outside of their element, in its sizes: the facets of a dome are not quite its skin."""


@dataclass(frozen=True)
class Tracked:
    """Material points as weights on nodes, ``(n, k)`` each."""

    nodes: np.ndarray
    weights: np.ndarray

    def positions(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("nk,nkj->nj", self.weights, x[self.nodes]))


Placement = tuple[np.ndarray, np.ndarray]
"""Origin [m] ``(3,)`` and rotation matrix ``(3, 3)`` of a frame."""


def _placement(pose: Pose) -> Placement:
    return pose.position(), pose.rotation().as_matrix()


def _camera_placement(camera: Camera) -> Placement:
    """Where a camera really is in the frame of its mount."""
    origin, rotation = camera.truly(camera.pose.position(), camera.pose.rotation())
    return origin, rotation.as_matrix()


def _within(frame: Placement, placed: Placement) -> Placement:
    """A frame given in another, in the world."""
    return frame[0] + frame[1] @ placed[0], frame[1] @ placed[1]


def taken(camera: Camera, points: np.ndarray, beyond: bool = False) -> np.ndarray:
    """Pixels ``(k, n, 2)`` of points [m] ``(k, n, 3)`` in the frame of a camera's mount at k instants; NaN where out of
    sight, as :func:`sim_core.sensing.camera.project` has it. With an origin as its last row where the camera shows
    one."""
    origin, rotation = _camera_placement(camera)
    pixels = project(camera, (points.reshape(-1, 3) - origin) @ rotation, beyond).reshape(*points.shape[:2], 2)
    if not isinstance(camera, OrthographicCamera) or camera.origin_id is None:
        return pixels
    shown = np.broadcast_to([camera.cx_px, camera.cy_px], (len(points), 1, 2))
    return np.concatenate([pixels, shown], axis=1)


def locate(built: BuiltBody, local: np.ndarray) -> Tracked:
    """Material points of a body, given in its rest coordinates [m] ``(n, 3)``, as weights on nodes of the scene."""
    if isinstance(built.spec, Affine):
        return Tracked(np.tile(built.control, (len(local), 1)), coordinates(built.local[-4:], local))
    if isinstance(built.layout, sheets.SheetMesh):
        curved = isinstance(built.spec, Sheet) and isinstance(built.spec.shape, SheetFile)
        element, weights = (locate_near if curved else sheets.locate)(built.layout, local)
        nodes = built.layout.triangles[element]
    else:
        assert isinstance(built.layout, solids.TetMesh)
        shape = built.spec.shape if isinstance(built.spec, Gel) else None
        if isinstance(shape, Dome):
            # What is in the cavity stands on its wall, along the radius.
            radius = np.linalg.norm(local, axis=1, keepdims=True)
            feet = local * np.maximum(1.0, shape.cavity_radius_m / np.maximum(radius, 1e-300))
            element, weights = solids.locate_pins(built.layout, local, feet, ON_CURVED)
        else:
            element, weights = solids.locate(built.layout, local, ON_CURVED if isinstance(shape, Disc) else ON_FLAT)
        nodes = built.layout.tets[element]
    return Tracked(nodes + int(built.nodes[0]), weights)


class Observer:
    """Sensors and cameras of a scene. ``kinds``: channel name to 'wrench', 'markers' or 'tracks'."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.kinds: dict[str, str] = {}
        self.ids: dict[str, np.ndarray] = {}
        self._tracked: dict[str, list[Tracked]] = {}
        rig = scene.rig
        for name, sensor in rig.sensors.items():
            if isinstance(sensor, WrenchSensor):
                self.kinds[name] = "wrench"
            else:
                self.kinds[name] = "markers"
                carrier = rig.bodies[sensor.body]
                assert not isinstance(carrier, Rigid)
                local, ids = marker_positions(sensor.points, carrier)
                self._tracked[name] = [self._locate(sensor.body, local)]
                self.ids[name] = ids
        bodies = {n: b for n, b in rig.bodies.items() if not isinstance(b, Rigid)}
        self._elsewhere: dict[tuple[str, tuple[Sight, ...]], list[Tracked]] = {}
        for name, camera in rig.cameras.items():
            self.kinds[name] = "tracks"
            seen = seen_points(camera.sees, bodies)
            self._tracked[name] = [self._locate(body, local) for body, local, _ in seen]
            self._elsewhere[name, camera.sees] = self._tracked[name]
            self.ids[name] = track_ids(camera, bodies)
        self._place()

    def _locate(self, body: str, local: np.ndarray) -> Tracked:
        return locate(self._scene.bodies[body], local)

    def _tracked_by(self, name: str, camera: Camera) -> list[Tracked]:
        """What a camera sees that may have its points elsewhere than that of the scene's rig: those of sheets in the
        same triangles, so that readings are smooth in where they are."""
        key = (name, camera.sees)
        if key not in self._elsewhere:
            found = []
            for sight, tracked in zip(camera.sees, self._tracked[name], strict=True):
                body, spec = self._scene.bodies[sight.body], self._scene.rig.bodies[sight.body]
                assert not isinstance(spec, Rigid)
                local, _ = marker_positions(sight.points, spec)
                flat = isinstance(spec, Sheet) and not isinstance(spec.shape, SheetFile)
                if flat and isinstance(body.layout, sheets.SheetMesh) and len(local) == len(tracked.nodes):
                    corners = body.layout.nodes[tracked.nodes - int(body.nodes[0])]
                    found.append(Tracked(tracked.nodes, sheets.weights_in(corners, local[:, :2])))
                else:
                    found.append(self._locate(sight.body, local))
            self._elsewhere[key] = found
        return self._elsewhere[key]

    def _place(self) -> None:
        """Constant placements: of every observer in its carrier, and of every body in its mount."""
        scene, rig = self._scene, self._scene.rig
        self._poses = {n: _placement(o.pose) for n, o in rig.sensors.items()}
        self._body_poses = {n: _placement(b.pose) for n, b in rig.bodies.items()}
        self._mounts = {n: scene.mount_of(n) for n in rig.bodies}
        self._loaded: dict[str, tuple[np.ndarray, str, Placement]] = {}
        for name, sensor in rig.sensors.items():
            if not isinstance(sensor, WrenchSensor):
                continue
            if sensor.on in rig.end_effectors:
                nodes, mount, carrier = scene.carried(sensor.on), sensor.on, _placement(Pose())
            elif sensor.on in scene.bodies and isinstance(rig.bodies[sensor.on], Affine):
                nodes, mount, carrier = scene.bodies[sensor.on].nodes[:-4], WORLD, _placement(Pose())
            elif sensor.on in scene.bodies:
                body = scene.bodies[sensor.on]
                held = scene.held(sensor.on) if body.mesh is not None else np.ones(len(body.nodes), dtype=bool)
                nodes, mount, carrier = body.nodes[held], self._mounts[sensor.on], self._body_poses[sensor.on]
            else:
                mount = next(c.mount for c in rig.clamps if c.name == sensor.on)
                nodes, carrier = scene.holders[sensor.on], _placement(Pose())
            self._loaded[name] = (nodes, mount, _within(carrier, self._poses[name]))

    def free_body(self, name: str) -> BuiltBody | None:
        """The affine body that a wrench sensor is on, if it is on one."""
        sensor = self._scene.rig.sensors[name]
        body = self._scene.bodies.get(sensor.on) if isinstance(sensor, WrenchSensor) else None
        return body if body is not None and isinstance(body.spec, Affine) else None


def frame_of(position: np.ndarray, quaternion: np.ndarray) -> Frame:
    """Frame from a position [m] and a quaternion x y z w."""
    return np.asarray(position, dtype=float), Rotation.from_quat(quaternion)
