"""Readings of all sensors and cameras at one instant, without noise, rate or delay."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.contact.rigid import RigidContact
from sim_core.energies.affine import coordinates
from sim_core.energies.linearised import Blocks, axes_of, skew
from sim_core.energies.linearised import placed as placed_blocks
from sim_core.geometry import sheets, solids
from sim_core.geometry.surface_points import locate_near
from sim_core.rigs import (
    WORLD,
    Affine,
    Disc,
    Dome,
    Gel,
    MarkerSensor,
    OrthographicCamera,
    Pose,
    Rig,
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
from sim_core.sensing.camera import Camera, project, project_slopes
from sim_core.solve.reactions import reactions

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


@dataclass(frozen=True)
class Sensed:
    """Derivatives of the readings of one channel, flattened, ``(r, .)``: by positions ``(3 n)``, by the forces on nodes
    ``(3 n)``, by the moments of rigid bodies' surface forces (:meth:`RigidContact.moment`) ``(3)`` each, and by a small
    motion of the mount in its own frame, translation [m] and turn [rad] ``(6)``. Points out of sight count as seen."""

    by_x: Blocks
    by_force: Blocks | None
    by_moment: dict[str, np.ndarray]
    mount: str
    by_frame: np.ndarray

    def size_bytes(self) -> int:
        """Memory of the derivatives."""
        given = (self.by_x, self.by_force, *self.by_moment.values(), self.by_frame)
        return sum(a.nbytes for a in given if a is not None)


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
        self._rigid = [t for t in scene.system.terms if isinstance(t, RigidContact)]
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

    def read(self, rig: Rig, frames: Mapping[str, Frame]) -> dict[str, np.ndarray]:
        """Readings at the positions that the scene's system holds.

        ``rig``: same geometry as the scene's (cameras and where their points are may differ); ``frames``: of the mounts
        now.
        Wrench: force [N] and torque [N m] on the sensor, ``(6,)``; markers [m] ``(n, 3)`` in the
        sensor's frame; tracks [px] ``(n, 2)``.
        """
        x = self._scene.system.x
        placed = {mount: (origin, rotation.as_matrix()) for mount, (origin, rotation) in frames.items()}
        forces: np.ndarray | None = None
        out: dict[str, np.ndarray] = {}
        for name, sensor in rig.sensors.items():
            if isinstance(sensor, WrenchSensor):
                if forces is None:
                    forces = reactions(self._scene.system)
                nodes, mount, carrier = self._loaded[name]
                frame = _within(placed[mount], carrier)
                if isinstance(rig.bodies.get(sensor.on), Affine):
                    origin, rotation = self._scene.pose_of(sensor.on)
                    frame = _within((origin, rotation.as_matrix()), self._poses[name])
                out[name] = self._wrench(nodes, frame, forces)
            elif isinstance(sensor, MarkerSensor):
                body = _within(placed[self._mounts[sensor.body]], self._body_poses[sensor.body])
                origin, rotation = _within(body, self._poses[name])
                out[name] = (self._tracked[name][0].positions(x) - origin) @ rotation
        return {**out, **self.see(rig, frames)}

    def see(self, rig: Rig, frames: Mapping[str, Frame]) -> dict[str, np.ndarray]:
        """The part of :meth:`read` that cameras see, for which positions suffice."""
        return {name: taken(rig.cameras[name], p[None])[0] for name, p in self.before_cameras(frames, rig).items()}

    def before_cameras(self, frames: Mapping[str, Frame], rig: Rig | None = None) -> dict[str, np.ndarray]:
        """What each camera, of the scene's rig or another one, is to see, in the frame of its mount [m], ``(n, 3)``."""
        x, out = self._scene.system.x, {}
        for name, camera in self._scene.rig.cameras.items():
            origin, rotation = frames[camera.mount]
            seen = self._tracked[name] if rig is None else self._tracked_by(name, rig.cameras[name])
            points = np.vstack([t.positions(x) for t in seen])
            out[name] = (points - origin) @ rotation.as_matrix()
        return out

    def linearise(self, rig: Rig, frames: Mapping[str, Frame], channels: Iterable[str]) -> dict[str, Sensed]:
        """Derivatives of the readings of some channels at the positions that the scene's system holds."""
        system = self._scene.system
        placed = {mount: (origin, rotation.as_matrix()) for mount, (origin, rotation) in frames.items()}
        out = {}
        forces = None
        for name in channels:
            if self.kinds[name] == "wrench":
                if forces is None:
                    forces = reactions(system)
                out[name] = self._wrench_derivatives(name, placed, forces)
            elif self.kinds[name] == "markers":
                sensor = rig.sensors[name]
                assert isinstance(sensor, MarkerSensor)
                mount = self._mounts[sensor.body]
                carrier = _within(self._body_poses[sensor.body], self._poses[name])
                out[name] = self._seen_derivatives(name, mount, placed[mount], carrier, None)
            else:
                camera = rig.cameras[name]
                carrier = _camera_placement(camera)
                out[name] = self._seen_derivatives(name, camera.mount, placed[camera.mount], carrier, camera)
        return out

    def _seen_derivatives(
        self, name: str, mount: str, frame: Placement, carrier: Placement, camera: Camera | None
    ) -> Sensed:
        """Of points seen from a frame in a mount: markers, and tracks of a camera."""
        x = self._scene.system.x
        rotation = frame[1] @ carrier[1]
        blocks, columns, moved = [], [], []
        for tracked in self._tracked[name]:
            points = tracked.positions(x)
            inner = (points - frame[0]) @ frame[1]
            optic = (inner - carrier[0]) @ carrier[1]
            lens = np.broadcast_to(np.eye(3), (len(points), 3, 3)) if camera is None else project_slopes(camera, optic)
            by_point = lens @ rotation.T
            by_inner = lens @ carrier[1].T
            blocks.append((by_point[:, :, None] * tracked.weights[:, None, :, None]).reshape(*by_point.shape[:2], -1))
            columns.append(axes_of(tracked.nodes))
            moved.append(np.concatenate([-by_inner, by_inner @ skew(inner)], axis=-1).reshape(-1, 6))
        height, at, parts = blocks[0].shape[1], 0, []
        for block, column in zip(blocks, columns, strict=True):
            rows = at + np.arange(len(block) * height).reshape(len(block), height)
            parts.append((block, rows, column))
            at += rows.size
        frames = np.vstack(moved)
        if isinstance(camera, OrthographicCamera) and camera.origin_id is not None:
            at, frames = at + height, np.vstack([frames, np.zeros((height, 6))])
        return Sensed(placed_blocks(*parts, shape=(at, x.size)), None, {}, mount, frames)

    def _wrench_derivatives(self, name: str, placed: Mapping[str, Placement], forces: np.ndarray) -> Sensed:
        """Of force and torque on what a sensor carries."""
        x = self._scene.system.x
        nodes, mount, carrier = self._loaded[name]
        origin, rotation = _within(placed[mount], carrier)
        held = forces[nodes]
        arms = x[nodes] - origin
        by_x = np.concatenate([np.zeros((3, 3 * len(nodes))), -rotation.T @ np.hstack(list(skew(held)))])
        by_force = np.concatenate([np.tile(rotation.T, len(nodes)), rotation.T @ np.hstack(list(skew(arms)))])
        turning = np.concatenate([np.zeros((3, 3)), -rotation.T])
        terms = [t for t in self._rigid if t.body_node in nodes]
        force, torque = held.sum(axis=0), _moment(arms, held) - sum(t.moment() for t in terms)
        inner = placed[mount][1]
        local = carrier[1].T @ skew(np.stack([force, torque]) @ inner)
        about = rotation.T @ skew(force[None])[0] @ inner
        by_frame = np.zeros((6, 6))
        by_frame[:3, 3:], by_frame[3:, 3:] = local
        by_frame[3:, :3] += about
        by_frame[3:, 3:] -= about @ skew(carrier[0][None])[0]
        rows, columns = np.arange(6)[None], axes_of(nodes)[None]
        shape = (6, x.size)
        x_part, force_part = (placed_blocks((b[None], rows, columns), shape=shape) for b in (by_x, by_force))
        return Sensed(x_part, force_part, {t.name: turning for t in terms}, mount, by_frame)

    def _wrench(self, nodes: np.ndarray, frame: Placement, forces: np.ndarray) -> np.ndarray:
        """Sum of what the terms do to the nodes that a sensor holds, about its frame's origin."""
        x = self._scene.system.x
        origin, rotation = frame
        held = forces[nodes]
        force = held.sum(axis=0)
        torque = _moment(x[nodes] - origin, held)
        for term in self._rigid:
            if term.body_node in nodes:
                torque = torque - term.moment()
        return np.concatenate([force @ rotation, torque @ rotation])


def _moment(arms: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Sum of arm x force, ``(3,)``; faster than ``np.cross`` for the small arrays here."""
    a = arms.T @ forces
    return np.array([a[1, 2] - a[2, 1], a[2, 0] - a[0, 2], a[0, 1] - a[1, 0]])


def frame_of(position: np.ndarray, quaternion: np.ndarray) -> Frame:
    """Frame from a position [m] and a quaternion x y z w."""
    return np.asarray(position, dtype=float), Rotation.from_quat(quaternion)
