"""Square plates with known solutions: how they sag, and how they vibrate.

Centre deflection under uniform load in q a^4 / D: Timoshenko & Woinowsky-Krieger, Theory of Plates and Shells, 2nd
ed., tables 8 and 35; values by a Ritz series. Frequencies as lambda = omega a^2 sqrt(rho h / D), by Ritz series of
Legendre polynomials; Leissa, Vibration of Plates, NASA SP-160, 1969. Edges: supported or clamped all around, or
clamped along one of them (cantilever).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.geometry.sheets import SheetMesh, rectangle
from sim_core.solve.system import System
from sysid.validation.case import FREQUENCIES, STATICS, Case
from sysid.validation.small_motions import natural_vibrations
from sysid.validation.specimens import DENSITY, load_up, sheet_system

LAMBDA = {
    ("supported", 0.3): (19.739209, 49.348022, 49.348022, 78.956835),
    ("clamped", 0.3): (35.985191, 73.393847, 73.393847, 108.216507),
    ("cantilever", 0.0): (3.516015, 9.675739, 22.034492, 28.346688),
    ("cantilever", 0.3): (3.471137, 8.507062, 21.285814, 27.199000),
}
"""Edges and Poisson's ratio: lambda of the first four vibrations."""

SAG = {"supported": 0.00406235, "clamped": 0.00126532}
"""Edges: centre deflection over q a^4 / D at nu = 0.3."""

SIDE, THICKNESS, MODULUS = 0.1, 5e-4, 1e9
LEISSA = "Leissa 1969, Ritz series"
TIMOSHENKO = "Timoshenko & Woinowsky-Krieger, Ritz series"


def plate(edges: str, nu: float, pattern: str, cells: int) -> System:
    """A square plate of ``cells`` a side; clamped edges are cells that are held beyond it."""
    values = {"E_pa": MODULUS, "nu": nu, "thickness_m": THICKNESS}
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


def rigidity(nu: float) -> float:
    """Bending stiffness D [N m]."""
    return MODULUS * THICKNESS**3 / 12.0 / (1.0 - nu**2)


def sag(edges: str, pattern: str, cells: int) -> float:
    """Centre deflection over q a^4 / D under a small uniform load."""
    system = plate(edges, 0.3, pattern, cells)
    pressure = 1e-3 * THICKNESS * rigidity(0.3) / SIDE**4 / SAG[edges]
    areas = system.mass.diagonal() / (DENSITY * THICKNESS)

    def apply(share: float) -> None:
        system.loads[:, 2] = share * pressure * areas

    state = load_up(system, 1, apply)
    centre = np.argmin(np.linalg.norm(system.nodes, axis=1))
    return float(state.x[centre, 2] * rigidity(0.3) / (pressure * SIDE**4))


def frequencies(edges: str, nu: float, pattern: str, cells: int, count: int = 4) -> np.ndarray:
    """lambda of the slowest vibrations ``(count,)``."""
    omega, _ = natural_vibrations(plate(edges, nu, pattern, cells), count)
    return np.asarray(omega * SIDE**2 * np.sqrt(DENSITY * THICKNESS / rigidity(nu)))


def plate_cases() -> Iterator[Case]:
    """All comparisons of plates."""
    for edges, reference in SAG.items():
        for pattern in ("regular", "crossed", "irregular"):
            *coarser, centre = (sag(edges, pattern, n) for n in (20, 40, 80))
            yield Case(
                f"square plate, {edges} edges", "centre deflection", "q a^4/D", reference, centre, STATICS,
                f"{pattern} 80 x 80", TIMOSHENKO, tuple(coarser),
            )  # fmt: skip
    for (edges, nu), references in LAMBDA.items():
        for pattern in ("regular", "irregular"):
            count = 32 if edges == "clamped" else 24
            found, wider = (frequencies(edges, nu, pattern, n) for n in (count, count // 2))
            for k in (0, 1, 3):
                yield Case(
                    f"plate, {edges} edges, nu = {nu:g}", f"frequency {k + 1}", "lambda", references[k],
                    float(found[k]), FREQUENCIES, f"{pattern} {count} x {count}", LEISSA, (float(wider[k]),),
                )  # fmt: skip
