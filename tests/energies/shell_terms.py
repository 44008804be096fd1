"""Sheets and differences for the tests of the shell energies."""

import numpy as np
import scipy.sparse as sp

from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.geometry.sheets import SheetMesh, rectangle
from sim_core.solve.system import System

X_AXIS = np.array([1.0, 0.0, 0.0])
PAPER = {"E_pa": 2.0e9, "nu": 0.3, "thickness_m": 2e-4}
ORTHOTROPIC = {**PAPER, "anisotropy_ratio": 2.5, "grain_angle_rad": 0.6}


def alone(term, nodes):
    """A system of one term whose nodes are all free, without inertia and gravity."""
    count = len(nodes)
    free = np.zeros((count, 3), dtype=bool)
    return System(nodes, sp.csr_matrix((count, count)), free, [term], np.zeros(3), inertia=False)


def membrane(mesh, parameters=PAPER):
    term = Membrane("membrane", mesh.nodes, mesh.triangles, X_AXIS)
    term.configure(parameters)
    return alone(term, mesh.nodes), term


def bending(mesh, parameters=PAPER, **options):
    term = Bending("bending", mesh, 0, X_AXIS, **options)
    term.configure(parameters)
    return alone(term, mesh.nodes), term


def rolled(mesh, curvature, direction=0.0):
    """Positions of a flat mesh rolled onto a cylinder without stretching, about an axis at ``direction``
    [rad] from y."""
    c, s = np.cos(direction), np.sin(direction)
    along, across = mesh.nodes[:, :2] @ [c, s], mesh.nodes[:, :2] @ [-s, c]
    u, w = np.sin(curvature * along) / curvature, (1.0 - np.cos(curvature * along)) / curvature
    return np.column_stack([c * u - s * across, s * u + c * across, w])


def strip(pattern, cells=(10, 4), length=0.05, width=0.02):
    return rectangle(length, width, cells, pattern)


def full(upper):
    """Symmetric dense matrix from its upper triangle."""
    dense = upper.toarray()
    return dense + np.triu(dense, 1).T


def check_derivatives(system, x, h=1e-8, tolerance=2e-6, seed=0):
    """Energy, residual and exact Hessian of a system against central differences at ``x``."""
    rng = np.random.default_rng(seed)
    system.x[:] = x
    unknowns = system.unknowns()
    direction = rng.standard_normal(unknowns.size)

    def at(shift):
        system.set_unknowns(unknowns + shift * direction)
        return system.energy(), system.residual().copy()

    e_plus, g_plus = at(h)
    e_minus, g_minus = at(-h)
    system.set_unknowns(unknowns)
    slope = float(system.residual() @ direction)
    hessian = full(system.hessian(exact=True))
    difference = (e_plus - e_minus) / (2.0 * h)
    assert abs(slope - difference) <= tolerance * max(abs(difference), np.abs(system.residual()).max())
    change = (g_plus - g_minus) / (2.0 * h)
    np.testing.assert_allclose(hessian @ direction, change, atol=tolerance * np.abs(change).max())


def turned(mesh, rotation):
    return SheetMesh(rotation.apply(mesh.nodes), mesh.triangles)
