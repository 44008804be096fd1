"""Rayleigh damping of single vibrations, of free flight and of free rotation, stepped by BDF2.

A vibration of the angular frequency w with the damping ratio zeta = alpha / (2 w) + beta w / 2 falls from one maximum
to the next by the logarithmic decrement 2 pi zeta / sqrt(1 - zeta^2) (Clough & Penzien, Dynamics of Structures, 2nd
ed., sec. 2-4 and 12-4). The frequencies are those of theory: a cantilever, w = 1.8751^2 sqrt(B / (rho h)) / L^2; a
bar that is held at one end and along its sides, w = pi/2 sqrt(M / rho) / L with the modulus M of confined stretch.

A body in free flight loses its momentum like exp(-alpha t). One that turns freely has no rate of strain, so that beta
leaves its angular momentum alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import scipy.sparse as sp

from sim_core.energies.bending import Bending
from sim_core.energies.mass_damping import MassDamping
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.term import Term
from sim_core.geometry.sheets import rectangle
from sim_core.geometry.solids import block, consistent_mass
from sim_core.solve.step import NewtonSettings, State, advance
from sim_core.solve.system import System
from sysid.validation.case import FREQUENCIES, Case
from sysid.validation.small_motions import natural_vibrations

TIGHT = NewtonSettings(step_tolerance_m=1e-12, force_tolerance=1e-9)
LENGTH, WIDTH = 0.1, 0.02
SHEET, DENSITY = {"E_pa": 1e9, "nu": 0.0, "thickness_m": 1e-3}, 1000.0
GEL = {"E_pa": 1e5, "nu": 0.3}
STEPS = 100
"""Steps of one period."""

RATIO = 0.05
RAYLEIGH = "Clough & Penzien, Rayleigh damping"
X_AXIS = np.array([1.0, 0.0, 0.0])


def sheet(cells: tuple[int, int], held: str, alpha: float = 0.0, beta: float = 0.0) -> System:
    """A strip along x; ``held``: "clamped" in the plane of its end, "bar" (no motion but along x) or "free"."""
    cell = LENGTH / cells[0]
    extra = 1 if held == "clamped" else 0
    mesh = rectangle(LENGTH + extra * cell, WIDTH, (cells[0] + extra, cells[1]), "regular")
    at = mesh.nodes[:, 0] - mesh.nodes[:, 0].min()
    gripped = (at < (extra + 1e-6) * cell) & (held != "free")
    prescribed = np.repeat(gripped[:, None], 3, axis=1)
    if held == "bar":
        prescribed[:, 1:] = True
    clamp = gripped if held == "clamped" else None
    terms: list[Term] = [
        Membrane("membrane", mesh.nodes, mesh.triangles, X_AXIS),
        Bending("bending", mesh, 0, X_AXIS, held=clamp),
    ]
    areas = sp.diags(mesh.node_areas).tocsr()
    values = {**SHEET, "stiffness_damping_s": beta}
    return _damped(mesh.nodes, areas, DENSITY * SHEET["thickness_m"], prescribed, terms, values, alpha)


def gel_bar(cells: int, alpha: float = 0.0, beta: float = 0.0, free: bool = False) -> System:
    """A bar of gel along x, held at one end, whose sides are guided (or ``free``)."""
    mesh = block((LENGTH, WIDTH, WIDTH), (cells, 1, 1))
    prescribed = np.ones((len(mesh.nodes), 3), dtype=bool)
    prescribed[:, 0] = mesh.nodes[:, 0] < mesh.nodes[:, 0].min() + 1e-9
    prescribed &= not free
    terms: list[Term] = [NeoHookean("gel", mesh.tets, mesh.nodes)]
    values = {**GEL, "stiffness_damping_s": beta}
    return _damped(mesh.nodes, consistent_mass(mesh), DENSITY, prescribed, terms, values, alpha)


def _damped(
    nodes: np.ndarray,
    unit_mass: sp.csr_matrix,
    density: float,
    prescribed: np.ndarray,
    terms: list[Term],
    values: Mapping[str, float],
    alpha: float,
) -> System:
    """A system of one body with the stiffness damping in ``values`` and the mass damping ``alpha``."""
    for term in terms:
        term.configure(values)
    drag = MassDamping("mass_damping", unit_mass, 0, np.logical_not(prescribed.all(axis=1)))
    drag.configure({"mass_damping_per_s": alpha, "density": density})
    mass = (density * unit_mass).tocsr()
    return System(nodes, mass, prescribed, [*terms, drag], np.zeros(3), second_order=True)


def decrement(system: System, shape: np.ndarray, omega: float) -> float:
    """Mean logarithmic decrement over two periods of a small vibration in the ``shape`` ``(n, 3)``, let go at rest."""
    shape = 1e-4 * LENGTH * shape / np.abs(shape).max()
    x = system.nodes + shape
    state = State(0.0, x, np.zeros_like(x), system.initial_internals())
    weights, found = system.mass @ shape, []
    for _ in range(round(3.5 * STEPS)):
        state, _ = advance(system, state, system.nodes, 2.0 * np.pi / omega / STEPS, TIGHT)
        found.append(float(np.vdot(weights, state.x - system.nodes)))
    q = np.array(found)
    top = [k for k in range(1, len(q) - 1) if q[k - 1] < q[k] >= q[k + 1] and q[k] > 0.0]
    peaks = [q[k] + 0.125 * (q[k + 1] - q[k - 1]) ** 2 / (2.0 * q[k] - q[k - 1] - q[k + 1]) for k in top]
    return float(np.log(peaks[0] / peaks[2]) / 2.0)


def expected(omega: float, alpha: float, beta: float) -> float:
    """The decrement of theory."""
    zeta = 0.5 * alpha / omega + 0.5 * beta * omega
    return float(2.0 * np.pi * zeta / np.sqrt(1.0 - zeta**2))


def vibrations() -> dict[str, tuple[System, float]]:
    """Undamped specimens and the angular frequencies [rad/s] that theory gives their slowest vibration."""
    bending = SHEET["E_pa"] * SHEET["thickness_m"] ** 2 / 12.0 / DENSITY
    confined = GEL["E_pa"] * (1.0 - GEL["nu"]) / (1.0 + GEL["nu"]) / (1.0 - 2.0 * GEL["nu"])
    return {
        "cantilever, first bending mode": (sheet((20, 2), "clamped"), 1.8751041**2 * np.sqrt(bending) / LENGTH**2),
        "strip, first axial mode": (sheet((20, 2), "bar"), 0.5 * np.pi * np.sqrt(SHEET["E_pa"] / DENSITY) / LENGTH),
        "bar of gel, first axial mode": (gel_bar(8), 0.5 * np.pi * np.sqrt(confined / DENSITY) / LENGTH),
    }


def damped(name: str, alpha: float, beta: float) -> System:
    """A specimen of :func:`vibrations` with damping."""
    if name.startswith("bar"):
        return gel_bar(8, alpha, beta)
    return sheet((20, 2), "clamped" if name.startswith("cantilever") else "bar", alpha, beta)


def spun(beta: float, turns: float = 1.0) -> tuple[float, float]:
    """Angular momentum [kg m^2/s] of a free strip that spins about y, before and after ``turns``."""
    system = sheet((8, 2), "free", 0.0, beta)
    rate, count = 20.0, 60
    x = system.nodes.copy()
    v = np.cross([0.0, rate, 0.0], x)
    state = State(0.0, x, v, system.initial_internals())
    for _ in range(round(turns * count)):
        state, _ = advance(system, state, system.nodes, 2.0 * np.pi / rate / count, TIGHT)
    before, after = (float(np.cross(a, system.mass @ b).sum(axis=0)[1]) for a, b in ((x, v), (state.x, state.v)))
    return before, after


def flown(alpha: float, steps: int = 100) -> float:
    """Share of its momentum that a free strip has after the time 1 / alpha, without weight."""
    system = sheet((4, 1), "free", alpha)
    v = np.tile([1.0, -0.5, 0.3], (len(system.nodes), 1))
    state = State(0.0, system.nodes.copy(), v, system.initial_internals())
    for _ in range(steps):
        state, _ = advance(system, state, system.nodes, 1.0 / alpha / steps, TIGHT)
    return float(np.linalg.norm(system.mass @ state.v) / np.linalg.norm(system.mass @ v))


def damping_cases() -> Iterator[Case]:
    """All comparisons of damped bodies."""
    for name, (system, omega) in vibrations().items():
        shape = natural_vibrations(system, 1)[1][0]
        kinds = {
            "alpha": (2.0 * RATIO * omega, 0.0),
            "beta": (0.0, 2.0 * RATIO / omega),
            "both": (RATIO * omega, RATIO / omega),
        }
        for kind, (alpha, beta) in kinds.items():
            found = decrement(damped(name, alpha, beta), shape, omega)
            yield Case(
                f"{name}, {kind}", f"logarithmic decrement at zeta = {RATIO:g}", "1", expected(omega, alpha, beta),
                found, FREQUENCIES, f"{STEPS} steps a period", RAYLEIGH,
            )  # fmt: skip
    yield Case(
        "free flight, alpha", "momentum after 1 / alpha", "1", float(np.exp(-1.0)), flown(5.0), FREQUENCIES,
        "100 steps", "closed form",
    )  # fmt: skip
    start, undamped = spun(0.0)
    lost = (undamped - spun(0.05)[1]) / start
    yield Case(
        "free strip that turns once, beta", "angular momentum lost by damping", "of the whole", 0.0, lost, 1e-6,
        "60 steps a turn", "invariance", scale=1.0,
    )  # fmt: skip
