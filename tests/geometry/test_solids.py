"""Solid meshes against closed forms: volume, mass, conformity, outward surface, location of points."""

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.geometry import solids, tet10

BLOCK_SIZE = (0.03, 0.02, 0.01)
MESHES = {
    "block": lambda: solids.block(BLOCK_SIZE, (3, 2, 2)),
    "graded block": lambda: solids.block(BLOCK_SIZE, (4, 5, 3), {"x_middle": 0.4, "y_middle": 0.4, "top": 0.5}),
    "one cell": lambda: solids.block(BLOCK_SIZE, (1, 1, 1)),
    "cylinder": lambda: solids.cylinder(0.01, 0.004, (2, 1, 2)),
    "odd cylinder": lambda: solids.cylinder(0.01, 0.004, (3, 2, 1), curved=False),
    "dome": lambda: solids.dome(0.0075, 0.00375, (2, 1, 1)),
    "fine dome": lambda: solids.dome(0.0075, 0.00375, (3, 2, 2)),
    "straight dome": lambda: solids.dome(0.0075, 0.00375, (4, 2, 1), curved=False),
}


@pytest.fixture(params=MESHES)
def mesh(request):
    return MESHES[request.param]()


def surface_integrals(mesh):
    """Area vector, and volume by the divergence theorem, of the quadratic boundary faces."""
    # Three-point rule on the vector area element, exact enough: its degree is 2, times x of degree 2.
    points, weights = np.polynomial.legendre.leggauss(4)
    u, wu = (points + 1.0) / 2.0, weights / 2.0
    area, vol = np.zeros(3), 0.0
    x = mesh.nodes[mesh.surface]
    for a, wa in zip(u, wu, strict=True):
        for b, wb in zip(u, wu, strict=True):
            l1, l2 = a, b * (1.0 - a)
            l0 = 1.0 - l1 - l2
            n = np.array(
                [
                    l0 * (2 * l0 - 1),
                    l1 * (2 * l1 - 1),
                    l2 * (2 * l2 - 1),
                    4 * l0 * l1,
                    4 * l1 * l2,
                    4 * l2 * l0,
                ]
            )
            d1 = np.array([1 - 4 * l0, 4 * l1 - 1, 0.0, 4 * (l0 - l1), 4 * l2, -4 * l2])
            d2 = np.array([1 - 4 * l0, 0.0, 4 * l2 - 1, -4 * l1, 4 * l1, 4 * (l0 - l2)])
            normal = np.cross(np.einsum("a,kai->ki", d1, x), np.einsum("a,kai->ki", d2, x))
            w = wa * wb * (1.0 - a)
            area += w * normal.sum(axis=0)
            vol += w * np.einsum("ki,a,kai->", normal, n, x) / 3.0
    return area, vol


def test_surface_is_closed_outward_and_bounds_the_volume(mesh):
    area, enclosed = surface_integrals(mesh)
    volume = solids.volume(mesh)
    assert np.abs(area).max() < 1e-13 * volume ** (2 / 3)
    assert enclosed == pytest.approx(volume, rel=1e-12)


def test_mesh_is_conforming(mesh):
    corners = np.sort(mesh.tets[:, tet10.FACES[:, :3]].reshape(-1, 3), axis=1)
    _, count = np.unique(corners, axis=0, return_counts=True)
    assert set(count) == {1, 2}
    assert np.sum(count == 1) == len(mesh.surface)
    assert np.array_equal(np.unique(mesh.tets), np.arange(len(mesh.nodes)))
    distance = np.linalg.norm(mesh.nodes[:, None] - mesh.nodes[None, :], axis=2) + np.eye(len(mesh.nodes))
    assert distance.min() > 1e-4 * np.ptp(mesh.nodes)


def test_named_sets_partition_the_boundary(mesh):
    rows = np.concatenate(list(mesh.face_sets.values()))
    assert np.array_equal(np.sort(rows), np.arange(len(mesh.surface)))
    for name, nodes in mesh.node_sets.items():
        assert np.array_equal(nodes, np.unique(mesh.surface[mesh.face_sets[name]]))


def test_edge_nodes_of_straight_meshes_are_midpoints():
    for name in ("graded block", "odd cylinder", "straight dome"):
        mesh = MESHES[name]()
        x = mesh.nodes[mesh.tets]
        assert np.allclose(x[:, 4:], x[:, tet10.EDGES].mean(axis=2), rtol=0.0, atol=1e-15)


