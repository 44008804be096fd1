"""Small systems in contact for the tests."""

import numpy as np
import scipy.sparse as sp
from potentials import Look

from sim_core.contact.edges import EdgeContact
from sim_core.contact.rigid import RigidContact
from sim_core.contact.samples import sheet_samples, triangle_edges
from sim_core.contact.surface import SurfaceContact
from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.geometry.sheets import SheetMesh, rectangle
from sim_core.solve.system import System

LAW = {"stiffness_pa_per_m": 1e9, "range_m": 2e-4, "friction": 0.4}
SHEET = {"E_pa": 5e7, "nu": 0.3, "thickness_m": 4e-4}
X_AXIS = np.array([1.0, 0.0, 0.0])


def sheet_terms(name, mesh, nodes, offset):
    terms = [
        Membrane(f"{name}.membrane", nodes, mesh.triangles + offset, X_AXIS),
        Bending(f"{name}.bending", SheetMesh(nodes[offset : offset + len(mesh.nodes)], mesh.triangles), offset, X_AXIS),
    ]
    for term in terms:
        term.configure(SHEET)
    return terms


class Two:
    """Two sheets one above the other, of different meshes; ``contact`` has both orders of the pair, and the edges."""

    def __init__(
        self, gap, law=LAW, cells=((6, 4), (5, 3)), shift=(0.0013, 0.0007), margin=5e-3, elastic=True, effects=()
    ):
        lower = rectangle(0.04, 0.03, cells[0], "irregular")
        upper = rectangle(0.03, 0.02, cells[1], "crossed")
        top = upper.nodes + [*shift, SHEET["thickness_m"] + gap]
        self.nodes = np.vstack([lower.nodes, top])
        self.lower = np.arange(len(lower.nodes))
        self.upper = np.arange(len(lower.nodes), len(self.nodes))
        self.meshes = lower, upper
        offset = len(lower.nodes)
        samples = [sheet_samples(lower, 0, SHEET["thickness_m"]), sheet_samples(upper, offset, SHEET["thickness_m"])]
        triangles = [lower.triangles, upper.triangles + offset]
        thickness = SHEET["thickness_m"]
        edges = [triangle_edges(t, self.nodes) for t in triangles]
        self.contact = [
            SurfaceContact("down", samples[1], triangles[0], thickness, margin),
            SurfaceContact("up", samples[0], triangles[1], thickness, margin),
            EdgeContact("edges", *edges[0], *edges[1], self.nodes, thickness, margin),
        ]
        for term in self.contact:
            for effect in effects:
                term.laws.add(effect.name, effect)
            term.configure(law)
        terms = list(self.contact)
        if elastic:
            terms += sheet_terms("lower", lower, self.nodes, 0) + sheet_terms("upper", upper, self.nodes, offset)
        density = 1000.0 * thickness
        mass = sp.diags(density * np.concatenate([lower.node_areas, upper.node_areas])).tocsr()
        self.system = System(
            self.nodes, mass, np.zeros((len(self.nodes), 3), dtype=bool), terms, np.zeros(3), inertia=False
        )
        self.look = Look(self.system)

    def begin(self, x, internals=None, dt=0.01):
        self.look.begin(x, dt=dt, internals=internals)
        self.look.x[:] = x

    def touching(self, x, dt=0.01):
        """Begin a step at ``x`` with the loads that act there, so that friction has its limit."""
        self.begin(x, dt=dt)
        internals = self.look.end().internals
        self.begin(x, internals, dt)
        return internals


def on_rigid(shape, nodes, triangles, law=LAW, rotation=None, effects=()):
    """A look at the contact of the nodes of a triangle mesh with a rigid shape at the origin (the last node)."""
    mesh = SheetMesh(np.asarray(nodes, dtype=float), np.asarray(triangles, dtype=np.int32))
    every = np.vstack([mesh.nodes, np.zeros(3)])
    samples = sheet_samples(mesh, 0, 0.0)
    turn = np.eye(3) if rotation is None else np.array(rotation)
    term = RigidContact("rigid", samples, len(mesh.nodes), np.asarray(shape, dtype=float), turn)
    for effect in effects:
        term.laws.add(effect.name, effect)
    term.configure(law)
    prescribed = np.zeros((len(every), 3), dtype=bool)
    prescribed[-1] = True
    system = System(every, sp.csr_matrix((len(every),) * 2), prescribed, [term], np.zeros(3), inertia=False)
    return Look(system), term
