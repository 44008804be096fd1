import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.geometry.sheets import PATTERNS, find_hinges, locate, outline, rectangle


@pytest.mark.parametrize("pattern", PATTERNS)
def test_areas_and_node_areas_add_up_and_no_node_is_counted_in_full_at_a_border(pattern):
    """Mass is lumped by area, so corners and borders carry less than the inside."""
    mesh = rectangle(0.1, 0.04, (10, 4), pattern)
    assert mesh.areas.sum() == pytest.approx(0.004)
    assert mesh.node_areas.sum() == pytest.approx(0.004)
    corner = np.isclose(np.abs(mesh.nodes[:, 0]), 0.05) & np.isclose(np.abs(mesh.nodes[:, 1]), 0.02)
    inside = (np.abs(mesh.nodes[:, 0]) < 0.04) & (np.abs(mesh.nodes[:, 1]) < 0.015)
    assert corner.sum() == 4
    assert mesh.node_areas[corner].max() < 0.5 * mesh.node_areas[inside].mean()


@pytest.mark.parametrize("pattern", PATTERNS)
def test_all_triangles_look_up_and_every_inner_edge_is_one_hinge(pattern):
    mesh = rectangle(0.1, 0.04, (7, 3), pattern)
    a, b, c = (mesh.nodes[mesh.triangles[:, k]] for k in range(3))
    assert np.cross(b - a, c - a)[:, 2].min() > 0
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert len(find_hinges(mesh.triangles).nodes) == np.count_nonzero(counts == 2)


def test_an_outline_with_a_hole_has_the_area_of_the_polygon_less_the_hole():
    frame = np.array([[0, 0], [0.06, 0], [0.06, 0.04], [0, 0.04]])
    hole = np.array([[0.02, 0.01], [0.04, 0.01], [0.04, 0.03], [0.02, 0.03]])
    mesh = outline(frame, 0.004, (hole,))
    assert mesh.areas.sum() == pytest.approx(0.06 * 0.04 - 0.02 * 0.02, rel=1e-9)


def test_edges_that_two_triangles_use_in_the_same_direction_are_refused():
    with pytest.raises(ConfigError, match="used twice"):
        find_hinges(np.array([[0, 1, 2], [0, 1, 3]]))


def test_material_points_are_found_and_points_off_the_sheet_are_named():
    mesh = rectangle(0.1, 0.04, (5, 2), "irregular")
    points = np.random.default_rng(0).uniform([-0.049, -0.019], [0.049, 0.019], (40, 2))
    triangle, weights = locate(mesh, points)
    found = np.einsum("nk,nkj->nj", weights, mesh.nodes[mesh.triangles[triangle]])
    np.testing.assert_allclose(found[:, :2], points, atol=1e-12)
    with pytest.raises(ConfigError, match=r"0\.06"):
        locate(mesh, np.array([[0.06, 0.0]]))
