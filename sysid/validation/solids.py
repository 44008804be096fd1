"""Blocks and discs of gel with known solutions: the law itself, locking, relaxation.

Homogeneous deformation of the law of :mod:`sim_core.energies.neo_hookean` (compressible), nominal stress over mu at
the stretch l: with one free pair of sides J = 1 + (1 - 2 nu)(1 - 1/l) and P = l - J / l^2 (uniaxial); with two equal
stretches P = l - l_z^2 / l, l_z = l^2 (lambda + 2 mu) / (mu + (lambda + mu) l^4). Both tend to the incompressible
l - l^-2 and l - l^-5. Simple shear by g: tau = mu g and sigma_11 - sigma_22 = mu g^2, exactly, at any nu (Ogden,
Non-Linear Elastic Deformations, 1984, sec. 4.4).

A disc between two plates that it is bonded to: the apparent modulus grows with the shape factor S = R / 2t, towards
E (1 + 2 S^2) of an incompressible disc (Gent & Lindley 1959, an approximation); the values here are of linear
elasticity, by elements of degree 8 (six digits; ``tests/validation/axisymmetric.py``). Elements that lock overshoot.

A layer sheared between two plates: F = G A u / h, and markers move in proportion to their height. Held so, with one
relaxing branch, F(t) / F(0) = 1 - g (1 - exp(-t / tau)).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

from sim_core.effects.base import Values
from sim_core.effects.registry import effect_by_name
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.strain import SolidStrain
from sim_core.energies.strain_law import StrainLaws
from sim_core.energies.term import Term
from sim_core.geometry import tet10
from sim_core.geometry.solids import TetMesh, block, cylinder
from sim_core.solve.step import advance, exerted
from sim_core.solve.system import System
from sysid.validation.case import FORCES, STATICS, Case
from sysid.validation.specimens import rest

MODULUS, SIDE = 2e5, 0.01
DISC = {(0.3, 1.0): 1.210695, (0.49, 1.0): 2.633717, (0.49, 2.5): 7.021500}
"""Poisson's ratio and shape factor: apparent modulus over E."""

LAW = "closed form of the compressible law"
LIMIT = "incompressible neo-Hookean"
GENT = "bonded disc, linear elasticity by hp finite elements"
SIMO = "Simo 1987, one Prony branch"


def lame(nu: float) -> tuple[float, float]:
    """lambda and mu [Pa]."""
    return MODULUS * nu / (1.0 + nu) / (1.0 - 2.0 * nu), MODULUS / 2.0 / (1.0 + nu)


def solid_system(mesh: TetMesh, nu: float, prescribed: np.ndarray, relaxation: Values | None = None) -> System:
    """A static solid; ``relaxation``: the numbers of a branch that relaxes."""
    elastic, empty = NeoHookean("gel", mesh.tets, mesh.nodes), sp.csr_matrix((len(mesh.nodes),) * 2)
    elastic.configure({"E_pa": MODULUS, "nu": nu})
    terms: list[Term] = [elastic]
    if relaxation is not None:
        laws = StrainLaws("gel_laws", SolidStrain(elastic))
        laws.add("branch", effect_by_name("gel_relaxation"))
        laws.configure({f"branch.{name}": value for name, value in relaxation.items()})
        terms.append(laws)
    return System(mesh.nodes, empty, prescribed, terms, np.zeros(3), inertia=False)


def distorted_block(cells: int = 2) -> TetMesh:
    """A cube whose inner corners are moved at random, edges straight."""
    mesh = block((SIDE, SIDE, SIDE), (cells, cells, cells))
    nodes = mesh.nodes.copy()
    corners = np.unique(mesh.tets[:, :4])
    inner = np.setdiff1d(corners, np.unique(mesh.surface))
    nodes[inner] += 0.2 * SIDE / cells * np.random.default_rng(3).uniform(-1.0, 1.0, (len(inner), 3))
    nodes[mesh.tets[:, 4:]] = 0.5 * nodes[mesh.tets[:, tet10.EDGES]].sum(axis=2)
    return TetMesh(nodes, mesh.tets, mesh.surface, mesh.face_sets)


