import numpy as np
import pytest
from pydantic import ValidationError

from sim_core.errors import ConfigError
from sim_core.geometry.sheets import PATTERNS, find_hinges, locate, outline, rectangle
from sim_core.rigs.bodies import Outline


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


TRIANGLE = [[0, 0], [0.01, 0], [0, 0.01]]
BOX = [[-0.05, -0.015], [0.05, -0.015], [0.05, 0.015], [-0.05, 0.015]]


@pytest.mark.parametrize(
    ("corners", "edge_m"),
    [
        (BOX, 0.01),
        # A narrow arm next to a block, and a notch that is narrower than the edges.
        ([[0, 0], [0.1, 0], [0.1, 0.03], [0.05, 0.03], [0.05, 0.002], [0, 0.002]], 0.01),
        ([[0, 0], [0.1, 0], [0.1, 0.05], [0.051, 0.05], [0.05, 0.01], [0.049, 0.05], [0, 0.05]], 0.02),
        ([[0, 0], [0.1, 0.001], [0.2, 0], [0.1, 0.08]], 0.03),
    ],
)
def test_the_mesh_of_an_outline_has_its_area(corners: list[list[float]], edge_m: float) -> None:
    ring = np.array(corners, dtype=float)
    x, y = ring.T
    area = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    mesh = outline(ring, edge_m)
    assert mesh.areas.sum() == pytest.approx(area, rel=1e-9)
    assert (mesh.areas > 0.0).all()
    find_hinges(mesh.triangles)


def shape(corners: object, holes: object = ()) -> Outline:
    return Outline.model_validate({"type": "outline", "polygon_m": corners, "holes_m": holes, "edge_m": 0.01})


def test_a_ring_may_end_where_it_begins() -> None:
    hole = [[-0.01, -0.005], [0.01, -0.005], [0.0, 0.005]]
    closed = shape([*BOX, BOX[0]], [[*hole, hole[0]]])
    assert closed == shape(BOX, [hole]) and len(closed.polygon_m) == 4


@pytest.mark.parametrize(
    ("corners", "holes", "fault"),
    [
        (
            [[-0.05, -0.015], [0.05, 0.02], [0.05, -0.015], [-0.05, 0.015]],
            [],
            "crosses itself: the edges from corner 0",
        ),
        ([BOX[0], BOX[0], *BOX[1:]], [], "has corner 0 and corner 1 at the same place"),
        ([[0, 0], [0.1, 0], [0.05, 0], [0.05, 0.05]], [], "crosses itself"),
        (BOX, [[[0.04, 0.0], [0.06, 0.0], [0.05, 0.01]]], "is not inside of the outline"),
        (BOX, [[[0.2, 0.0], [0.3, 0.0], [0.25, 0.01]]], "is not inside of the outline"),
        (
            BOX,
            [[[0, 0], [0.01, 0], [0, 0.01]], [[0.002, 0.002], [0.004, 0.002], [0.002, 0.004]]],
            "is not apart from hole 0",
        ),
    ],
)
def test_an_outline_that_is_none_is_refused_by_its_fault(corners: object, holes: object, fault: str) -> None:
    with pytest.raises(ValidationError, match=fault):
        shape(corners, holes)
