"""Sheets for the tests of the shell energies."""

import numpy as np
import scipy.sparse as sp
from potentials import Look

from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.geometry.sheets import SheetMesh, rectangle
from sim_core.solve.system import System

X_AXIS = np.array([1.0, 0.0, 0.0])
PAPER = {"E_pa": 2.0e9, "nu": 0.3, "thickness_m": 2e-4}
ORTHOTROPIC = {**PAPER, "anisotropy_ratio": 2.5, "grain_angle_rad": 0.6}


def alone(term, nodes, *more):
    """A look at a system of one term, or more, whose nodes are all free, without inertia and gravity."""
    count = len(nodes)
    free = np.zeros((count, 3), dtype=bool)
    return Look(System(nodes, sp.csr_matrix((count, count)), free, [term, *more], np.zeros(3), inertia=False))


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


def turned(mesh, rotation):
    return SheetMesh(rotation.apply(mesh.nodes), mesh.triangles)