def mean_stress(system: System, volume: float) -> np.ndarray:
    """Mean first Piola-Kirchhoff stress [Pa] ``(3, 3)``: sum of f X^T over the nodes, over the volume."""
    return np.asarray(exerted(system).T @ system.nodes / volume)


def stretched(nu: float, stretches: tuple[float | None, ...], parts: int = 5) -> np.ndarray:
    """Nominal stress over mu ``(3, 3)`` of a block with these stretches along x, y, z (None: its sides are free)."""
    mesh = distorted_block()
    prescribed = np.zeros((len(mesh.nodes), 3), dtype=bool)
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    for axis, stretch in enumerate(stretches):
        prescribed[:, axis] = mesh.nodes[:, axis] < low[axis] + 1e-9
        if stretch is not None:
            prescribed[:, axis] |= mesh.nodes[:, axis] > high[axis] - 1e-9
    system = solid_system(mesh, nu, prescribed)
    state = rest(system)
    whole = np.array([1.0 if s is None else s for s in stretches])
    for part in np.linspace(0.0, 1.0, parts + 1)[1:]:
        targets = low + (mesh.nodes - low) * (1.0 + part * (whole - 1.0))
        state, _ = advance(system, state, targets, 1.0)
    return mean_stress(system, SIDE**3) / lame(nu)[1]


def sheared(nu: float, shear: float) -> np.ndarray:
    """Cauchy stress over mu ``(3, 3)`` of a block in simple shear: all of its surface moves by g z along x."""
    mesh = distorted_block()
    prescribed = np.zeros((len(mesh.nodes), 3), dtype=bool)
    prescribed[np.unique(mesh.surface)] = True
    system = solid_system(mesh, nu, prescribed)
    gradient = np.eye(3)
    gradient[0, 2] = shear
    advance(system, rest(system), mesh.nodes @ gradient.T, 1.0)
    return np.asarray(mean_stress(system, SIDE**3) @ gradient.T / lame(nu)[1])


def layer(
    nu: float, cells: tuple[int, int], shear: float, relaxation: Values | None = None
) -> tuple[System, np.ndarray, np.ndarray]:
    """A layer 4 times as long as thick, its lower and its upper plane held, its ends kept from tilting up; the
    positions to which the planes are sheared; and the nodes of the upper plane."""
    mesh = block((4.0 * SIDE, SIDE, SIDE), (cells[0], 2, cells[1]))
    prescribed = np.zeros((len(mesh.nodes), 3), dtype=bool)
    for plane in ("bottom", "top"):
        prescribed[mesh.node_sets[plane]] = True
    for end in ("x_min", "x_max"):
        prescribed[mesh.node_sets[end], 2] = True
    targets = mesh.nodes.copy()
    targets[:, 0] += shear * targets[:, 2]
    return solid_system(mesh, nu, prescribed, relaxation), targets, mesh.node_sets["top"]


def sheared_layer(nu: float, cells: tuple[int, int], shear: float = 0.02) -> tuple[float, float]:
    """F h / (G A u), and the largest departure of a marker's motion from the linear profile, over u."""
    system, targets, top = layer(nu, cells, shear)
    state, _ = advance(system, rest(system), targets, 1.0)
    force = float(exerted(system)[top, 0].sum())
    stray = np.abs(state.x - targets).max() / (shear * SIDE)
    return force / (lame(nu)[1] * 4.0 * SIDE**2 * shear), float(stray)


def relaxation(share: float, tau: float, times: list[float], dt: float) -> list[float]:
    """F(t) / F(0) of a layer that is sheared at once and held, at multiples of ``dt`` [s]."""
    system, targets, top = layer(0.45, (4, 2), 0.02, {"share": share, "tau_s": tau})
    state, _ = advance(system, rest(system), targets, 1e-6 * tau)
    first = float(exerted(system)[top, 0].sum())
    found = {}
    for k in range(1, round(max(times) / dt) + 1):
        state, _ = advance(system, state, targets, dt)
        found[k] = float(exerted(system)[top, 0].sum()) / first
    return [found[round(t / dt)] for t in times]


