"""Embedded nodes: the reduced problem is the full one seen through x = P u, and its derivatives are right."""

import numpy as np
import pytest
import scipy.sparse as sp
from potentials import Look

from sim_core.energies.affine import AffineShape, coordinates
from sim_core.energies.guide import Guide
from sim_core.energies.membrane import Membrane
from sim_core.geometry.sheets import rectangle
from sim_core.solve.embedding import Embedding, eliminate, embed
from sim_core.solve.system import System
from sim_core.solve.unknowns import Compliant

FILM = {"E_pa": 2e9, "nu": 0.3, "thickness_m": 1e-4}


def film(embedding=None, prescribed=None, compliant=(), extra=6):
    """A film of nodes with mass, and ``extra`` nodes more that nothing acts on."""
    mesh = rectangle(0.04, 0.02, (4, 2), "irregular")
    rng = np.random.default_rng(3)
    nodes = np.vstack([mesh.nodes, 0.02 * rng.standard_normal((extra, 3))])
    term = Membrane("film", nodes, mesh.triangles, np.array([1.0, 0.0, 0.0]))
    term.configure(FILM)
    masses = np.concatenate([0.1 * mesh.node_areas, np.full(extra, 1e-4)])
    coupled = sp.diags([np.full(len(nodes) - 1, 1e-6)], [1], (len(nodes),) * 2)
    mass = (sp.diags(masses) + coupled + coupled.T).tocsr()
    held = np.zeros((len(nodes), 3), dtype=bool) if prescribed is None else prescribed
    system = System(nodes, mass, held, [term], np.array([0.3, 0.0, -9.81]), True, compliant, False, embedding)
    return system, len(mesh.nodes)


def some_embedding(n, n_film, rng):
    """Film nodes on masters that are film nodes or others, with shared masters; one on a single master."""
    nodes = np.array([1, 2, 5, 9])
    masters = np.setdiff1d(np.arange(n), nodes)
    weights = np.zeros((4, n))
    for row, count in zip(weights, (4, 4, 2, 1), strict=True):
        chosen = rng.choice(masters[-8:], count, replace=False)
        row[chosen] = rng.standard_normal(count)
        row /= row.sum()
    return Embedding(nodes, sp.csr_matrix(weights))


def begun(system, x):
    """A look at a step that begins in motion, at ``x``."""
    look = Look(system)
    look.begin(system.nodes, v=0.1 * np.random.default_rng(5).standard_normal(x.shape), dt=0.01)
    look.x[:] = look.targets = x
    return look


