"""How the nodes of a scene are coupled, and in which order the core eliminates them: worked out once a system."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import reverse_cuthill_mckee

from sim_core.contact.rigid import RigidContact
from sim_core.core.mechanics import Mechanics
from sim_core.energies.affine import AffineShape
from sim_core.energies.bending import Bending
from sim_core.energies.guide import Guide
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.solve.system import System


@dataclass(frozen=True)
class Layout:
    """Terms of all sheets and gels; ``pattern``: which hinges bending couples, csr ``(h, h)``; ``rank``:
    place of each node in
    the elimination ``(n,)``; ``width``: root of the mean square of the widths of the factor's rows [entries]."""

    membranes: list[Membrane]
    bendings: list[Bending]
    gels: list[NeoHookean]
    pattern: sp.csr_matrix
    rank: np.ndarray
    width: float


_known: WeakKeyDictionary[System, Layout] = WeakKeyDictionary()


def layout_of(scene: Mechanics) -> Layout:
    """The layout of a scene whose terms the core has elements for."""
    system = scene.system
    if system not in _known:
        membranes = [t for t in system.terms if isinstance(t, Membrane)]
        bendings = [t for t in system.terms if isinstance(t, Bending)]
        gels = [t for t in system.terms if isinstance(t, NeoHookean)]
        pattern = _coupled_hinges(bendings)
        rank, width = _ranks(scene, _coupled_nodes(scene, membranes, bendings, gels, pattern))
        _known[system] = Layout(membranes, bendings, gels, pattern, rank, width)
    return _known[system]


def _coupled_hinges(bendings: list[Bending]) -> sp.csr_matrix:
    """Hinges around one triangle, with each other."""
    parts = []
    for term in bendings:
        around = sum(abs(term.operator[k::3]) for k in range(3))
        around.data[:] = 1.0
        parts.append(around.T @ around + sp.identity(around.shape[1]))
    pattern = sp.csr_matrix(sp.block_diag(parts)) if parts else sp.csr_matrix((0, 0))
    pattern.sort_indices()
    return pattern


def _members(groups: np.ndarray, count: int) -> sp.csr_matrix:
    """Which of ``count`` nodes are in each group, int ``(m, k)``, ``(m, count)``."""
    rows = np.repeat(np.arange(len(groups)), groups.shape[1])
    return sp.csr_matrix((np.ones(groups.size), (rows, groups.ravel())), shape=(len(groups), count))


def _coupled_nodes(
    scene: Mechanics,
    membranes: list[Membrane],
    bendings: list[Bending],
    gels: list[NeoHookean],
    pattern: sp.csr_matrix,
) -> sp.csr_matrix:
    """Nodes that the Hessian couples, ``(n, n)``."""
    count = len(scene.system.nodes)
    groups = [t.triangles for t in membranes] + [t.tets for t in gels]
    groups += [t.control for t in scene.system.terms if isinstance(t, AffineShape)]
    groups += [t.nodes[None] for t in scene.system.terms if isinstance(t, Guide)]
    groups += [t.samples.nodes for t in scene.system.terms if isinstance(t, RigidContact)]
    graph = sp.csr_matrix(scene.system.mass != 0, dtype=float)
    for group in groups:
        graph = graph + _members(group, count).T @ _members(group, count)
    hinges = _members(np.vstack([t.hinge_nodes for t in bendings] or [np.empty((0, 4), dtype=int)]), count)
    graph = sp.csr_matrix(graph + hinges.T @ pattern @ hinges)
    if scene.system.embedding is None:
        return graph
    through = abs(scene.system.embedding.matrix())
    return sp.csr_matrix(through.T @ graph @ through)


def _ranks(scene: Mechanics, graph: sp.csr_matrix) -> tuple[np.ndarray, float]:
    """Along the body or by reverse Cuthill-McKee (Cuthill & McKee, Proc. 24th ACM Natl. Conf., 1969), whichever makes
    the narrower factor."""
    free = np.asarray(~scene.system.prescribed.all(axis=1))
    if scene.system.embedding is not None:
        free[scene.system.embedding.nodes] = False
    middle = scene.system.nodes - scene.system.nodes[free].mean(axis=0) if free.any() else scene.system.nodes
    along = np.linalg.svd(middle[free], full_matrices=False)[2][0] if free.any() else np.eye(3)[0]
    found = []
    for order in (np.argsort(middle @ along, kind="stable"), reverse_cuthill_mckee(graph, symmetric_mode=True)):
        rank = np.empty(len(order), dtype=np.int32)
        rank[order] = np.arange(len(order))
        found.append((rank, _width(graph, rank, free)))
    return min(found, key=lambda pair: pair[1])


def _width(graph: sp.csr_matrix, rank: np.ndarray, free: np.ndarray) -> float:
    """Width of the factor over the free nodes, three unknowns each."""
    pairs = graph.tocoo()
    keep = free[pairs.row] & free[pairs.col]
    place = np.full(len(rank), -1)
    order = np.argsort(rank)
    place[order[free[order]]] = np.arange(np.count_nonzero(free))
    at, other = place[pairs.row[keep]], place[pairs.col[keep]]
    last = np.arange(np.count_nonzero(free))
    np.maximum.at(last, at, other)
    widths = np.maximum.accumulate(last) - np.arange(len(last)) + 1.0
    return 3.0 * float(np.sqrt(np.mean(widths**2))) if len(widths) else 0.0
