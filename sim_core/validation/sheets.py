"""Sheets with known answers: elasticas and plates.

Heavy elastica: a strip held horizontally at one end sags under its own weight,
B theta'' = -w (L - s) cos(theta), depending on Gamma = w L^3 / B alone (w weight per length). Romero et al.,
ACM Trans. Graph. 40(4), 2021; values by integration of the boundary value problem.

Tip load: B theta'' = -P cos(theta), Bisshopp & Drucker, Quart. Appl. Math. 3, 1945; Mattiasson, Int. J. Numer.
Meth. Eng. 17, 1981; values by integration, equal to the printed ones.

Plates: centre deflection under uniform load in q a^4 / D, Timoshenko & Woinowsky-Krieger, Theory of Plates and
Shells, 2nd ed., tables 8 and 35; values by a Ritz series.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.energies.term import Term
from sim_core.geometry.sheets import SheetMesh, rectangle
from sim_core.solve.step import State, advance
from sim_core.solve.system import System
from sim_core.validation.case import Case

HEAVY = {1.0: (0.123471, 0.991246), 10.0: (0.7002, 0.656354), 100.0: (0.937524, 0.159223)}
"""Gamma: tip drop and horizontal reach over the length."""

TIP = {1.0: (0.301721, 0.0564332), 5.0: (0.713792, 0.387628), 10.0: (0.810609, 0.554996)}
"""P L^2 / B: tip deflection and shortening over the length."""

PLATE = {"supported": 0.00406235, "clamped": 0.00126532}
"""Edges: centre deflection over q a^4 / D at nu = 0.3."""

HEAVY_QUANTITIES, TIP_QUANTITIES = ("drop / length", "reach / length"), ("deflection / length", "shortening / length")
STRIP = {"E_pa": 1e9, "nu": 0.0, "thickness_m": 2e-4}
LENGTH, WIDTH, DENSITY = 0.2, 0.02, 1000.0
ROMERO = "Romero et al. 2021, boundary value problem"
MATTIASSON = "Mattiasson 1981, boundary value problem"
TIMOSHENKO = "Timoshenko & Woinowsky-Krieger, Ritz series"


def sheet_system(mesh: SheetMesh, values: dict[str, float], held: np.ndarray, prescribed: np.ndarray) -> System:
    """A static sheet; ``held``: nodes in one rigid clamp."""
    axis = np.array([1.0, 0.0, 0.0])
    terms: list[Term] = [
        Membrane("membrane", mesh.nodes, mesh.triangles, axis),
        Bending("bending", mesh, 0, axis, held=held),
    ]
    for term in terms:
        term.configure(values)
    mass = sp.diags(mesh.node_areas * DENSITY * values["thickness_m"]).tocsr()
    return System(mesh.nodes, mass, prescribed, terms, np.zeros(3), inertia=False)


def cantilever(pattern: str, cells: tuple[int, int]) -> tuple[System, np.ndarray]:
    """A strip along x from its clamp at x = 0, one column of cells within the clamp; and its tip's nodes."""
    cell = LENGTH / cells[0]
    line = (-0.5 * LENGTH + 0.5 * cell,) if pattern == "irregular" else ()
    mesh = rectangle(LENGTH + cell, WIDTH, (cells[0] + 1, cells[1]), pattern, through_m=(line, ()))
    mesh = SheetMesh(mesh.nodes + [0.5 * (LENGTH - cell), 0.0, 0.0], mesh.triangles)
    held = mesh.nodes[:, 0] < 1e-9
    tip = np.isclose(mesh.nodes[:, 0], LENGTH)
    return sheet_system(mesh, STRIP, held, np.repeat(held[:, None], 3, axis=1)), tip


def load_up(system: System, steps: int, apply: Callable[[float], None]) -> State:
    """Equilibrium under a load that is put on in equal parts."""
    state = State(0.0, system.nodes, np.zeros_like(system.nodes), system.initial_internals())
    for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
        apply(float(share))
        state, _ = advance(system, state, system.nodes, 1.0)
    return state


def heavy_strip(gamma: float, pattern: str, cells: tuple[int, int]) -> tuple[float, float]:
    """Drop and reach of the tip over the length."""
    system, tip = cantilever(pattern, cells)
    gravity = gamma * STRIP["E_pa"] * STRIP["thickness_m"] ** 2 / 12.0 / (DENSITY * LENGTH**3)

    def apply(share: float) -> None:
        system.gravity = np.array([0.0, 0.0, -gravity * share])

    end = load_up(system, 3 + int(gamma**0.5), apply).x[tip].mean(axis=0)
    return float(-end[2] / LENGTH), float(end[0] / LENGTH)


