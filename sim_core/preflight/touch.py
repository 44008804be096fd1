"""Motions in which nothing that may touch ever comes near."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.postprocess import Layout, Surface, surfaces
from sim_core.preflight.distance import gap
from sim_core.preflight.finding import Finding
from sim_core.rigs import WORLD, Affine, Gel, Rigid, Sheet
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.assembly import held_nodes
from sim_core.scene.contact_constants import constants_of, finest_edge

INSTANTS = 80
"""Instants at which distances are looked at, at most."""


def touch_findings(layout: Layout, poses: Mapping[str, PoseTrajectory]) -> list[Finding]:
    """A finding where contacts are declared and all of them stay open, with the nearest that each pair comes."""
    rig = layout.rig
    pairs = [c.between for c in rig.contacts]
    if not pairs:
        return []
    skins = {s.body: s for s in surfaces(layout)}
    times = _instants(poses)
    edges = {name: finest_edge(body) for name, body in layout.bodies.items() if isinstance(body.spec, Gel)}
    nearest: dict[tuple[str, str], tuple[float, float]] = {}
    along = layout.frames_along(poses, times)
    carried = [layout.carried(frames) for frames in along]
    for pair in pairs:
        if pair[0] == pair[1] or not all(_knowable(layout, body) for body in pair):
            return []
        ranges = [constants_of(rig, c, edges).range_m for c in rig.contacts if set(c.between) == set(pair)]
        wide = max(ranges, default=0.0)
        slack = sum(_reach(layout, body) for body in pair) + wide
        one, other = (skins[body] for body in pair)
        enough = slack + _coarseness(layout, one, other)
        gaps: list[float] = []
        for x, frames in zip(carried, along, strict=True):
            gaps.append(gap(layout, one, other, x, frames))
            if gaps[-1] <= enough:
                return []
        k = int(np.argmin(gaps))
        nearest[pair] = gaps[k], float(times[k])
    ways = "; ".join(
        f"{a} and {b} come within {1e3 * distance:.3g} mm, at {t:.2f} s" for (a, b), (distance, t) in nearest.items()
    )
    return [
        Finding(
            "no contact",
            f"Nothing touches in this motion, although contacts are declared: {ways}.",
            "Move the end effector further, or begin nearer.",
        )
    ]


def _instants(poses: Mapping[str, PoseTrajectory]) -> np.ndarray:
    """Times [s] at which the hands are looked at: evenly, and where they are farthest from the start."""
    if not poses:
        return np.zeros(1)
    every = np.unique(np.concatenate([p.times for p in poses.values()]))
    some = every[np.unique(np.linspace(0, len(every) - 1, min(INSTANTS, len(every))).round().astype(int))]
    ends = [p.times[k] for p in poses.values() for axis in p.positions.T for k in (np.argmin(axis), np.argmax(axis))]
    return np.unique(np.concatenate([some, ends]))


def _knowable(layout: Layout, body: str) -> bool:
    """Whether it is known without a simulation about where a body is: held by a mount, or nothing pulls it."""
    spec = layout.rig.bodies[body]
    if isinstance(spec, Rigid):
        return True
    if isinstance(spec, Affine):
        still = not any((*spec.velocity_m_s, *spec.angular_velocity_deg_s)) and not layout.rig.joints
        return still and not any(layout.rig.gravity_m_s2)
    holders = held_nodes(layout.rig, layout.bodies[body])
    mounts = {h.mount for label, h in holders.items() if not label.endswith("_cut")}
    if isinstance(spec, Sheet):
        return mounts == {WORLD}  # carried by one that moves, it goes elsewhere than its pose says
    return bool(mounts)


def _reach(layout: Layout, body: str) -> float:
    """How far [m] a point of a body may get by deforming, without stretching: that of a sheet from what holds it, and
    back."""
    spec = layout.rig.bodies[body]
    built = layout.bodies[body]
    if (isinstance(spec, Gel) and spec.bonded is not None) or not isinstance(spec, Sheet):
        return 0.0
    held = np.any([h.inside for h in held_nodes(layout.rig, built).values()], axis=0)
    apart = np.linalg.norm(built.local[:, None] - built.local[None, held], axis=2).min(axis=1)
    return 2.0 * float(apart.max())


def _coarseness(layout: Layout, one: Surface, other: Surface) -> float:
    """By how much [m] distances between meshes may be too large: they are those of points on them."""
    if one.nodes is None or other.nodes is None:
        return 0.0
    extents = (float(np.ptp(layout.bodies[s.body].rest, axis=0).max()) / 40.0 for s in (one, other))
    return 0.75 * sum(extents)
