"""A strip bent by couples: from the bar whose section turns the other way to the plate that bends as a cylinder.

A wide strip bent to the curvature k along x would bend by -nu k across, but that moves its edges off the neutral
surface, which stretches them. With the deflection w across, strain k w, and equilibrium D w'''' + E h k^2 w = 0, edges
free (w'' = -nu k, w''' = 0),

    M = integral of D (k + nu w'') + E h k w^2 over the width b

M / k goes from E b h^3 / 12 at small b^2 k / h to 1 / (1 - nu^2) times that. Lamb 1891; Ashwell, J. R. Aeronaut. Soc.
54, 1950.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.energies.bending import Bending
from sim_core.energies.couple import Couple
from sim_core.geometry.sheets import SheetMesh, rectangle
from sim_core.solve.step import advance
from sysid.validation.case import STATICS, Case, compare
from sysid.validation.specimens import ACROSS, line_shares, rest, sheet_system

LENGTH, WIDTH = 0.2, 0.05
SHEET = {"E_pa": 1e9, "nu": 0.4, "thickness_m": 5e-5}
STIFFNESS = SHEET["E_pa"] * WIDTH * SHEET["thickness_m"] ** 3 / 12.0
ASHWELL = (0.5, 10.0, 50.0, 200.0)
"""Values of b^2 k / h."""

SOURCE = "Lamb 1891, Ashwell 1950"


def ashwell(curvature: float, at: np.ndarray) -> tuple[float, np.ndarray]:
    """M / (k E b h^3 / 12), and the deflection w at the places ``at`` [m] across, over -nu k [m^2]."""
    nu, h, half = SHEET["nu"], SHEET["thickness_m"], 0.5 * WIDTH
    rigidity = SHEET["E_pa"] * h**3 / 12.0 / (1.0 - nu**2)
    a = (3.0 * (1.0 - nu**2) * curvature**2 / h**2) ** 0.25

    def shapes(y: np.ndarray, order: int) -> np.ndarray:
        """Derivatives of cosh cos and sinh sin, the real and imaginary parts of cosh((1 + i) a y)."""
        z = (1.0 + 1.0j) * a
        value = z**order * (np.cosh(z * y) if order % 2 == 0 else np.sinh(z * y))
        return np.stack([value.real, value.imag], axis=-1)

    edge = np.array(half)
    part = np.linalg.solve(np.stack([shapes(edge, 2), shapes(edge, 3)]), [-nu * curvature, 0.0])
    points, weights = np.polynomial.legendre.leggauss(60)
    y, weight = half * points, half * weights
    w, across = shapes(y, 0) @ part, shapes(y, 2) @ part
    density = rigidity * (curvature + nu * across) + SHEET["E_pa"] * h * curvature * w**2
    return float(weight @ density / (STIFFNESS * curvature)), -(shapes(at, 0) @ part) / (nu * curvature)


def bent_strip(pattern: str, cells: tuple[int, int]) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Answer and finding near each of the values of :data:`ASHWELL`: M / (k E b h^3 / 12), and the curvature
    across at the middle, from the deflection of nodes around it, over -nu k. Cells are smaller at the edges."""
    last = 0.5 * LENGTH - LENGTH / cells[0]
    through = (-last, last) if pattern == "irregular" else ()
    flat = rectangle(LENGTH, WIDTH, cells, pattern, through_m=(through, ()))
    nodes = flat.nodes.copy()
    ends: list[tuple[float, list[np.ndarray]]] = []
    for side in (-1.0, 1.0):
        rows = [np.flatnonzero(np.isclose(side * flat.nodes[:, 0], x)) for x in (last, 0.5 * LENGTH)]
        rows = [row[np.argsort(flat.nodes[row, 1])] for row in rows]
        ends.append((side, rows))
        for row in rows:  # lines of a couple that are askew would twist the strip
            nodes[row, 1] = np.linspace(-0.5, 0.5, len(row)) * WIDTH
    nodes[:, 1] = 0.5 * WIDTH * np.sin(0.45 * np.pi * nodes[:, 1] / (0.5 * WIDTH)) / np.sin(0.45 * np.pi)
    mesh = SheetMesh(nodes, flat.triangles)
    couples = []
    for side, rows in ends:
        shares = line_shares(nodes[rows[1], 1])
        couples.append(Couple(f"couple{side:+g}", np.column_stack(rows), -side * ACROSS, shares))
    prescribed = np.zeros((len(nodes), 3), dtype=bool)
    for place, axes in (((0.0, 0.0), (0, 1, 2)), ((0.25 * LENGTH, 0.0), (1, 2)), ((0.0, 0.25 * WIDTH), (2,))):
        node = np.argmin(np.linalg.norm(nodes[:, :2] - place, axis=1))
        prescribed[node, list(axes)] = True
    system = sheet_system(mesh, SHEET, np.zeros(len(nodes), dtype=bool), prescribed, couples)
    bending = next(term for term in system.terms if isinstance(term, Bending))
    centre = mesh.nodes[mesh.triangles].mean(axis=1)
    middle = np.abs(centre[:, 0]) < 0.1 * LENGTH
    near = (np.abs(nodes[:, 0]) < 0.1 * LENGTH) & (np.abs(nodes[:, 1]) < 0.2 * WIDTH)
    x, y = (2.0 * nodes[near, :2] / WIDTH).T
    fit = np.linalg.pinv(np.stack([y**2, x**2, y**4, x**4, x * y, y, x, np.ones_like(x)], axis=-1))[0]
    fit *= 2.0 / (0.5 * WIDTH) ** 2  # second derivative by y at the middle
    state, found, before = rest(system), [], ASHWELL[0]
    for value in ASHWELL:
        count = 1 + int(np.ceil(np.log(value / before) / np.log(1.7)))
        for part in np.geomspace(before, value, count):
            curvature = part * SHEET["thickness_m"] / WIDTH**2
            moment = ashwell(curvature, np.zeros(1))[0] * STIFFNESS * curvature
            for couple in couples:
                couple.configure({"moment_nm": moment})
            state, _ = advance(system, state, system.nodes, 1.0)
        before = value
        areas = mesh.areas[middle]
        along = abs(float(bending.curvatures_at(state.x)[middle, 0] @ areas / areas.sum()))
        ratio, deflection = ashwell(along, nodes[near, 1])
        across = float(fit @ state.x[near, 2]) / (SHEET["nu"] * along)
        found.append(((ratio, float(fit @ deflection)), (moment / (STIFFNESS * along), -across)))
    return found


def anticlastic_cases() -> Iterator[Case]:
    """All comparisons of strips bent by couples; solutions are those of the curvature that a mesh has."""
    for pattern in ("regular", "irregular"):
        meshes = [bent_strip(pattern, cells) for cells in ((40, 16), (80, 32))]
        for value, (others, theirs), (expected, ours) in zip(ASHWELL, *meshes, strict=True):
            runs = (np.add(expected, np.subtract(theirs, others)), ours)
            yield from compare(
                f"strip bent by couples, b^2 k/h = {value:g}",
                ("moment / curvature [E b h^3/12]", "curvature across [-nu k]"),
                expected, runs, STATICS, f"{pattern} 80 x 32", SOURCE, scale=1.0,
            )  # fmt: skip
