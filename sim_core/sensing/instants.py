"""Readings of all sensors and cameras at many instants at once, and their derivatives by parameters.

What :class:`sim_core.sensing.observe.Observer`, whose friend this is, reads at one instant, here of a whole rollout:
with the true place o, R of a mount, what stands at y in its frame is seen from there as R^T (p - o), which changes by

    R^T dp - rho - phi x (R^T (p - o))

where the mount moves by rho and turns by phi in its own frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.energies.affine import coordinates
from sim_core.rigs import MarkerSensor, OrthographicCamera, Rig, WrenchSensor
from sim_core.scene.assembly import BuiltBody
from sim_core.sensing.camera import Camera, project_slopes
from sim_core.sensing.observe import Observer, Placement, Tracked, _camera_placement, taken

AT_ONCE = 20000
"""Points whose derivatives in a picture are asked for at once: OpenCV makes a table of 15 columns of them."""


@dataclass(frozen=True)
class Instants:
    """States at t instants. ``places``: origins [m] ``(t, 3)`` and rotations ``(t, 3, 3)`` of the mounts; ``x``: of
    the nodes [m] ``(t, n, 3)``; ``force``: what those that are held bear for their mount [N] ``(t, n, 3)``;
    ``moments``: of the forces of contacts on rigid bodies about their nodes [N m] ``(t, 3)``, by the node."""

    places: Mapping[str, tuple[np.ndarray, np.ndarray]]
    x: np.ndarray
    force: np.ndarray
    moments: list[tuple[int, np.ndarray]]


@dataclass(frozen=True)
class InstantsAlong:
    """Derivatives of :class:`Instants` by p parameters, last axis. ``moved``: motion of the mounts in their own frames,
    translation [m] and turn [rad] ``(t, 6, p)``, others rest; ``force``: of the nodes ``bearing`` ``(t, b, 3, p)``."""

    moved: Mapping[str, np.ndarray]
    x: np.ndarray
    bearing: np.ndarray
    force: np.ndarray
    moments: list[tuple[int, np.ndarray]]


def bearing_nodes(observer: Observer) -> np.ndarray:
    """Nodes of which wrench sensors feel the loads, int ``(b,)``."""
    nodes = [nodes for nodes, _, _ in observer._loaded.values()]
    return np.unique(np.concatenate(nodes)) if nodes else np.empty(0, dtype=int)


def read_all(observer: Observer, rig: Rig, at: Instants) -> dict[str, np.ndarray]:
    """Readings by channel ``(t, ...)``, as of :meth:`Observer.read`."""
    out: dict[str, np.ndarray] = {}
    for name, sensor in rig.sensors.items():
        if isinstance(sensor, WrenchSensor):
            force, torque, (_, rotation) = _load(observer, name, at)
            out[name] = np.concatenate([_into(rotation, force), _into(rotation, torque)], axis=-1)
        elif isinstance(sensor, MarkerSensor):
            origin, rotation = _marker_frame(observer, name, sensor, at)
            points = _positions(observer._tracked[name], at.x)
            out[name] = (points - origin[:, None]) @ rotation
    pictures = before_cameras(observer, rig, at)
    return {**out, **{name: taken(rig.cameras[name], points) for name, points in pictures.items()}}


def before_cameras(observer: Observer, rig: Rig, at: Instants) -> dict[str, np.ndarray]:
    """What the cameras of a rig, that of the scene or another, are to see, in the frames of their mounts [m] ``(t, n,
    3)``."""
    out = {}
    for name, camera in rig.cameras.items():
        origin, rotation = at.places[camera.mount]
        points = _positions(observer._tracked_by(name, camera), at.x)
        out[name] = (points - origin[:, None]) @ rotation
    return out


def differentiate_all(
    observer: Observer, rig: Rig, at: Instants, along: InstantsAlong, readings: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Derivatives of the readings of all channels through the state ``(t, ..., p)``; NaN where a reading is."""
    out = {}
    for name, reading in readings.items():
        kind = observer.kinds[name]
        if kind == "wrench":
            found = _load_along(observer, name, at, along)
        elif kind == "markers":
            sensor = rig.sensors[name]
            assert isinstance(sensor, MarkerSensor)
            mount = observer._mounts[sensor.body]
            carrier = observer._body_poses[sensor.body]
            placed = observer._poses[name]
            found = _seen_along(observer._tracked[name], mount, _compose(carrier, placed), None, at, along)
        else:
            camera = rig.cameras[name]
            tracked = observer._tracked_by(name, camera)
            found = _seen_along(tracked, camera.mount, _camera_placement(camera), camera, at, along)
            if isinstance(camera, OrthographicCamera) and camera.origin_id is not None:
                found = np.concatenate([found, np.zeros_like(found[:, :1])], axis=1)
        found[np.isnan(reading)] = np.nan
        out[name] = found
    return out