def bonded_disc(nu: float, shape_factor: float, cells: tuple[int, int, int]) -> float:
    """Apparent modulus over E of a disc between two plates that it is bonded to."""
    height = SIDE / (2.0 * shape_factor)
    mesh = cylinder(SIDE, height, cells)
    prescribed = np.zeros((len(mesh.nodes), 3), dtype=bool)
    for plane in ("bottom", "top"):
        prescribed[mesh.node_sets[plane]] = True
    system = solid_system(mesh, nu, prescribed)
    targets = mesh.nodes.copy()
    targets[mesh.node_sets["top"], 2] -= 1e-4 * height
    advance(system, rest(system), targets, 1.0)
    force = -float(exerted(system)[mesh.node_sets["top"], 2].sum())
    return force / (np.pi * SIDE**2 * MODULUS * 1e-4)


def solid_cases() -> Iterator[Case]:
    """All comparisons of blocks and discs."""
    mesh = "2 x 2 x 2, distorted"
    for nu in (0.3, 0.45, 0.499):
        lam, mu = lame(nu)
        for stretch in (0.7, 1.5):
            found = float(stretched(nu, (stretch, None, None))[0, 0])
            exact = stretch - (1.0 + (1.0 - 2.0 * nu) * (1.0 - 1.0 / stretch)) / stretch**2
            name = f"uniaxial stretch {stretch:g}, nu = {nu:g}"
            yield Case(name, "nominal stress", "mu", exact, found, STATICS, mesh, LAW)
            if nu > 0.49:
                yield Case(name, "nominal stress", "mu", stretch - stretch**-2, found, STATICS, mesh, LIMIT)
        stretch = 1.3
        found = float(stretched(nu, (stretch, stretch, None))[0, 0])
        across = stretch**2 * (lam + 2.0 * mu) / (mu + (lam + mu) * stretch**4)
        name = f"equibiaxial stretch {stretch:g}, nu = {nu:g}"
        yield Case(name, "nominal stress", "mu", stretch - across**2 / stretch, found, STATICS, mesh, LAW)
        if nu > 0.49:
            yield Case(name, "nominal stress", "mu", stretch - stretch**-5, found, STATICS, mesh, LIMIT)
        stress = sheared(nu, 0.5)
        name = f"simple shear 0.5, nu = {nu:g}"
        yield Case(name, "shear stress", "mu", 0.5, float(stress[0, 2]), STATICS, mesh, LAW)
        difference = float(stress[0, 0] - stress[2, 2])
        yield Case(name, "normal stress difference", "mu", 0.25, difference, STATICS, mesh, LAW)
    for nu in (0.3, 0.49):
        force, stray = sheared_layer(nu, (8, 2))
        name, mesh = f"bonded layer in shear, nu = {nu:g}", "8 x 2 x 2 quadratic"
        yield Case(name, "force", "G A u/h", 1.0, force, STATICS, mesh, "linear elasticity")
        yield Case(
            name, "departure of markers from a line", "u", 0.0, stray, STATICS, mesh, "linear elasticity", scale=1.0
        )
    times = [0.25, 0.5, 1.0, 2.0]
    for t, found in zip(times, relaxation(0.4, 0.5, times, 0.125), strict=True):
        exact = 1.0 - 0.4 * (1.0 - np.exp(-t / 0.5))
        yield Case(f"relaxation, t = {t / 0.5:g} tau", "F(t)/F(0)", "1", exact, found, STATICS, "4 x 2 x 2", SIMO)
    for (nu, shape), reference in DISC.items():
        fine, coarse = bonded_disc(nu, shape, (6, 3, 6)), bonded_disc(nu, shape, (4, 2, 4))
        yield Case(
            f"bonded disc, S = {shape:g}, nu = {nu:g}", "apparent modulus", "E", reference, fine, FORCES,
            "(6, 3, 6) quadratic", GENT, (coarse,), ratio=1.5,
        )  # fmt: skip
