"""What follows the mounts, linearised: positions of nodes and turns of rigid bodies for small motions of the mounts.

A motion of a mount is a translation rho [m] and a turn phi [rad] in its own frame. What is at y in that frame moves by
R (rho + phi x y), and a rigid body with the rotation Q in its mount turns by Q^T phi in its own frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.contact.rigid import RigidContact
from sim_core.energies.linearised import skew
from sim_core.permanent_state import PermanentState
from sim_core.rigs import WORLD, Affine, Rigid
from sim_core.scene.assembly import BuiltBody
from sim_core.scene.carriage import Carrier, carriers
from sim_core.scene.joints import carried_by
from sim_core.scene.scene import Frame, Scene

Motions = Mapping[str, np.ndarray]
"""Motions of mounts by p parameters, ``(6, p)`` each."""


@dataclass(frozen=True)
class Driven:
    """Derivatives by p parameters of what drives a step: ``x``: of prescribed nodes, and what is embedded in them,
    ``(n, 3, p)``; ``turns``: of rigid bodies in their own frames by their terms, ``(3, p)``."""

    x: np.ndarray
    turns: dict[str, np.ndarray]


def carried_contacts(scene: Scene) -> list[tuple[BuiltBody, RigidContact]]:
    """Rigid bodies and the terms that turn with them."""
    terms = [t for t in scene.system.terms if isinstance(t, RigidContact)]
    bodies = [b for b in scene.bodies.values() if isinstance(b.spec, Rigid)]
    return [(b, t) for b in bodies for t in terms if t.body_node == int(b.nodes[0])]


def carried_freely(scene: Scene, start: np.ndarray, frames: Mapping[str, Frame]) -> list[Carrier]:
    """What follows mounts to the ``start`` [m] ``(n, 3)`` alone, at ``frames``: what is free of a body of which
    something is held, and affine bodies that are connected to a mount. Weights are taken as they are."""
    carried, found = carried_by(scene), []
    for name, body in scene.bodies.items():
        if not isinstance(body.spec, Affine | Rigid):
            found += carriers(scene, name)
        elif carried.get(name, WORLD) != WORLD:
            origin, rotation = frames[carried[name]]
            local = rotation.inv().apply(start[body.nodes] - origin)
            found.append(Carrier(carried[name], body.nodes, local, np.ones(len(body.nodes))))
    return found


def driven(scene: Scene, frames: Mapping[str, Frame], moved: Motions, count: int) -> Driven:
    """What follows mounts at ``frames`` that move by ``count`` parameters."""
    x = np.zeros((*scene.rest.shape, count))
    for follower in scene.followers:
        if follower.mount in moved:
            there, axes = (
                carried_along(follower.local, frames[follower.mount], moved[follower.mount]),
                follower.axes > 0.0,
            )
            x[np.ix_(follower.nodes, axes)] = there[:, axes]
    x[~scene.system.prescribed] = 0.0
    for k in range(count):
        column = np.ascontiguousarray(x[..., k])
        scene.system.embed(column)
        x[..., k] = column
    turns = {
        t.name: b.spec.pose.rotation().as_matrix().T @ moved[b.spec.mount][3:]
        for b, t in carried_contacts(scene)
        if isinstance(b.spec, Rigid) and b.spec.mount in moved
    }
    return Driven(x, turns)


def start_along(
    scene: Scene, frames: Mapping[str, Frame], moved: Motions, start: tuple[np.ndarray, np.ndarray], count: int
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Derivatives of where mounts at ``frames`` put the bodies: of the positions and velocities at the ``start`` ``(n,
    3)`` each, ``(n, 3, count)``, and of the rotations of rigid bodies by their terms ``(9, count)``."""
    follow = driven(scene, frames, moved, count)
    x, v = follow.x.copy(), np.zeros_like(follow.x)
    free = [c for c in carried_freely(scene, start[0], frames) if c.mount in moved]
    for carrier in free:
        x[carrier.nodes] = v[carrier.nodes] = 0.0
    for carrier in free:
        frame, motion, nodes = frames[carrier.mount], moved[carrier.mount], carrier.nodes
        weights = carrier.weights[:, None, None]
        x[nodes] += weights * carried_along(carrier.local, frame, motion)
        turned = np.concatenate([np.zeros_like(motion[:3]), motion[3:]])
        v[nodes] += weights * carried_along(frame[1].inv().apply(start[1][nodes]), frame, turned)
    rotations = {}
    for body, term in carried_contacts(scene):
        if term.name in follow.turns:
            turns = np.stack([(body.rotation @ skew(e)).ravel() for e in np.eye(3)], axis=-1)
            rotations[term.name] = turns @ follow.turns[term.name]
    return x, v, rotations


def put_left(scene: Scene, frames: Mapping[str, Frame], left: PermanentState, x: np.ndarray) -> None:
    """Put derivatives of where an earlier rollout has left bodies into those of the positions at the start
    ``(n, 3, p)``; the mounts moved alike at its end."""
    for name in left.shaped if left.by_x is not None else ():
        along = carriers(scene, name, left)
        for carrier in along:
            x[carrier.nodes] = 0.0
        for carrier in along:
            turn = (frames[carrier.mount][1] * left.frames[carrier.mount][1].inv()).as_matrix()
            by = np.einsum("ij,kjp->kip", turn, left.by_x[carrier.nodes])  # type: ignore[index]
            x[carrier.nodes] += carrier.weights[:, None, None] * by


def carried_along(local: np.ndarray, frame: Frame, moved: np.ndarray) -> np.ndarray:
    """Motion ``(k, 3, p)`` in the world of points ``local`` [m] ``(k, 3)`` of a frame."""
    inner = moved[:3] - skew(local) @ moved[3:]
    return np.asarray(frame[1].as_matrix() @ inner)