def test_block_volume_mass_and_inertia_are_exact():
    mesh = solids.block(BLOCK_SIZE, (3, 2, 2), {"x_middle": 0.5, "y_middle": 0.5, "top": 2.0})
    a, b, c = BLOCK_SIZE
    mass = solids.consistent_mass(mesh)
    x, y, z = mesh.nodes.T
    assert solids.volume(mesh) == pytest.approx(a * b * c, rel=1e-13)
    assert mass.sum() == pytest.approx(a * b * c, rel=1e-13)
    assert x @ mass @ x == pytest.approx(a**3 * b * c / 12.0, rel=1e-12)
    assert z @ mass @ z == pytest.approx(a * b * c**3 / 3.0, rel=1e-12)
    # Quadratic fields too: the integral of y^2 times y^2.
    assert y**2 @ mass @ y**2 == pytest.approx(a * b**5 / 80.0 * c, rel=1e-12)
    assert np.linalg.eigvalsh(mass.toarray()).min() > 0.0


def test_grading_makes_cells_smaller_at_the_centre_and_the_top():
    mesh = solids.block((1.0, 1.0, 1.0), (4, 4, 3), {"x_middle": 0.25, "y_middle": 0.25, "top": 0.5})
    corners = np.unique(mesh.tets[:, :4])
    x, z = (np.diff(np.unique(np.round(mesh.nodes[corners, axis], 12))) for axis in (0, 2))
    assert x == pytest.approx(np.array([0.4, 0.1, 0.1, 0.4]))
    assert z[2] / z[0] == pytest.approx(0.5)


def test_block_has_no_preferred_diagonal():
    """With even cell counts the mesh is its own mirror image in x and in y."""
    mesh = solids.block((1.0, 1.0, 0.5), (2, 4, 2))
    centres = mesh.nodes[mesh.tets].mean(axis=1)
    for mirror in ([-1.0, 1.0, 1.0], [1.0, -1.0, 1.0]):
        gap = np.linalg.norm(centres[:, None] - (centres * mirror)[None, :], axis=2).min(axis=1)
        assert gap.max() < 1e-12


def test_dome_volume_converges_to_the_closed_form():
    exact = 2.0 / 3.0 * np.pi * (0.0075**3 - 0.00375**3)
    error = [1.0 - solids.volume(solids.dome(0.0075, 0.00375, (2 * k, k, k))) / exact for k in (1, 2, 4)]
    assert error[0] < 0.01
    assert error[1] < 0.001
    assert np.all(np.log2(np.divide(error[:-1], error[1:])) > 3.5)
    straight = solids.volume(solids.dome(0.0075, 0.00375, (4, 2, 2), curved=False))
    assert 1.0 - straight / exact > 0.05
    mesh = solids.dome(0.0075, 0.00375, (4, 2, 2))
    mass = solids.consistent_mass(mesh)
    z = mesh.nodes[:, 2]
    first_moment = np.pi / 4.0 * (0.0075**4 - 0.00375**4)
    assert mass.sum() == pytest.approx(solids.volume(mesh), rel=1e-13)
    assert mass.sum(axis=0) @ z == pytest.approx(first_moment, rel=1e-3)


def test_dome_sets_lie_on_their_surfaces():
    mesh = solids.dome(0.0075, 0.00375, (3, 2, 2))
    radius = np.linalg.norm(mesh.nodes, axis=1)
    assert np.allclose(radius[mesh.node_sets["outer"]], 0.0075, rtol=1e-12)
    assert np.allclose(radius[mesh.node_sets["inner"]], 0.00375, rtol=1e-12)
    assert np.abs(mesh.nodes[mesh.node_sets["base"], 2]).max() < 1e-15
    assert mesh.nodes[:, 2].max() <= 0.0075
    assert mesh.nodes[:, 2].min() > -1e-15


def test_cylinder_volume():
    error = [
        1.0 - solids.volume(solids.cylinder(0.01, 0.004, (2 * k, k, k))) / (np.pi * 0.01**2 * 0.004) for k in (1, 2, 4)
    ]
    assert error[0] < 0.001
    assert np.all(np.log2(np.divide(error[:-1], error[1:])) > 3.5)


def test_located_points_follow_any_quadratic_field_of_a_straight_mesh():
    mesh = solids.block(BLOCK_SIZE, (3, 2, 2), {"x_middle": 0.5, "y_middle": 0.5})
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.5, 0.5, (200, 3)) * BLOCK_SIZE + [0.0, 0.0, 0.005]
    points[:20, 2] = 0.01  # on the top
    points[20:40, 0] = 0.015
    element, weights = solids.locate(mesh, points)
    q = rng.normal(size=(3, 3))

    def field(x):
        return np.einsum("...i,ij,...j->...", x, q, x)

    assert np.abs(weights.sum(axis=1) - 1.0).max() < 1e-12
    assert np.abs(np.einsum("pa,pai->pi", weights, mesh.nodes[mesh.tets[element]]) - points).max() < 1e-14
    error = np.einsum("pa,pa->p", weights, field(mesh.nodes[mesh.tets[element]])) - field(points)
    assert np.abs(error).max() < 1e-12 * np.abs(field(points)).max()


