"""Finer cells of gels where rigid bodies touch them in recordings, and the error of the mesh from the coarser rig.

A contact is recognised by where points of the gel's undeformed surface would be inside the rigid body along the
recorded poses. Those of a sphere reach out to sqrt(2 R delta), the contact on a deep gel to a = sqrt(R delta) (Hertz),
so what is touched is nearer to the middle by sqrt(2) there. Cells that reach into the box around all that is touched
get edges of at most ``DISCRETISATION.edge_over_contact_radius`` times its half width a. The mesh of the rig is then the
coarser of two, and with readings y, edges H of it and h,

    y* - y_h = (y_h - y_H) / ((H / h)^2 - 1)

(Richardson's extrapolation): what a fit takes into account, at the cost of the coarser mesh.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.geometry.solids import TetMesh
from sim_core.postprocess import Layout, Surface, lay_out, surfaces
from sim_core.preflight.distance import sampled, signed_distance
from sim_core.rigs import Gel, Rig, Rigid, Sheet
from sim_core.rigs.regions import RefinedBox
from sysid.observations.observations import Run
from sysid.settings.discretisation import DISCRETISATION


@dataclass(frozen=True)
class ContactMesh:
    """``rig``: with refined cells; ``finer``: longest edge of the given ones in the contact over that of the refined
    cells, the least of all gels; ``notes``: what was refined, in words."""

    rig: Rig
    finer: float
    notes: tuple[str, ...]


def refined_where_touched(rig: Rig, runs: Sequence[Run]) -> ContactMesh | None:
    """The rig with finer cells of its gels where rigid bodies touch them; None where its own are fine enough, where
    its gels have boxes of refinement already, or where it has sheets, of which nobody knows where they will touch."""
    if any(isinstance(body, Sheet) for body in rig.bodies.values()):
        return None
    layout = lay_out(rig)
    skins = {s.body: s for s in surfaces(layout)}
    bodies, notes, finer = {}, [], np.inf
    for name, gel in rig.bodies.items():
        if not isinstance(gel, Gel) or not hasattr(gel.shape, "refine") or gel.shape.refine:
            continue
        found = _touched(layout, skins, name, runs)
        if found is None:
            continue
        (low, high), radius = found
        own = _longest_edge(layout, name, low, high)
        ratio = min(own / (DISCRETISATION.edge_over_contact_radius * radius), DISCRETISATION.most_edge_ratio)
        if ratio < DISCRETISATION.least_edge_ratio:
            continue
        edges = dict(zip(("x_m", "y_m", "z_m"), np.stack([low, high], axis=1).tolist(), strict=True))
        box = RefinedBox(**{k: tuple(v) for k, v in edges.items()}, edge_m=own / ratio)
        finer = min(finer, ratio)
        bodies[name] = gel.model_copy(update={"shape": gel.shape.model_copy(update={"refine": (box,)})})
        notes.append(
            f"Cells of {name} are at most {1e3 * box.edge_m:.2g} mm long where it is touched, {1e3 * own:.2g} mm in "
            f"the rig: the radius of the contact is {1e3 * radius:.2g} mm."
        )
    if not bodies:
        return None
    return ContactMesh(rig.model_copy(update={"bodies": {**rig.bodies, **bodies}}), float(finer), tuple(notes))


def _touched(
    layout: Layout, skins: Mapping[str, Surface], gel: str, runs: Sequence[Run]
) -> tuple[tuple[np.ndarray, np.ndarray], float] | None:
    """Corners [m] ``(3,)`` of the box, in the gel's own coordinates, around all that rigid bodies touch, and the radius
    [m] of the widest contact."""
    corners, radius = [], 0.0
    for local, inside, curved in _instants(layout, skins[gel], gel, runs):
        if inside.sum() < 3:
            continue
        low, high = local[inside].min(axis=0), local[inside].max(axis=0)
        middle, half = 0.5 * (low + high), 0.5 * (high - low) / (np.sqrt(2.0) if curved else 1.0)
        corners += [middle - half, middle + half]
        radius = max(radius, float(np.sort(half)[1:].mean()))
    if not corners or radius == 0.0:
        return None
    margin = DISCRETISATION.contact_margin * radius
    return (np.min(corners, axis=0) - margin, np.max(corners, axis=0) + margin), radius


def _instants(
    layout: Layout, skin: Surface, gel: str, runs: Sequence[Run]
) -> Iterator[tuple[np.ndarray, np.ndarray, bool]]:
    """Points of a gel's surface in its own coordinates ``(n, 3)``, which are inside a rigid body, and whether that is
    curved, at instants."""
    partners = [b for c in layout.rig.contacts if gel in c.between for b in c.between]
    rigid = [b for b in dict.fromkeys(partners) if isinstance(layout.rig.bodies[b], Rigid)]
    for run in runs:
        times = np.linspace(0.0, run.end, DISCRETISATION.contact_instants)
        for frames in layout.frames_along(run.poses, times):
            vertices = skin.vertices(layout, layout.carried(frames), frames)
            points = sampled(vertices, skin.triangles, max(float(np.ptp(vertices, axis=0).max()) / 60.0, 1e-6))
            here, turn = layout.body_frame(gel, frames)
            local = turn.inv().apply(points - here)
            for body in rigid:
                there, turned = layout.body_frame(body, frames)
                spec = layout.rig.bodies[body]
                assert isinstance(spec, Rigid)
                inside = signed_distance(spec, turned.inv().apply(points - there)) < 0.0
                yield local, inside, spec.shape.type in ("sphere", "cylinder")


def _longest_edge(layout: Layout, gel: str, low: np.ndarray, high: np.ndarray) -> float:
    """Longest edge [m] of the cells of a gel that reach into a box in its own coordinates."""
    mesh = layout.bodies[gel].layout
    assert isinstance(mesh, TetMesh)
    corners = mesh.nodes[mesh.tets[:, :4]]
    within = ((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1)
    first, second = np.triu_indices(4, 1)
    edges = np.linalg.norm(corners[:, first] - corners[:, second], axis=2)
    return float(edges[within].max(initial=0.0) if within.any() else edges.max())