def tip_loaded_strip(alpha: float, pattern: str, cells: tuple[int, int]) -> tuple[float, float]:
    """Deflection and shortening of the tip over the length."""
    system, tip = cantilever(pattern, cells)
    stiffness = STRIP["E_pa"] * WIDTH * STRIP["thickness_m"] ** 3 / 12.0
    edge = system.nodes[tip, 1]
    order = np.argsort(edge)
    reach = np.diff(edge[order], prepend=edge[order[0]], append=edge[order[-1]])
    spread = np.zeros(len(edge))
    spread[order] = (reach[:-1] + reach[1:]) / (2.0 * WIDTH)

    def apply(share: float) -> None:
        system.loads[tip, 2] = -share * alpha * stiffness / LENGTH**2 * spread

    end = load_up(system, 4, apply).x[tip].mean(axis=0)
    return float(-end[2] / LENGTH), float(1.0 - end[0] / LENGTH)


def square_plate(edges: str, pattern: str, cells: int) -> float:
    """Centre deflection over q a^4 / D of a square plate under a small uniform load.

    Clamped edges are a frame of cells that is held.
    """
    side, values = 0.1, {"E_pa": 1e9, "nu": 0.3, "thickness_m": 1e-3}
    cell = side / cells
    if edges == "clamped":
        line = (-0.5 * side, 0.5 * side) if pattern == "irregular" else ()
        mesh = rectangle(side + 2 * cell, side + 2 * cell, (cells + 2, cells + 2), pattern, through_m=(line, line))
        rim = np.abs(mesh.nodes[:, :2]).max(axis=1) > 0.5 * side - 1e-9
        system = sheet_system(mesh, values, rim, np.repeat(rim[:, None], 3, axis=1))
    else:
        mesh = rectangle(side, side, (cells, cells), pattern)
        rim = np.abs(mesh.nodes[:, :2]).max(axis=1) > 0.5 * side - 1e-9
        prescribed = np.repeat(rim[:, None], 3, axis=1)
        system = sheet_system(mesh, values, np.zeros(len(rim), dtype=bool), prescribed)
    stiffness = values["E_pa"] * values["thickness_m"] ** 3 / 12.0 / (1.0 - values["nu"] ** 2)
    pressure = 1e-3 * values["thickness_m"] * stiffness / side**4 / PLATE[edges]

    def apply(share: float) -> None:
        system.loads[:, 2] = share * pressure * mesh.node_areas

    state = load_up(system, 1, apply)
    centre = np.argmin(np.linalg.norm(mesh.nodes, axis=1))
    return float(state.x[centre, 2] * stiffness / (pressure * side**4))


def sheet_cases() -> list[Case]:
    """All comparisons of sheets."""
    cases = []
    meshes = (("regular", (40, 4)), ("irregular", (40, 4)), ("crossed", (80, 2)))
    for gamma, reference in HEAVY.items():
        for pattern, cells in meshes:
            found = heavy_strip(gamma, pattern, cells)
            coarser = heavy_strip(gamma, pattern, (cells[0] // 2, cells[1] // 2))
            for quantity, ref, value, twice in zip(HEAVY_QUANTITIES, reference, found, coarser, strict=True):
                cases.append(
                    Case(
                        f"heavy elastica, Gamma = {gamma:g}", quantity, "1", ref, value, 0.01,
                        f"{pattern} {cells[0]} x {cells[1]}", ROMERO, twice,
                    )
                )  # fmt: skip
    for alpha, reference in TIP.items():
        found = tip_loaded_strip(alpha, "regular", (40, 4))
        for quantity, ref, value in zip(TIP_QUANTITIES, reference, found, strict=True):
            cases.append(
                Case(f"tip load, P L^2/B = {alpha:g}", quantity, "1", ref, value, 0.01, "regular 40 x 4", MATTIASSON)
            )
    for edges, ref in PLATE.items():
        count = 20 if edges == "supported" else 32
        for pattern in ("regular", "crossed", "irregular"):
            value, twice = (square_plate(edges, pattern, n) for n in (count, count // 2))
            cases.append(
                Case(
                    f"square plate, {edges} edges", "centre deflection", "q a^4/D", ref, value, 0.02,
                    f"{pattern} {count} x {count}", TIMOSHENKO, twice,
                )
            )  # fmt: skip
    return cases
