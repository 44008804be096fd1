"""Sheets held at one end for the tests of the step."""

import numpy as np
import scipy.sparse as sp

from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.geometry.sheets import rectangle
from sim_core.solve.system import System

FILM = {"E_pa": 2e9, "nu": 0.3, "thickness_m": 2e-4}
DENSITY = 1000.0


def film(held, gravity=(0.0, 0.0, -9.81), inertia=True, cells=(8, 2), compliant=(), pattern="irregular"):
    """A film of 80 mm x 20 mm; ``held``: function of the rest positions. Returns the system and its mesh."""
    mesh = rectangle(0.08, 0.02, cells, pattern)
    fixed = held(mesh.nodes)
    axis = np.array([1.0, 0.0, 0.0])
    terms = [
        Membrane("membrane", mesh.nodes, mesh.triangles, axis),
        Bending("bending", mesh, 0, axis, held=fixed),
    ]
    for term in terms:
        term.configure(FILM)
    mass = sp.diags(DENSITY * FILM["thickness_m"] * mesh.node_areas).tocsr()
    prescribed = np.repeat(fixed[:, None], 3, axis=1)
    return System(mesh.nodes, mass, prescribed, terms, np.array(gravity), inertia, compliant), mesh


def nothing(nodes):
    return np.zeros(len(nodes), dtype=bool)


def left(nodes):
    return nodes[:, 0] < -0.03


def both_ends(nodes):
    return np.abs(nodes[:, 0]) > 0.031
