"""Specimens for any test of sheets: a strip with any ends, any load on it, and the way to equilibrium."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sim_core.energies.bending import Bending
from sim_core.energies.couple import Couple
from sim_core.energies.membrane import Membrane
from sim_core.energies.term import Term
from sim_core.geometry.sheets import SheetMesh, rectangle
from sim_core.solve.step import State, advance
from sim_core.solve.system import System
from sim_core.solve.unknowns import Compliant

DENSITY = 1000.0
FREE_M_PER_N = 1e9
"""Compliance of a clamp that is free to shift."""

MESHES = ((20, 2), (40, 4), (80, 8))
FINE = ((40, 4), (80, 8), (160, 16))
LONG = ((80, 2), (160, 4))
"""Cells along and across a strip, on meshes that are refined."""

ACROSS = np.array([0.0, 1.0, 0.0])
"""Axis about which a strip along x bends."""

RIGID = ("clamped", "guided", "turned", "driven")
"""Kinds of ends beyond which the strip goes on as a column of rigid cells."""

FIXED = {
    "clamped": (0, 1, 2),
    "guided": (1, 2),
    "turned": (1,),
    "driven": (0, 1, 2),
    "pinned": (0, 1, 2),
    "rolling": (1, 2),
    "free": (),
}
"""Components that are prescribed on an end: clamped; guided along x; free but for a rigid tip that stays in its plane;
turned as prescribed but free to shift; a hinge; a hinge that slides along x; nothing."""


def described(pattern: str, meshes: Sequence[tuple[int, int]]) -> str:
    """The finest mesh in words."""
    return f"{pattern} {meshes[-1][0]} x {meshes[-1][1]}"


def sheet_system(
    mesh: SheetMesh,
    values: Mapping[str, float],
    held: np.ndarray,
    prescribed: np.ndarray,
    extra: Sequence[Term] = (),
    compliant: Sequence[Compliant] = (),
) -> System:
    """A static sheet; ``held``: nodes in rigid clamps; ``extra``: more terms, already configured; ``compliant``:
    clamps that give way."""
    axis = np.array([1.0, 0.0, 0.0])
    terms: list[Term] = [
        Membrane("membrane", mesh.nodes, mesh.triangles, axis),
        Bending("bending", mesh, 0, axis, held=held),
    ]
    for term in terms:
        term.configure(values)
    mass = sp.diags(mesh.node_areas * DENSITY * values["thickness_m"]).tocsr()
    return System(mesh.nodes, mass, prescribed, [*terms, *extra], np.zeros(3), inertia=False, compliant=compliant)


@dataclass(frozen=True)
class Strip:
    """A strip along x from 0 to ``length``, centred across. ``ends``: nodes on the two end lines and beyond, bool
    ``(n,)`` each; ``lines``: those on the lines x = 0 and x = length alone."""

    system: System
    mesh: SheetMesh
    length: float
    width: float
    ends: tuple[np.ndarray, np.ndarray]
    lines: tuple[np.ndarray, np.ndarray]
    couple: Couple | None = None

    def spread(self, end: int) -> np.ndarray:
        """Shares of an end load on the nodes of an end line ``(n,)``, uniform along it."""
        out = np.zeros(len(self.mesh.nodes))
        nodes = np.flatnonzero(self.lines[end])
        out[nodes] = line_shares(self.mesh.nodes[nodes, 1])
        return out

    def middle(self) -> np.ndarray:
        """Nodes nearest to half the length, bool ``(n,)``."""
        away = np.abs(self.mesh.nodes[:, 0] - 0.5 * self.length)
        return np.asarray(away < away.min() + 1e-9 * self.length)

    def line(self, x: np.ndarray, at: float, reach: int = 4) -> tuple[np.ndarray, np.ndarray]:
        """Place [m] and unit tangent, ``(3,)`` each, of the line of the strip that was at ``at``, for nodes at ``x``:
        cubics through the nodes within ``reach`` mean cells."""
        away = self.mesh.nodes[:, 0] - at
        cell = np.sqrt(2.0 * self.length * self.width / len(self.mesh.triangles))
        far = reach * max(cell, self.length / len(np.unique(np.round(away / self.length, 6))))
        inside = (self.mesh.nodes[:, 0] > -1e-9) & (self.mesh.nodes[:, 0] < self.length * (1.0 + 1e-9))
        near = (np.abs(away) <= far) & inside
        basis = (away[near] / far)[:, None] ** np.arange(4)
        coefficients = np.linalg.lstsq(basis, x[near], rcond=None)[0]
        return coefficients[0], coefficients[1] / np.linalg.norm(coefficients[1])


def line_shares(along: np.ndarray) -> np.ndarray:
    """Share of a uniform line load on nodes at the places ``along`` ``(k,)``."""
    order = np.argsort(along)
    sides = np.diff(along[order], prepend=along[order[0]], append=along[order[-1]])
    shares = np.zeros(len(along))
    shares[order] = 0.5 * (sides[:-1] + sides[1:]) / np.ptp(along)
    return shares


def strip(
    length: float,
    width: float,
    values: Mapping[str, float],
    cells: tuple[int, int],
    pattern: str = "regular",
    ends: tuple[str, str] = ("clamped", "free"),
    place: Callable[[np.ndarray], np.ndarray] | None = None,
    couple: bool = False,
) -> Strip:
    """A static strip with two ends of the kinds of :data:`FIXED`; ``cells``: along and across.

    ``place``: where the share [0, 1] of the cells ends up along the strip, to make cells unequal. ``couple``: the
    second end, of the kind "turned", carries a couple about y (:class:`Couple`).
    """
    cell = length / cells[0]
    more = [kind in RIGID for kind in ends]
    low, high = -cell * more[0], length + cell * more[1]
    centre = 0.5 * (low + high)
    through = tuple(x - centre for x, rigid in zip((0.0, length), more, strict=True) if rigid)
    count = (cells[0] + sum(more), cells[1])
    mesh = rectangle(high - low, width, count, pattern, through_m=(through if pattern == "irregular" else (), ()))
    nodes = mesh.nodes + [centre, 0.0, 0.0]
    tiny = 1e-9 * length
    groups = (nodes[:, 0] < tiny, nodes[:, 0] > length - tiny)
    lines = (np.abs(nodes[:, 0]) < tiny, np.abs(nodes[:, 0] - length) < tiny)
    if place is not None:
        inside = ~(groups[0] | groups[1])
        nodes[inside, 0] = length * place(nodes[inside, 0] / length)
        step = length * float(place(np.array([cell / length]))[0])
        nodes[:, 0] = np.where(nodes[:, 0] < -tiny, nodes[:, 0] * step / cell, nodes[:, 0])
    mesh = SheetMesh(nodes, mesh.triangles)
    held = np.zeros(len(nodes), dtype=bool)
    prescribed = np.zeros((len(nodes), 3), dtype=bool)
    for kind, group, line in zip(ends, groups, lines, strict=True):
        held |= group & (kind in RIGID)
        for axis in FIXED[kind]:
            prescribed[group if kind in RIGID else line, axis] = True
    term = None
    if couple:
        inner = np.flatnonzero(lines[1])
        outer = np.flatnonzero(groups[1] & ~lines[1])
        outer = outer[np.abs(nodes[outer, 0] - nodes[:, 0].max()) < tiny]
        order = np.argsort(nodes[inner, 1]), np.argsort(nodes[outer, 1])
        pairs = np.column_stack([inner[order[0]], outer[order[1]]])
        term = Couple("couple", pairs, -ACROSS, line_shares(nodes[pairs[:, 0], 1]))
    loose = [
        Compliant(np.flatnonzero(group), np.full(3, FREE_M_PER_N))
        for kind, group in zip(ends, groups, strict=True)
        if kind == "driven"
    ]
    system = sheet_system(mesh, values, held, prescribed, [] if term is None else [term], loose)
    return Strip(system, mesh, length, width, groups, lines, term)


def rest(system: System) -> State:
    """The state at rest, in the shape that the system was built in."""
    return State(0.0, system.nodes, np.zeros_like(system.nodes), system.initial_internals())


def load_up(system: System, shares: int | Iterable[float], apply: Callable[[float], None]) -> State:
    """Equilibrium under a load that is put on by ``apply`` in equal parts, or share by share."""
    state = rest(system)
    for share in np.linspace(0.0, 1.0, shares + 1)[1:] if isinstance(shares, int) else shares:
        apply(float(share))
        state, _ = advance(system, state, system.nodes, 1.0)
    return state
