"""Vibrating square plates with known answers.

lambda = omega a^2 sqrt(rho h / D), by Ritz series of Legendre polynomials; Leissa, Vibration of Plates, NASA
SP-160, 1969. Edges: supported or clamped all around, or clamped along one of them (cantilever).
"""

from __future__ import annotations

import numpy as np

from sim_core.geometry.sheets import SheetMesh, rectangle
from sim_core.solve.modes import natural_vibrations
from sim_core.solve.system import System
from sim_core.validation.case import Case
from sim_core.validation.sheets import sheet_system

FREQUENCIES = {
    ("supported", 0.3): (19.739209, 49.348022, 49.348022, 78.956835),
    ("clamped", 0.3): (35.985191, 73.393847, 73.393847, 108.216507),
    ("cantilever", 0.0): (3.516015, 9.675739, 22.034492, 28.346688),
    ("cantilever", 0.3): (3.471137, 8.507062, 21.285814, 27.199000),
}
"""Edges and Poisson's ratio: lambda of the first four vibrations."""

SIDE, DENSITY = 0.1, 1000.0
SOURCE = "Leissa 1969, Ritz series"


def plate(edges: str, nu: float, pattern: str, cells: int) -> System:
    """A square plate of ``cells`` a side; clamped edges are cells that are held beyond it."""
    values = {"E_pa": 1e9, "nu": nu, "thickness_m": 5e-4}
    cell, half = SIDE / cells, 0.5 * SIDE
    irregular = pattern == "irregular"
    if edges == "supported":
        mesh = rectangle(SIDE, SIDE, (cells, cells), pattern)
        fixed = np.abs(mesh.nodes[:, :2]).max(axis=1) > half - 1e-9
        held = np.zeros(len(fixed), dtype=bool)
    elif edges == "clamped":
        lines = (-half, half) if irregular else ()
        mesh = rectangle(SIDE + 2 * cell, SIDE + 2 * cell, (cells + 2, cells + 2), pattern, through_m=(lines, lines))
        fixed = held = np.abs(mesh.nodes[:, :2]).max(axis=1) > half - 1e-9
    else:
        line = (-half + 0.5 * cell,) if irregular else ()
        mesh = rectangle(SIDE + cell, SIDE, (cells + 1, cells), pattern, through_m=(line, ()))
        mesh = SheetMesh(mesh.nodes + [-0.5 * cell, 0.0, 0.0], mesh.triangles)
        fixed = held = mesh.nodes[:, 0] < -half + 1e-9
    return sheet_system(mesh, values, held, np.repeat(fixed[:, None], 3, axis=1))


def frequencies(edges: str, nu: float, pattern: str, cells: int, count: int = 4) -> np.ndarray:
    """lambda of the slowest vibrations ``(count,)``."""
    omega, _ = natural_vibrations(plate(edges, nu, pattern, cells), count)
    h = 5e-4
    rigidity = 1e9 * h**3 / 12.0 / (1.0 - nu**2)
    return np.asarray(omega * SIDE**2 * np.sqrt(DENSITY * h / rigidity))


def plate_cases() -> list[Case]:
    """All comparisons of vibrating plates."""
    cases = []
    for (edges, nu), reference in FREQUENCIES.items():
        for pattern in ("regular", "irregular"):
            count = 32 if edges == "clamped" else 24
            found, coarser = (frequencies(edges, nu, pattern, n) for n in (count, count // 2))
            for k in (0, 1, 3):
                cases.append(
                    Case(
                        f"plate, {edges} edges, nu = {nu:g}", f"frequency {k + 1}", "lambda", reference[k],
                        float(found[k]), 0.02, f"{pattern} {count} x {count}", SOURCE, float(coarser[k]),
                    )
                )  # fmt: skip
    return cases
