"""Weights of readings at many instants, passed back to the states: the transpose of
:func:`sim_core.sensing.instants.differentiate_all`, in whose words everything is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.rigs import MarkerSensor, Rig
from sim_core.scene.assembly import BuiltBody
from sim_core.sensing.camera import Camera, project_slopes
from sim_core.sensing.instants import (
    AT_ONCE,
    Instants,
    _carrier,
    _compose,
    _into,
    _load,
    _positions,
    _spanned,
    polar,
    spanning,
    twisting,
)
from sim_core.sensing.observe import Observer, Placement, Tracked, _camera_placement


@dataclass(frozen=True)
class InstantWeights:
    """Weights of t states: of positions ``(t, n, 3)``, of loads on the nodes ``bearing`` ``(t, b, 3)``, of moments of
    rigid bodies by their nodes ``(t, 3)``, and of motions of the mounts in their own frames ``(t, 6)``."""

    x: np.ndarray
    bearing: np.ndarray
    force: np.ndarray
    moments: dict[int, np.ndarray]
    frames: dict[str, np.ndarray]

    def of(self, mount: str) -> np.ndarray:
        """Weights of a mount's motions, to be added to."""
        return self.frames.setdefault(mount, np.zeros((len(self.x), 6)))


def pull_all(
    observer: Observer, rig: Rig, at: Instants, bearing: np.ndarray, weights: Mapping[str, np.ndarray]
) -> InstantWeights:
    """Weights of the states ``at`` some instants from those of their readings, by channel ``(t, ...)``, which are zero
    where a reading is not a number."""
    count = len(at.x)
    moments = {node: np.zeros((count, 3)) for node, _ in at.moments}
    out = InstantWeights(np.zeros_like(at.x), bearing, np.zeros((count, len(bearing), 3)), moments, {})
    for name, w in weights.items():
        kind = observer.kinds[name]
        if not np.any(w):
            continue
        if kind == "wrench":
            _pull_load(observer, name, at, w, out)
        elif kind == "markers":
            sensor = rig.sensors[name]
            assert isinstance(sensor, MarkerSensor)
            carrier = _compose(observer._body_poses[sensor.body], observer._poses[name])
            _pull_seen(observer._tracked[name], observer._mounts[sensor.body], carrier, None, at, w, out)
        else:
            camera = rig.cameras[name]
            tracked = observer._tracked_by(name, camera)
            points = sum(len(t.nodes) for t in tracked)  # an origin that is shown behind them stays where it is
            _pull_seen(tracked, camera.mount, _camera_placement(camera), camera, at, w[:, :points], out)
    return out


def _add(to: np.ndarray, nodes: np.ndarray, values: np.ndarray) -> None:
    """Add vectors ``(t, k, 3)`` to those of some of the nodes ``(t, n, 3)``."""
    np.add.at(np.swapaxes(to, 0, 1), nodes, np.swapaxes(values, 0, 1))


def _pull_load(observer: Observer, name: str, at: Instants, w: np.ndarray, out: InstantWeights) -> None:
    """Of a wrench ``(t, 6)``."""
    nodes, (_, turn), carrier = _carrier(observer, name, at)
    force, torque, (origin, rotation) = _load(observer, name, at)
    held, arms = at.force[:, nodes], at.x[:, nodes] - origin[:, None]
    by_force, by_torque = ((rotation @ part[..., None])[..., 0] for part in (w[:, :3], w[:, 3:]))
    _add(out.force, np.searchsorted(out.bearing, nodes), by_force[:, None] + np.cross(by_torque[:, None], arms))
    by_arm = np.cross(held, by_torque[:, None])
    _add(out.x, nodes, by_arm)
    for node, moment in out.moments.items():
        if node in nodes:
            moment -= by_torque
    back = -_into(turn, by_arm.sum(axis=1))
    by_turn = np.cross(carrier[0], back)
    for vector, part in ((force, w[:, :3]), (torque, w[:, 3:])):
        by_turn -= np.cross(_into(turn, vector), part @ carrier[1].T)
    body = observer.free_body(name)
    if body is None:
        out.of(observer._loaded[name][1])[:] += np.concatenate([back, by_turn], axis=1)
    else:
        _add(out.x, body.control, _pull_body(body, at.x, back, by_turn))


def _pull_body(body: BuiltBody, x: np.ndarray, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Of motions of the frames of a free body ``(t, 3)``, to its control nodes ``(t, 4, 3)``."""
    rotation, stretch = polar(_spanned(body, x)[1])
    twist = np.linalg.solve(twisting(stretch), turn[..., None])[..., 0]
    slopes = rotation @ -np.cross(twist[:, None], np.eye(3))
    origin = (rotation @ shift[..., None])[..., 0] - slopes.sum(axis=2)
    points = np.concatenate([origin[:, None], np.swapaxes(slopes, 1, 2)], axis=1)
    return np.asarray(np.einsum("kc,tki->tci", spanning(body), points))


def _pull_seen(
    tracked: list[Tracked],
    mount: str,
    carrier: Placement,
    camera: Camera | None,
    at: Instants,
    w: np.ndarray,
    out: InstantWeights,
) -> None:
    """Of points seen from a frame that stands in a mount ``(t, n, 3)``, or of their pixels ``(t, n, 2)``."""
    origin, rotation = at.places[mount]
    inner = (_positions(tracked, at.x) - origin[:, None]) @ rotation
    if camera is None:
        by_inner = w @ carrier[1].T
    else:
        optic = ((inner - carrier[0]) @ carrier[1]).reshape(-1, 3)
        lens = np.concatenate([project_slopes(camera, optic[a : a + AT_ONCE]) for a in range(0, len(optic), AT_ONCE)])
        by_point = (lens @ carrier[1].T).reshape(*inner.shape[:2], 2, 3)
        hidden = ~np.any(w, axis=-1)  # out of sight, where the lens may have no slope
        by_inner = np.where(hidden[..., None], 0.0, np.einsum("tnij,tni->tnj", by_point, w))
    by_point = by_inner @ np.swapaxes(rotation, 1, 2)
    first = 0
    for t in tracked:
        own = by_point[:, first : first + len(t.nodes)]
        first += len(t.nodes)
        for k in range(t.nodes.shape[1]):
            _add(out.x, t.nodes[:, k], t.weights[:, k][None, :, None] * own)
    motion = out.of(mount)
    motion[:, :3] -= by_inner.sum(axis=1)
    motion[:, 3:] -= np.cross(inner, by_inner).sum(axis=1)
