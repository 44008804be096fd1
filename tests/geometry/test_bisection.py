"""Local refinement: conforming, fine where it is asked for, coarse elsewhere, never degenerate."""

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.geometry import solids, tet10
from sim_core.geometry.bisection import Refinement

SIZE = (0.012, 0.012, 0.004)
CORNER = np.array([[-0.001, -0.001, 0.003], [0.001, 0.001, 0.004]])


def edge_lengths(mesh):
    ends = mesh.nodes[mesh.tets[:, :4]][:, tet10.EDGES]
    return np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2)


def shape_quality(mesh):
    """Volume over the cube of the root mean square edge: one of a regular tetrahedron, zero of a flat one."""
    corners = mesh.nodes[mesh.tets[:, :4]]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    return 6.0 * np.sqrt(2.0) * volume / np.sqrt((edge_lengths(mesh) ** 2).mean(axis=1)) ** 3


def faces(mesh):
    return np.unique(np.sort(mesh.tets[:, tet10.FACES[:, :3]].reshape(-1, 3), axis=1), axis=0, return_counts=True)[1]


@pytest.mark.parametrize("edge", [1e-3, 5e-4])
def test_cells_in_the_box_are_small_and_those_far_away_are_not_cut(edge):
    whole = solids.block(SIZE, (4, 4, 2))
    mesh = solids.block(SIZE, (4, 4, 2), refine=[Refinement(CORNER, edge)])
    corners = mesh.nodes[mesh.tets[:, :4]]
    inside = ((corners.min(axis=1) < CORNER[1] - 1e-9) & (corners.max(axis=1) > CORNER[0] + 1e-9)).all(axis=1)
    longest = edge_lengths(mesh).max(axis=1)
    assert longest[inside].max() <= edge * (1.0 + 1e-6)
    assert longest.max() == pytest.approx(edge_lengths(whole).max())
    assert inside.any()


def test_a_refined_mesh_is_conforming_and_of_the_same_body():
    mesh = solids.block(SIZE, (3, 3, 2), refine=[Refinement(CORNER, 4e-4)])
    assert set(faces(mesh)) == {1, 2}
    assert np.sum(faces(mesh) == 1) == len(mesh.surface)
    assert np.array_equal(np.unique(mesh.tets), np.arange(len(mesh.nodes)))
    assert solids.volume(mesh) == pytest.approx(np.prod(SIZE), rel=1e-12)
    area = {n: float(_areas(mesh)[rows].sum()) for n, rows in mesh.face_sets.items()}
    assert area["top"] == pytest.approx(SIZE[0] * SIZE[1], rel=1e-12)
    assert sum(area.values()) == pytest.approx(2 * (SIZE[0] * SIZE[1] + 2 * SIZE[0] * SIZE[2]), rel=1e-12)


def _areas(mesh):
    a, b, c = np.moveaxis(mesh.nodes[mesh.surface[:, :3]], 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def test_repeated_bisection_does_not_make_the_cells_flat():
    quality = [
        shape_quality(solids.block(SIZE, (4, 4, 2), refine=[Refinement(CORNER, edge)])).min()
        for edge in (1e-3, 5e-4, 2.5e-4)
    ]
    assert min(quality) > 0.35


@pytest.mark.parametrize("build", ["cylinder", "dome"])
def test_new_nodes_of_round_bodies_lie_on_their_surfaces(build):
    box = np.array([[-1.0, -1.0, 0.002], [1.0, 1.0, 1.0]])
    if build == "cylinder":
        coarse, fine = (solids.cylinder(0.01, 0.004, (2, 1, 1), refine=r) for r in ([], [Refinement(box, 3e-3)]))
        radius, exact = np.hypot(*fine.nodes[fine.node_sets["side"], :2].T), np.pi * 0.01**2 * 0.004
    else:
        coarse, fine = (solids.dome(0.01, 0.006, (2, 1, 1), refine=r) for r in ([], [Refinement(box, 3e-3)]))
        radius = np.linalg.norm(fine.nodes[fine.node_sets["outer"]], axis=1)
        exact = 2.0 / 3.0 * np.pi * (0.01**3 - 0.006**3)
    assert len(fine.tets) > 2 * len(coarse.tets)
    assert radius == pytest.approx(np.full(len(radius), 0.01), rel=1e-12)
    assert abs(solids.volume(fine) / exact - 1.0) < abs(solids.volume(coarse) / exact - 1.0)


def test_a_refinement_without_bound_is_refused():
    with pytest.raises(ConfigError, match="more than 100000 tetrahedra"):
        solids.block(SIZE, (4, 4, 2), refine=[Refinement(np.array([[-1.0] * 3, [1.0] * 3]), 2e-4)])


@pytest.mark.parametrize("build", [solids.block, solids.cylinder, solids.dome])
def test_a_quarter_is_a_quarter(build):
    size = ((0.012, 0.01, 0.004),) if build is solids.block else (0.01, 0.004)
    whole, part = build(*size, (4, 4, 2)), build(*size, (4, 4, 2), cut=(0, 1))
    assert solids.volume(part) == pytest.approx(solids.volume(whole) / 4.0, rel=1e-12)
    assert part.nodes[:, :2].min() > -1e-12
    for axis, name in enumerate(("x_cut", "y_cut")):
        assert np.array_equal(part.node_sets[name], np.flatnonzero(np.abs(part.nodes[:, axis]) < 1e-12))
    rows = np.concatenate(list(part.face_sets.values()))
    assert np.array_equal(np.sort(rows), np.arange(len(part.surface)))


def test_a_plane_of_symmetry_through_cells_is_refused():
    with pytest.raises(ConfigError, match="middle of the 3 cells"):
        solids.block(SIZE, (3, 4, 2), cut=(0,))


@pytest.mark.parametrize(("place", "finer"), [("axis", 0), ("side", -1)])
def test_rings_of_a_disc_are_graded(place, finer):
    mesh = solids.cylinder(0.01, 0.004, (2, 4, 1), {place: 0.25})
    corners = mesh.nodes[np.unique(mesh.tets[:, :4])]
    along = corners[(np.abs(corners[:, 1]) < 1e-9) & (corners[:, 0] > -1e-9) & (corners[:, 2] < 1e-9), 0]
    widths = np.diff(np.sort(along))
    assert np.argmin(widths) % len(widths) == finer % len(widths)
    assert widths[1] / widths[2] == pytest.approx(0.25 ** (0.25 if place == "axis" else -0.25))
