"""Where bodies are at the start of a rollout: the free nodes of one that something holds go along with it.

A recording seldom begins with the hands where the rig has them. A body that stayed behind would be strained violently
on its way to rest, and one that yields would never forget it. Where one mount holds a body its free nodes y move
rigidly with that mount; where several do, by the mean of these motions,

    x = sum_m w_m (o_m + R_m y_m),    w_m ~ 1 / d_m^2,    sum_m w_m = 1

with y_m the place at rest in the mount's frame (o_m, R_m), and d_m the distance at rest from the nearest node that m
holds (Shepard, Proc. 23rd ACM Natl. Conf., 1968). A body whose pose the rig gives in the frame of a mount follows that.
One that an earlier rollout has left in another shape goes along in that shape.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from sim_core.errors import ConfigError
from sim_core.rigs import WORLD, Affine
from sim_core.scene.joints import carried_by

if TYPE_CHECKING:
    from sim_core.permanent_state import PermanentState
    from sim_core.scene.scene import Frame, Scene


@dataclass(frozen=True)
class Carrier:
    """A mount that free nodes go along with: their places ``local`` in its frame [m] ``(k, 3)``, and the ``weights`` of
    its motion ``(k,)``."""

    mount: str
    nodes: np.ndarray
    local: np.ndarray
    weights: np.ndarray


def carriers(scene: Scene, name: str, left: PermanentState | None = None) -> list[Carrier]:
    """What the free nodes of a simulated body go along with; nothing if no node of it is held. ``left``: what an
    earlier rollout has left."""
    body, held = scene.bodies[name], scene.held(name)
    if not held.any() or held.all():
        return []
    free = body.nodes[~held]
    weights = {scene.mount_of(name): np.ones(len(free))}
    if WORLD in weights:
        weights = _shares(scene, body.nodes[held], free)
    shape, frames = scene.rest, scene.start
    if left is not None and name in left.shaped:
        shape, frames = left.x, dict(left.frames)
    found = []
    for mount, share in weights.items():
        origin, rotation = frames[mount]
        found.append(Carrier(mount, free, rotation.inv().apply(shape[free] - origin), share))
    return found


def _shares(scene: Scene, held: np.ndarray, free: np.ndarray) -> dict[str, np.ndarray]:
    """Weights ``(k,)`` of the mounts that hold a body, at its free nodes."""
    owned: dict[str, list[np.ndarray]] = {}
    for follower in scene.followers:
        if follower.axes.all() and np.isin(follower.nodes, held).any():
            owned.setdefault(follower.mount, []).append(follower.nodes)
    far = {m: cKDTree(scene.rest[np.concatenate(n)]).query(scene.rest[free])[0] for m, n in owned.items()}
    least = 1e-9 * max(float(d.max()) for d in far.values())  # nodes on both sides of a slit are in one place
    near = {m: np.maximum(d, least) ** -2.0 for m, d in far.items()}
    total = sum(near.values())
    return {mount: share / total for mount, share in near.items()}


def carried_places(
    scene: Scene, name: str, frames: Mapping[str, Frame], left: PermanentState | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Free nodes of a body, and where they are put [m] ``(k, 3)`` when the mounts are at ``frames``."""
    found = carriers(scene, name, left)
    nodes = found[0].nodes if found else np.empty(0, dtype=int)
    anew = left is None or name not in left.shaped
    if anew and all(frames[c.mount] is scene.start[c.mount] for c in found):
        return nodes, scene.rest[nodes]
    places = np.zeros((len(nodes), 3))
    for carrier in found:
        origin, rotation = frames[carrier.mount]
        places += carrier.weights[:, None] * (origin + rotation.apply(carrier.local))
    return nodes, places


def start_state(
    scene: Scene, frames: Mapping[str, Frame], left: PermanentState | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Positions [m] and velocities [m/s], ``(n, 3)`` each, at the start, when the mounts are at ``frames``.
    ``left``: what an earlier rollout has left of the bodies."""
    x = scene.targets(frames)
    v = np.zeros_like(x)
    carried = carried_by(scene)
    for body in scene.bodies.values():
        if isinstance(body.spec, Affine):
            velocity, spin = np.array(body.spec.velocity_m_s), np.deg2rad(body.spec.angular_velocity_deg_s)
            v[body.nodes] = velocity + np.cross(spin, body.rest - body.place(np.zeros(3)))
            mount = carried.get(body.name, WORLD)
            (origin, rotation), (was, turned) = frames[mount], scene.start[mount]
            if frames[mount] is not scene.start[mount]:
                turn = rotation * turned.inv()
                x[body.nodes] = origin + turn.apply(body.rest - was)
                v[body.nodes] = turn.apply(v[body.nodes])
        elif body.mesh is not None and scene.held(body.name).any():
            free, places = carried_places(scene, body.name, frames, left)
            x[free] = places
    given = v.copy()
    scene.system.embed(v)
    miss = float(np.abs(v - given).max(initial=0.0))
    if miss > 1e-6 * (1.0 + float(np.abs(given).max(initial=0.0))):
        raise ConfigError(
            f"The velocities of the affine bodies at the start do not agree with their joints by {miss:.3g} m/s.",
            "Give bodies that are connected velocities that their joints allow.",
        )
    return x, v
