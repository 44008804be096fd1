"""Gels that are glued the wrong way round: the bonded face towards what they are to touch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_core.postprocess import Layout, Surface, surfaces
from sim_core.preflight.distance import gap
from sim_core.preflight.finding import Finding
from sim_core.rigs import Gel

NEARER = 0.05
"""Share of the gel's smallest extent by which its bonded face must be nearer than the others to be reported."""


def bond_findings(layout: Layout) -> list[Finding]:
    """A finding for each gel whose bonded face is nearer than its other faces to all that it may touch."""
    skins = {s.body: s for s in surfaces(layout)}
    found = []
    for name, spec in layout.rig.bodies.items():
        if not isinstance(spec, Gel) or spec.bonded is None:
            continue
        partners = [b for c in layout.rig.contacts if name in c.between for b in c.between if b != name]
        gel = skins[name]
        bonded, free = _part(gel, gel.bonded), _part(gel, ~gel.bonded & ~_rim(gel))
        least = NEARER * float(np.ptp(layout.bodies[name].local, axis=0).min())
        x, frames = layout.rest, layout.start
        wrong = []
        for partner in partners:
            glued, open_ = (gap(layout, part, skins[partner], x, frames) for part in (bonded, free))
            if glued + least < open_:
                wrong.append(partner)
        if partners and len(wrong) == len(partners):
            found.append(
                Finding(
                    "bonded face",
                    f"The bonded face ({spec.bonded}) of {name} points at {' and '.join(wrong)}: its free "
                    f"faces are farther away, and what is glued to {spec.mount} does not deform.",
                    f"Bond another face, or turn {name} (its z axis points from 'bottom' to 'top', or to the apex of a "
                    "dome).",
                )
            )
    return found


def _rim(gel: Surface) -> np.ndarray:
    """Triangles that share a vertex with the bonded face, bool ``(m,)``: as near as that face, whichever way it is."""
    glued = np.unique(gel.triangles[gel.bonded])
    return np.asarray(np.isin(gel.triangles, glued).any(axis=1) & ~gel.bonded)


def _part(surface: Surface, some: np.ndarray) -> Surface:
    """The triangles that are chosen, with their vertices alone."""
    assert surface.nodes is not None
    used, place = np.unique(surface.triangles[some], return_inverse=True)
    return replace(
        surface,
        triangles=place.reshape(-1, 3).astype(np.int32),
        nodes=surface.nodes[used],
        local=surface.local[used],
        bonded=surface.bonded[some],
    )
