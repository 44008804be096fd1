"""Affine bodies in a scene: their control nodes, and joints as relations between these.

A body's control nodes are the corners of its equimomental tetrahedron: four points of a quarter of its mass each
have the mass, centre and second moments of the body (with the principal moments J_i = integral of x_i^2 dV, the corners
are at sqrt(J_i / V) (+-1, +-1, +-1), an even number of minus signs), so the mass matrix is exact and diagonal
(Routh, Dynamics of a System of Rigid Bodies I, art. 33 ff.). Every other point is a combination of them.

A joint is one or more linear relations between the control nodes of two bodies, of the same form whatever the way in
which they move: a shared point p is sum_k l_k(p) x_k (one body) = sum_k m_k(p) x_k (the other), with the barycentric
coordinates l and m at rest.

    ball     p                                 hinge    p and a second point on the axis
    slider   x_k - x_0 = the same vector of the other body, k = 1, 2, 3; a guide keeps p on the axis

A mount stands in with four nodes that follow it. Relations are eliminated (:mod:`sim_core.solve.embedding`) and hold
exactly; the guide of a slider, which is not linear, is a stiff spring (:mod:`sim_core.energies.guide`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sim_core.energies.affine import coordinates
from sim_core.energies.guide import Guide
from sim_core.errors import ConfigError
from sim_core.rigs import WORLD
from sim_core.rigs.schema import Joint
from sim_core.scene.assembly import BuiltBody
from sim_core.solve.embedding import Embedding, eliminate, embed

if TYPE_CHECKING:
    from sim_core.scene.scene import Scene


@dataclass(frozen=True)
class Link:
    """One joint. ``body``: control nodes of the body and ``to``: of the other one, or the nodes that stand for a
    mount, int ``(4,)``; ``at``: [m], ``axis``: unit vector, both in the world at rest, ``(3,)``."""

    label: str
    joint: Joint
    body: np.ndarray
    to: np.ndarray
    at: np.ndarray
    axis: np.ndarray


def joint_label(index: int, joint: Joint) -> str:
    """Name of a joint in messages and terms."""
    return joint.name or f"joints[{index}]"


def make_link(label: str, joint: Joint, body: BuiltBody, to: np.ndarray) -> Link:
    """The joint of a body with the nodes ``to``."""
    axis = np.zeros(3)
    if joint.axis is not None:
        axis = body.rotation @ np.array(joint.axis) / np.linalg.norm(joint.axis)
    return Link(label, joint, body.control, to, body.place(np.array(joint.at_m)), axis)


def relations(links: Sequence[Link], rest: np.ndarray) -> np.ndarray:
    """Rows c with sum_k c_k x_k = 0, ``(m, n_nodes)``."""
    rows = []
    for link in links:
        ours, theirs = rest[link.body], rest[link.to]
        if link.joint.type == "slider":
            points = ours[1:]
            own = np.eye(4)[1:] - np.eye(4)[0]
            others = coordinates(theirs, points) - coordinates(theirs, ours[:1])
        else:
            points = link.at[None]
            if link.joint.type == "hinge":
                # The second point is as far away as the body's own ellipsoid reaches: good numbers for any shape.
                slope = coordinates(ours, link.axis) - coordinates(ours, np.zeros(3))
                points = np.vstack([link.at, link.at + link.axis / np.linalg.norm(slope)])
            own, others = coordinates(ours, points), coordinates(theirs, points)
        for mine, other in zip(own, others, strict=True):
            row = np.zeros(len(rest))
            row[link.body] = mine
            row[link.to] -= other
            rows.append(row)
    return np.array(rows).reshape(-1, len(rest))


def guides(links: Sequence[Link], rest: np.ndarray, sizes: Mapping[str, float]) -> list[Guide]:
    """The guides of all sliders. ``sizes``: of the bodies by name [m]."""
    out = []
    for link in links:
        if link.joint.type == "slider":
            apart = np.concatenate([coordinates(rest[link.body], link.at)[0], -coordinates(rest[link.to], link.at)[0]])
            ends = coordinates(rest[link.to], np.vstack([link.at, link.at + link.axis]))
            along = np.concatenate([np.zeros(4), ends[1] - ends[0]])
            nodes = np.concatenate([link.body, link.to])
            out.append(Guide(f"{link.label}.guide", nodes, apart, along, sizes[link.joint.body]))
    return out


def embedding(
    bodies: Sequence[BuiltBody], links: Sequence[Link], rest: np.ndarray, mount_of: Mapping[int, str]
) -> Embedding | None:
    """How the surfaces of all affine ``bodies`` move with their control nodes, and these with each other where joints
    connect them. ``mount_of``: the mount of every node that stands for one."""
    if not bodies:
        return None
    control = np.concatenate([b.control for b in bodies])
    free = np.isin(np.arange(len(rest)), control)
    nodes, weights, left = eliminate(relations(links, rest), free)
    for row in left:
        mounts = {mount_of[int(node)] for node in np.flatnonzero(np.abs(row) > 1e-9)}
        if len(mounts) > 1:
            raise ConfigError(
                f"The joints connect {' and '.join(sorted(mounts))} so that these cannot move against each other.",
                "Remove a joint, or use one that leaves more freedom.",
            )
    points = [(b.nodes[:-4], b.control, coordinates(b.local[-4:], b.local[:-4])) for b in bodies]
    return embed(len(rest), points, (nodes, weights))


def carried_by(scene: Scene) -> dict[str, str]:
    """Mount that an affine body is connected to, through other bodies or not; those of the world are left out."""
    carried: dict[str, str] = {}
    for _ in scene.rig.joints:
        for joint in scene.rig.joints:
            known = {WORLD: WORLD, **{e: e for e in scene.rig.end_effectors}, **carried}
            for one, other in ((joint.body, joint.to), (joint.to, joint.body)):
                if one in scene.bodies and one not in carried and other in known:
                    carried[one] = known[other]
    return carried