def scene(seed=0, compliant=False):
    rng = np.random.default_rng(seed)
    plain, n_film = film()
    n = len(plain.nodes)
    embedding = some_embedding(n, n_film, rng)
    prescribed = np.zeros((n, 3), dtype=bool)
    prescribed[0, 1] = prescribed[n - 2] = True  # a component of a film node, and a master
    group = [Compliant(np.array([n - 2]), np.array([1e-3, 2e-3, 5e-3]))] if compliant else []
    system, _ = film(embedding, prescribed, group)
    x = system.nodes + 1e-3 * rng.standard_normal(system.nodes.shape)
    system.embed(x)
    return begun(system, x), begun(plain, x)


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("seed", [0, 1])
def test_reduced_gradient_and_hessian_are_those_of_the_full_problem_through_p(exact, seed):
    reduced, plain = scene(seed)
    system = reduced.system
    p = system.spread_matrix.toarray()
    expected = p.T @ plain.hessian(exact=exact) @ p
    np.testing.assert_allclose(reduced.hessian(exact=exact), expected, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(reduced.residual(), p.T @ plain.gradient().ravel(), atol=1e-12)
    assert reduced.energy() == pytest.approx(plain.energy(), rel=1e-12)


@pytest.mark.parametrize("compliant", [False, True])
def test_reduced_derivatives_against_central_differences(compliant):
    reduced, _ = scene(compliant=compliant)
    check(reduced, reduced.x.copy(), 1e-7, 1e-6)


def test_constraints_are_solved_and_what_cannot_be_is_handed_back():
    rng = np.random.default_rng(0)
    c = rng.standard_normal((4, 9))
    c -= c.mean(axis=1, keepdims=True)
    c[3] = c[0] + 2.0 * c[1]  # follows from the others
    free = np.arange(9) < 6
    nodes, weights, left = eliminate(c, free)
    assert len(nodes) == 3 and len(left) == 0 and free[nodes].all()
    x = rng.standard_normal((9, 3))
    embedding = embed(9, [], (nodes, weights))
    embedding.fill(x)
    np.testing.assert_allclose(c @ x, 0.0, atol=1e-12)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    only = np.zeros((1, 9))
    only[0, 7:] = 1.0, -1.0
    assert len(eliminate(only, free)[0]) == 0
    np.testing.assert_allclose(eliminate(only, free)[2], only)


def test_an_embedded_node_cannot_carry_another():
    with pytest.raises(ValueError):
        Embedding(np.array([0, 1]), sp.csr_matrix(np.array([[0.0, 0.5, 0.5], [0.0, 0.0, 1.0]])))


def bare(term, nodes):
    mass = sp.identity(len(nodes)).tocsr()
    return Look(System(nodes, mass, np.zeros(nodes.shape, dtype=bool), [term], np.zeros(3), False))


def check(look, x, h, tolerance):
    """All derivatives; the lowest eigenvalue of the true matrix over the highest."""
    columns, slopes = [], []
    for e in h * np.eye(look.system.n_unknowns):
        ends = []
        for sign in (1.0, -1.0):
            look.x[:] = x
            look.move(sign * e)
            ends.append((look.energy(), look.residual()))
        slopes.append((ends[0][0] - ends[1][0]) / (2.0 * h))
        columns.append((ends[0][1] - ends[1][1]) / (2.0 * h))
    look.x[:], expected = x, np.array(columns)
    found = look.hessian(exact=True)
    np.testing.assert_allclose(look.residual(), slopes, atol=tolerance * np.abs(slopes).max())
    np.testing.assert_allclose(found, expected, atol=tolerance * np.abs(expected).max())
    values = np.linalg.eigvalsh(look.hessian())
    assert values.min() > -1e-12 * values.max()
    return np.linalg.eigvalsh(found).min() / values.max()


def test_shape_energy_and_its_derivatives():
    """Stretched and squeezed by some per cent; the squeeze makes the true matrix indefinite, the other not."""
    rng = np.random.default_rng(2)
    nodes = 0.01 * rng.standard_normal((8, 3))
    term = AffineShape("shape", np.array([[0, 1, 2, 3], [4, 5, 6, 7]]), nodes, np.array([1e-6, 2e-6]))
    system = bare(term, nodes)
    assert system.energy() == pytest.approx(0.0, abs=1e-20)
    lowest = check(system, 0.95 * nodes + 2e-4 * rng.standard_normal(nodes.shape), 1e-8, 1e-6)
    assert lowest < -1e-4


def test_shape_energy_is_volume_times_kappa_times_the_square_of_the_paper():
    rng = np.random.default_rng(7)
    nodes = 0.01 * rng.standard_normal((4, 3))
    system = bare(AffineShape("shape", np.array([[0, 1, 2, 3]]), nodes, np.array([3e-6])), nodes)
    a = np.eye(3) + 0.05 * rng.standard_normal((3, 3))
    system.x[:] = nodes @ a.T + 0.3
    assert system.energy() == pytest.approx(3e-6 * 1e9 * np.sum((a @ a.T - np.eye(3)) ** 2), rel=1e-10)


def test_guide_energy_and_its_derivatives():
    rng = np.random.default_rng(4)
    nodes = 0.01 * rng.standard_normal((8, 3))
    point, line = 0.002 * rng.standard_normal((2, 3))
    axis = np.array([0.6, 0.0, 0.8])
    ends = coordinates(nodes[4:], np.vstack([line, line + axis]))
    apart = np.concatenate([coordinates(nodes[:4], point)[0], -ends[0]])
    along = np.concatenate([np.zeros(4), ends[1] - ends[0]])
    system = bare(Guide("guide", np.arange(8), apart, along, 0.01), nodes)
    off = np.cross(point - line, axis)
    assert system.energy() == pytest.approx(0.5 * 8e9 * 0.01 * off @ off, rel=1e-9)
    check(system, nodes + 1e-3 * rng.standard_normal(nodes.shape), 1e-7, 1e-5)


def test_barycentric_coordinates_follow_an_affine_motion():
    rng = np.random.default_rng(9)
    corners, points = rng.standard_normal((4, 3)), rng.standard_normal((5, 3))
    a, b = rng.standard_normal((3, 3)), rng.standard_normal(3)
    np.testing.assert_allclose(coordinates(corners, points) @ (corners @ a.T + b), points @ a.T + b, atol=1e-12)
