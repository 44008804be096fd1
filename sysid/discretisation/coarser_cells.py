"""Coarser cells of gels for searches, where those of a rig make every rollout cost minutes.

A diagnosis takes hundreds of rollouts, the cost of which grows with more than the number of unknowns. The gels of a
rig with many therefore get half as many cells along every axis, once or more often, and what the rig's own cells add to
the readings is measured where a search stands (:mod:`sysid.model.space_mapping`). The coarser cells tell the error of
the rig's own by Richardson's extrapolation, as in :mod:`sysid.discretisation.contact_mesh`.
"""

from __future__ import annotations

from dataclasses import dataclass

from sim_core.postprocess import lay_out
from sim_core.rigs import Gel, Rig, Sheet
from sim_core.rigs.gel_shapes import Block, Disc, Dome
from sysid.discretisation.contact_mesh import ContactMesh
from sysid.settings.discretisation import DISCRETISATION

HexahedralShape = Block | Disc | Dome


@dataclass(frozen=True)
class CoarserCells:
    """``given``: a rig with fine cells; ``rig``: the same with coarser ones; ``halvings``: how often the cells of its
    gels were halved along every axis."""

    given: Rig
    rig: Rig
    halvings: int

    def given_cells(self, rig: Rig) -> ContactMesh:
        """The coarser rig, or one with wider pads and cells as coarse, with cells as fine as those given."""
        bodies, ratios, notes = {}, [], []
        for name, coarse in _hexahedral(rig).items():
            own, shape = _hexahedral(self.given)[name], coarse
            if coarse == _hexahedral(self.rig)[name]:
                shape = own
            else:
                shape = _with_cells(coarse, tuple(n * 2**self.halvings for n in coarse.cells), 0.5**self.halvings)
            if shape.cells == coarse.cells:
                continue
            bodies[name] = rig.bodies[name].model_copy(update={"shape": shape})
            ratios.append(min(a / b for a, b in zip(shape.cells, coarse.cells, strict=True)))
            fine, wider = (" x ".join(map(str, cells)) for cells in (shape.cells, coarse.cells))
            notes.append(
                f"Searches are made with {wider} cells of {name}, and what the {fine} of the rig add is measured where "
                "they stand."
            )
        return ContactMesh(rig.model_copy(update={"bodies": {**rig.bodies, **bodies}}), min(ratios), tuple(notes))


def coarsened(rig: Rig) -> CoarserCells | None:
    """The rig with so few cells of its gels that it has ``DISCRETISATION.searched_nodes`` nodes or less, as far as all
    axes of a gel can have fewer, without which nothing tells the error; None where it has no more nodes, where no gel
    can have coarser cells, and where it has sheets, whose cells are as many."""
    if any(isinstance(body, Sheet) for body in rig.bodies.values()):
        return None
    coarse, halvings = rig, 0
    while _nodes(coarse) > DISCRETISATION.searched_nodes:
        pairs = {n: (s, _halved(s)) for n, s in _hexahedral(coarse).items()}
        halved = {n: h for n, (s, h) in pairs.items() if all(a > b for a, b in zip(s.cells, h.cells, strict=True))}
        if not halved:
            break
        bodies = {n: coarse.bodies[n].model_copy(update={"shape": s}) for n, s in halved.items()}
        coarse, halvings = coarse.model_copy(update={"bodies": {**coarse.bodies, **bodies}}), halvings + 1
    return CoarserCells(rig, coarse, halvings) if halvings else None


def _hexahedral(rig: Rig) -> dict[str, HexahedralShape]:
    """Shapes of gels that count their cells, by body."""
    return {n: b.shape for n, b in rig.bodies.items() if isinstance(b, Gel) and isinstance(b.shape, HexahedralShape)}


def _halved(shape: HexahedralShape) -> HexahedralShape:
    """Half as many cells along every axis, an even number of them across a plane of symmetry."""
    cells = tuple(-(-n // 2) for n in shape.cells)
    cut = (0, 1) if isinstance(shape, Block) else (0,)
    even = tuple(n + n % 2 if shape.symmetry and k in cut else n for k, n in enumerate(cells))
    return _with_cells(shape, even, 2.0)


def _with_cells(shape: HexahedralShape, cells: tuple[int, ...], edges: float) -> HexahedralShape:
    """Other numbers of cells; the longest edges in boxes of refinement change by a factor ``edges``."""
    refine = tuple(box.model_copy(update={"edge_m": edges * box.edge_m}) for box in shape.refine)
    return shape.model_copy(update={"cells": cells, "refine": refine})


def _nodes(rig: Rig) -> int:
    """Number of nodes of the gels of a rig."""
    layout = lay_out(rig)
    return sum(len(layout.bodies[name].nodes) for name in rig.bodies if isinstance(rig.bodies[name], Gel))