def test_points_are_located_in_curved_elements():
    mesh = solids.dome(0.0075, 0.00375, (2, 1, 1))
    rng = np.random.default_rng(4)
    inside = rng.dirichlet(np.ones(4), len(mesh.tets))
    points = np.einsum("ma,mai->mi", tet10.shape(inside), mesh.nodes[mesh.tets])
    element, weights = solids.locate(mesh, points)
    assert np.array_equal(element, np.arange(len(mesh.tets)))
    assert np.abs(weights - tet10.shape(inside)).max() < 1e-9
    element, weights = solids.locate(mesh, mesh.nodes)
    assert np.abs(np.einsum("pa,pai->pi", weights, mesh.nodes[mesh.tets[element]]) - mesh.nodes).max() < 1e-13


def test_markers_on_the_true_sphere_need_a_tolerance():
    mesh = solids.dome(0.0075, 0.00375, (4, 2, 1))
    angle = np.linspace(0.05, 1.5, 12)
    points = 0.0075 * np.column_stack([np.sin(angle), 0.3 * np.sin(angle), np.cos(angle)])
    points *= 0.0075 / np.linalg.norm(points, axis=1, keepdims=True)
    with pytest.raises(ConfigError, match="outside"):
        solids.locate(mesh, points)
    element, weights = solids.locate(mesh, points, tolerance=0.01)
    assert np.abs(np.einsum("pa,pai->pi", weights, mesh.nodes[mesh.tets[element]]) - points).max() < 1e-12


def test_points_outside_are_named():
    mesh = solids.block(BLOCK_SIZE, (2, 2, 2))
    with pytest.raises(ConfigError, match=r"2 of 3 points lie outside the body: 1 at .*, 2 at"):
        solids.locate(mesh, np.array([[0.0, 0.0, 0.005], [0.0, 0.0, 0.0101], [1.0, 0.0, 0.0]]))
    with pytest.raises(ConfigError, match="outside"):
        solids.locate(solids.dome(0.0075, 0.00375, (2, 1, 1)), np.array([[0.0, 0.0, 0.001]]))


def test_an_element_turned_inside_out_is_named():
    mesh = solids.block(BLOCK_SIZE, (2, 2, 1))
    nodes = mesh.nodes.copy()
    tets = mesh.tets.copy()
    tets[7] = tets[7][[0, 2, 1, 3, 6, 5, 4, 7, 9, 8]]
    with pytest.raises(ConfigError, match=r"Element 7 .* inside out"):
        solids.TetMesh(nodes, tets, mesh.surface, mesh.face_sets)
    with pytest.raises(ConfigError, match="cavity"):
        solids.dome(0.004, 0.005, (2, 1, 1))
    with pytest.raises(ConfigError, match="positive"):
        solids.block(BLOCK_SIZE, (2, 0, 1))


def test_quadrature_rules_are_exact_to_their_degree():
    """The integral of L1^a L2^b L3^c over the reference element is a! b! c! / (a + b + c + 3)!."""
    from math import factorial

    for (points, weights), degree in (
        (tet10.four_point_rule(), 2),
        (tet10.conical_rule(2), 3),
        (tet10.conical_rule(4), 7),
    ):
        for a in range(degree + 1):
            for b in range(degree + 1 - a):
                c = degree - a - b
                exact = factorial(a) * factorial(b) * factorial(c) / factorial(degree + 3)
                value = np.sum(weights * points[:, 1] ** a * points[:, 2] ** b * points[:, 3] ** c)
                assert value == pytest.approx(exact, rel=1e-12)


def test_pins_move_and_turn_with_the_wall_that_they_stand_on():
    # Straight elements hold any quadratic map, u = A x + c z^2 e_x + d x y e_z, without error.
    mesh = solids.dome(0.02, 0.013, (3, 2, 1), curved=False)
    stretch = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.3], [0.0, 0.1, 1.2]])

    def moved(x):
        bent = np.column_stack([30.0 * x[:, 2] ** 2, np.zeros(len(x)), 20.0 * x[:, 0] * x[:, 1]])
        return x @ stretch.T + bent

    directions = np.array([[0.1, 0.2, 1.0], [0.5, -0.3, 0.8], [-0.6, 0.6, 0.4], [0.02, 0.01, 1.0]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    feet, tips = 0.0145 * directions, 0.010 * directions
    element, weights = solids.locate_pins(mesh, tips, feet)
    found = np.einsum("pa,pai->pi", weights, moved(mesh.nodes)[mesh.tets[element]])
    for foot, tip, at in zip(feet, tips, found, strict=True):
        x, y, z = foot
        gradient = stretch + np.array([[0.0, 0.0, 60.0 * z], [0.0, 0.0, 0.0], [20.0 * y, 20.0 * x, 0.0]])
        np.testing.assert_allclose(at, moved(foot[None])[0] + gradient @ (tip - foot), atol=1e-14)
    inside, plain = solids.locate_pins(mesh, feet, feet), solids.locate(mesh, feet)
    np.testing.assert_array_equal(inside[1], plain[1])