def _positions(tracked: list[Tracked], x: np.ndarray) -> np.ndarray:
    """Material points ``(t, n, 3)``, or their derivatives ``(t, n, 3, p)``, from those of nodes."""
    parts = []
    for t in tracked:
        total = sum(
            t.weights[:, k].reshape(1, -1, *[1] * (x.ndim - 2)) * x[:, t.nodes[:, k]] for k in range(t.nodes.shape[1])
        )
        parts.append(np.asarray(total))
    return np.concatenate(parts, axis=1)


def _compose(frame: Placement, placed: Placement) -> Placement:
    return frame[0] + frame[1] @ placed[0], frame[1] @ placed[1]


def _within(place: tuple[np.ndarray, np.ndarray], placed: Placement) -> tuple[np.ndarray, np.ndarray]:
    """A frame that stands in a mount, at all instants."""
    return place[0] + place[1] @ placed[0], place[1] @ placed[1]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of vectors with columns ``(..., 3, p)``."""
    (u, v, w), (x, y, z) = (np.moveaxis(vector, -2, 0) for vector in (a, b))
    return np.stack([v * z - w * y, w * x - u * z, u * y - v * x], axis=-2)


def _into(rotation: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors ``(t, 3)`` in the axes of frames ``(t, 3, 3)``."""
    return np.asarray(np.einsum("tij,ti->tj", rotation, vectors))


def _marker_frame(observer: Observer, name: str, sensor: MarkerSensor, at: Instants) -> tuple[np.ndarray, np.ndarray]:
    body = _within(at.places[observer._mounts[sensor.body]], observer._body_poses[sensor.body])
    return _within(body, observer._poses[name])


def _carrier(
    observer: Observer, name: str, at: Instants
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray], Placement]:
    """Nodes of which a sensor feels the loads, the frames that carry it, of a mount or of a free body, and where it is
    in these."""
    nodes, mount, carrier = observer._loaded[name]
    body = observer.free_body(name)
    if body is None:
        return nodes, at.places[mount], carrier
    origin, slopes = _spanned(body, at.x)
    return nodes, (origin, polar(slopes)[0]), observer._poses[name]


