"""The pieces of a sheet or a gel that share no vertex, and what holds each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sim_core.rigs.fields import FloatArray

if TYPE_CHECKING:
    from sim_core.rigs.schema import Rig


@dataclass(frozen=True, eq=False)
class Piece:
    """One piece of a body: the ``number``-th of ``count``, with so many ``elements``, between the corners ``low`` and
    ``high`` [m] in the body's rest coordinates; ``holders``: clamps and the mount that hold nodes of it."""

    number: int
    count: int
    elements: int
    low: FloatArray
    high: FloatArray
    holders: tuple[str, ...]

    @property
    def words(self) -> str:
        """Which one it is."""
        spans = ", ".join(f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip("xyz", self.low, self.high, strict=True))
        return f"piece {self.number} ({self.elements} elements, {spans} m)"


def pieces_held(rig: Rig, name: str) -> list[Piece]:
    """The pieces of a sheet or a gel, and what holds each. A body whose mesh the package makes is one piece."""
    body = rig.bodies[name]
    assert body.type == "sheet" or body.type == "gel"
    clamps = [(c.name or f"clamps[{k}]", c) for k, c in enumerate(rig.clamps) if c.body == name]
    mount = (body.mount,) if body.type == "gel" and body.mount is not None else ()
    if body.shape.type != "mesh":
        low, high = body.shape.bounds()
        return [Piece(1, 1, 0, low, high, (*mount, *(label for label, _ in clamps)))]
    from sim_core.geometry.mesh_checks import pieces_of
    from sim_core.geometry.sheets import SheetMesh

    mesh = body.shape.mesh()
    cells = mesh.triangles if isinstance(mesh, SheetMesh) else mesh.tets
    label = pieces_of(cells)
    found = []
    for k in range(int(label.max()) + 1):
        nodes = mesh.nodes[np.unique(cells[label == k])]
        holders = tuple(word for word, clamp in clamps if clamp.region.contains(nodes).any())
        found.append(
            Piece(
                k + 1, int(label.max()) + 1, int((label == k).sum()), nodes.min(axis=0), nodes.max(axis=0),
                (*mount, *holders),
            )
        )  # fmt: skip
    return found