def _carrier_along(observer: Observer, name: str, at: Instants, along: InstantsAlong) -> np.ndarray | None:
    """Motion of these frames, as of mounts; a free body turns by w of (tr U - U) w = skew(R^T dF), with its gradient
    F = R U."""
    body = observer.free_body(name)
    if body is None:
        return along.moved.get(observer._loaded[name][1])
    rotation, stretch = polar(_spanned(body, at.x)[1])
    back, (shift, change) = np.swapaxes(rotation, 1, 2), _spanned(body, along.x)
    turned = np.einsum("tij,tjkp->tikp", back, change)
    twist = np.stack([turned[:, k, j] - turned[:, j, k] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1)
    return np.concatenate([back @ shift, np.linalg.solve(twisting(stretch), twist)], axis=1)


def polar(slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations R and stretches U of gradients F = R U ``(t, 3, 3)``."""
    u, _, v = np.linalg.svd(slopes)
    return u @ v, np.swapaxes(u @ v, 1, 2) @ slopes


def twisting(stretch: np.ndarray) -> np.ndarray:
    """tr U - U of stretches ``(t, 3, 3)``."""
    return np.asarray(np.trace(stretch, axis1=1, axis2=2)[:, None, None] * np.eye(3) - stretch)


def spanning(body: BuiltBody) -> np.ndarray:
    """Weights of the control nodes of an affine body at its origin and at a unit from it along each axis ``(4, 4)``."""
    return coordinates(body.local[-4:], np.vstack([np.zeros(3), np.eye(3)]))


def _spanned(body: BuiltBody, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the origin of an affine body is and its gradient ``(t, 3, 3)``, or derivatives of both, from those of
    nodes."""
    points = np.einsum("kc,tci...->tki...", spanning(body), x[:, body.control])
    return points[:, 0], np.swapaxes(points[:, 1:] - points[:, :1], 1, 2)


def _load(observer: Observer, name: str, at: Instants) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Force and torque on what a sensor carries, in the world ``(t, 3)``, and the sensor's frames."""
    nodes, place, carrier = _carrier(observer, name, at)
    frame = _within(place, carrier)
    held, arms = at.force[:, nodes], at.x[:, nodes] - frame[0][:, None]
    torque = np.cross(arms, held).sum(axis=1)
    for node, moment in at.moments:
        if node in nodes:
            torque = torque - moment
    return held.sum(axis=1), torque, frame


def _load_along(observer: Observer, name: str, at: Instants, along: InstantsAlong) -> np.ndarray:
    """Derivatives of force and torque ``(t, 6, p)`` in the axes of a sensor."""
    nodes, (_, turn), carrier = _carrier(observer, name, at)
    force, torque, (origin, rotation) = _load(observer, name, at)
    held, arms = at.force[:, nodes], at.x[:, nodes] - origin[:, None]
    change = along.force[:, np.searchsorted(along.bearing, nodes)]
    moved = _carrier_along(observer, name, at, along)
    shift = along.x[:, nodes]
    if moved is not None:
        inner = moved[:, :3] + _cross(moved[:, 3:], carrier[0][:, None])
        shift = shift - (turn @ inner)[:, None]
    by_torque = (_cross(arms[..., None], change) + _cross(shift, held[..., None])).sum(axis=1)
    for node, moment in along.moments:
        if node in nodes:
            by_torque = by_torque - moment
    out = np.concatenate([np.swapaxes(rotation, 1, 2) @ by for by in (change.sum(axis=1), by_torque)], axis=1)
    if moved is not None:
        for k, vector in enumerate((force, torque)):
            local = _into(turn, vector)
            out[:, 3 * k : 3 * k + 3] -= carrier[1].T @ _cross(moved[:, 3:], local[..., None])
    return np.asarray(out)


def _seen_along(
    tracked: list[Tracked],
    mount: str,
    carrier: Placement,
    camera: Camera | None,
    at: Instants,
    along: InstantsAlong,
) -> np.ndarray:
    """Derivatives of points seen from a frame that stands in a mount, ``(t, n, 3, p)``, or of their pixels ``(t, n, 2,
    p)``."""
    origin, rotation = at.places[mount]
    inner = (_positions(tracked, at.x) - origin[:, None]) @ rotation
    change = np.swapaxes(rotation, 1, 2)[:, None] @ _positions(tracked, along.x)
    moved = along.moved.get(mount)
    if moved is not None:
        change = change - moved[:, None, :3] - _cross(moved[:, None, 3:], inner[..., None])
    if camera is None:
        return np.asarray(carrier[1].T @ change)
    optic = ((inner - carrier[0]) @ carrier[1]).reshape(-1, 3)
    lens = np.concatenate([project_slopes(camera, optic[a : a + AT_ONCE]) for a in range(0, len(optic), AT_ONCE)])
    by_point = (lens @ carrier[1].T).reshape(*inner.shape[:2], 2, 3)
    return np.asarray(by_point @ change)
