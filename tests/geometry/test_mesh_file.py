"""Meshes from files: read in their unit, repaired aloud or refused with the numbers of what is wrong."""

import importlib.util

import meshio
import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.geometry import solids, tet10
from sim_core.geometry.mesh_file import MeshRepaired, read_sheet, read_solid
from sim_core.geometry.sheets import rectangle
from sim_core.geometry.subdivision import split_tets, split_triangles
from sim_core.geometry.surface_points import locate_near

SHEET = rectangle(40.0, 20.0, (4, 2), "crossed")
"""In mm."""

SOLID = solids.block((20.0, 10.0, 10.0), (2, 2, 1))


def written(folder, name, points, **cells):
    path = folder / name
    mesh = meshio.Mesh(np.asarray(points, dtype=float), [(k, np.asarray(c)) for k, c in cells.items()])
    meshio.write(path, mesh, file_format="gmsh" if name.endswith(".msh") else None)
    return path


def sheet_file(folder, points=SHEET.nodes, triangles=SHEET.triangles, name="sheet.obj"):
    return written(folder, name, points, triangle=triangles)


@pytest.mark.parametrize("name", ["sheet.obj", "sheet.ply", "sheet.stl"])
def test_triangles_of_all_formats_are_the_same_sheet(tmp_path, name):
    path = sheet_file(tmp_path, name=name)
    mesh = read_sheet(path, "mm")
    assert len(mesh.nodes) == len(SHEET.nodes)
    assert mesh.areas.sum() == pytest.approx(0.04 * 0.02, rel=1e-6)
    a, b, c = np.moveaxis(mesh.nodes[mesh.triangles], 1, 0)
    assert np.cross(b - a, c - a)[:, 2].min() > 0.0


def test_triangles_that_face_the_other_way_are_turned_and_reported(tmp_path):
    triangles = SHEET.triangles.copy()
    triangles[[3, 7]] = triangles[[3, 7]][:, ::-1]
    with pytest.warns(MeshRepaired, match="turned over, to face as their neighbours do: 3, 7"):
        mesh = read_sheet(sheet_file(tmp_path, triangles=triangles), "mm")
    assert np.array_equal(np.sort(mesh.triangles), np.sort(SHEET.triangles))
    a, b, c = np.moveaxis(mesh.nodes[mesh.triangles], 1, 0)
    assert np.cross(b - a, c - a)[:, 2].min() > 0.0


def test_unused_vertices_are_left_out_and_reported(tmp_path):
    points = np.vstack([SHEET.nodes, [[0.0, 0.0, 5.0]]])
    with pytest.warns(MeshRepaired, match="belong to no element were left out: 23"):
        assert len(read_sheet(sheet_file(tmp_path, points), "mm").nodes) == 23


def test_quadrilaterals_are_cut(tmp_path):
    path = written(tmp_path, "quads.obj", [[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]], quad=[[0, 1, 2, 3]])
    with pytest.warns(MeshRepaired, match="1 quadrilaterals were cut"):
        assert read_sheet(path, "mm").areas.sum() == pytest.approx(81e-6)


def slit():
    """Two halves that meet along a line whose vertices are doubled."""
    other = SHEET.nodes + [40.0, 0.0, 0.0]
    return np.vstack([SHEET.nodes, other]), np.vstack([SHEET.triangles, SHEET.triangles + len(SHEET.nodes)])


def test_doubled_vertices_are_joined_or_kept_apart_as_the_rig_says(tmp_path):
    path = sheet_file(tmp_path, *slit())
    with pytest.raises(ConfigError, match=r"3 pairs of vertices at one place: \d+ and \d+") as error:
        read_sheet(path, "mm")
    assert "weld: true" in error.value.remedy and "weld: false" in error.value.remedy
    assert len(read_sheet(path, "mm", weld=False).nodes) == 46
    with pytest.warns(MeshRepaired, match="at one place were joined: 46 vertices became 43"):
        assert len(read_sheet(path, "mm", weld=True).nodes) == 43


BROKEN = {
    "degenerate": (
        [[0, 0, 0], [9, 0, 0], [4, 1e-3, 0], [0, 9, 0]],
        [[0, 1, 3], [0, 2, 1]],
        "degenerate triangles.*: 1",
    ),
    "repeated vertex": ([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2], [0, 1, 1]], "a vertex twice: 1"),
    "doubled": ([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2], [1, 2, 0]], "more than once: 0 and 1"),
    "three at an edge": (
        [[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, -9, 0], [0, 0, 9]],
        [[0, 1, 2], [1, 0, 3], [0, 1, 4]],
        r"edge \[0, 1\] has 0, 1, 2",
    ),
    "touching at a vertex": (
        [[0, 0, 0], [9, 0, 0], [0, 9, 0], [-9, 0, 0], [0, -9, 0]],
        [[0, 1, 2], [0, 3, 4]],
        "share no edge there: 0",
    ),
    "not finite": ([[0, 0, 0], [9, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], "without finite coordinates: 2"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_what_cannot_be_a_sheet_is_named_by_its_numbers(tmp_path, kind):
    points, triangles, words = BROKEN[kind]
    with pytest.raises(ConfigError, match=words) as error:
        read_sheet(sheet_file(tmp_path, points, triangles, "broken.ply"), "mm")
    assert "broken.ply" in error.value.problem and error.value.remedy


def test_a_moebius_strip_is_refused(tmp_path):
    n = 12
    turn = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    points = []
    for side in (-3.0, 3.0):
        r = 20.0 + side * np.cos(turn / 2)
        points.append(np.column_stack([r * np.cos(turn), r * np.sin(turn), side * np.sin(turn / 2)]))
    low, high = np.arange(n), np.arange(n) + n
    next_low, next_high = np.append(low[1:], high[0]), np.append(high[1:], low[0])
    triangles = np.vstack([np.column_stack([low, next_low, next_high]), np.column_stack([low, next_high, high])])
    with pytest.raises(ConfigError, match="no consistent orientation"):
        read_sheet(sheet_file(tmp_path, np.vstack(points), triangles), "mm")


def test_a_wrong_unit_is_refused_with_the_ones_that_fit(tmp_path):
    with pytest.raises(ConfigError, match="is 40 m large with 'unit: m'") as error:
        read_sheet(sheet_file(tmp_path), "m")
    assert "0.04 m with 'unit: mm'" in error.value.remedy
    assert "'unit: um'" not in error.value.remedy


def test_what_is_no_mesh_is_refused_without_ending_the_process(tmp_path):
    for name, text in (("a.obj", "v 0 0 x\n"), ("a.xyzzy", "?"), ("a.msh", "$MeshFormat\n")):
        (tmp_path / name).write_text(text)
        with pytest.raises(ConfigError, match=f"The mesh {name} cannot be read as a mesh"):
            read_sheet(tmp_path / name, "m")
    with pytest.raises(ConfigError, match="No such file"):
        read_sheet(tmp_path / "none.obj", "m")


def solid_file(folder, name="gel.vtk", points=SOLID.nodes, tets=SOLID.tets, order=2):
    if order == 1:
        used, tets = np.unique(tets[:, :4], return_inverse=True)
        points, tets = points[used], tets.reshape(-1, 4)
    return written(folder, name, points, **{"tetra" if tets.shape[1] == 4 else "tetra10": tets})


@pytest.mark.parametrize("name", ["gel.vtk", "gel.vtu", "gel.msh"])
@pytest.mark.parametrize("order", [1, 2])
def test_tetrahedra_of_all_formats_are_the_same_gel(tmp_path, name, order):
    path = solid_file(tmp_path, name, order=order)
    mesh = read_solid(path, "mm", boxes={"base": np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])})
    assert solids.volume(mesh) == pytest.approx(0.02 * 0.01 * 0.01, rel=1e-9)
    assert len(mesh.nodes) == len(SOLID.nodes)
    middles = mesh.nodes[mesh.tets[:, :4]][:, tet10.EDGES].mean(axis=2)
    assert mesh.nodes[mesh.tets[:, 4:]] == pytest.approx(middles, abs=1e-12)
    assert np.abs(mesh.nodes[mesh.node_sets["base"], 2]).max() < 1e-12
    assert len(mesh.face_sets["base"]) == len(SOLID.face_sets["bottom"])


def test_named_groups_of_gmsh_are_faces(tmp_path):
    used, tets = np.unique(SOLID.tets[:, :4], return_inverse=True)
    number = np.full(len(SOLID.nodes), -1)
    number[used] = np.arange(len(used))
    top = number[SOLID.surface[SOLID.face_sets["top"], :3]]
    mesh = meshio.Mesh(SOLID.nodes[used], [("tetra", tets.reshape(-1, 4)), ("triangle", top)])
    tags = [np.full(len(tets.reshape(-1, 4)), 2), np.full(len(top), 1)]
    mesh.cell_data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    mesh.field_data = {"skin": np.array([1, 2]), "gel": np.array([2, 3])}
    meshio.write(tmp_path / "gel.msh", mesh, file_format="gmsh22", binary=False)
    found = read_solid(tmp_path / "gel.msh", "mm")
    assert set(found.face_sets) == {"skin"}
    assert found.nodes[found.node_sets["skin"], 2] == pytest.approx(0.01)
    assert len(found.face_sets["skin"]) == len(top)


def test_tetrahedra_inside_out_are_renumbered_and_reported(tmp_path):
    tets = SOLID.tets.copy()
    tets[5] = tets[5][[0, 2, 1, 3, 6, 5, 4, 7, 9, 8]]
    with pytest.warns(MeshRepaired, match="inside out were renumbered: 5"):
        mesh = read_solid(solid_file(tmp_path, tets=tets), "mm")
    assert solids.volume(mesh) == pytest.approx(2e-6, rel=1e-9)


def test_flat_tetrahedra_overlaps_and_pieces_are_refused(tmp_path):
    points = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9], [3, 3, 1e-6], [9, 9, 9], [20, 0, 0]], dtype=float)
    for tets, words in (
        ([[0, 1, 2, 3], [0, 1, 2, 4]], "degenerate tetrahedra, nearly flat ones: 1"),
        ([[0, 1, 2, 3], [0, 1, 2, 3]], "tetrahedra more than once: 0 and 1"),
        ([[0, 1, 2, 3], [0, 1, 2, 5], [0, 1, 2, 6]], None),
    ):
        path = written(tmp_path, "broken.vtk", points, tetra=np.array(tets))
        if words is None:
            points[6] = [2.0, 2.0, -5.0]
            path = written(tmp_path, "broken.vtk", points, tetra=np.array(tets))
            words = r"face \[0, 1, 2\] has 0, 1, 2"
        with pytest.raises(ConfigError, match=words):
            read_solid(path, "mm")
    two = np.vstack([points[:4], points[:4] + 30.0])
    path = written(tmp_path, "apart.vtk", two, tetra=np.array([[0, 1, 2, 3], [4, 5, 6, 7]]))
    with pytest.raises(ConfigError, match="2 pieces that share no face; they begin with the tetrahedra 0, 1"):
        read_solid(path, "mm")


def test_a_named_face_without_a_face_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="no face in the set 'base'"):
        read_solid(solid_file(tmp_path), "mm", boxes={"base": np.array([[-1.0, -1.0, 0.003], [1.0, 1.0, 0.004]])})


def test_a_surface_that_is_open_cannot_be_filled(tmp_path):
    with pytest.raises(ConfigError, match="is not closed: 12 edges have one triangle only"):
        read_solid(sheet_file(tmp_path), "mm", fill_edge_m=0.01)


def test_a_surface_alone_is_no_gel(tmp_path):
    with pytest.raises(ConfigError, match="has triangle, and a gel needs tetrahedra") as error:
        read_solid(sheet_file(tmp_path), "mm")
    assert "fill" in error.value.remedy


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("pytetwild") is None, reason="the extra 'mesh' is not installed")
def test_a_closed_surface_is_filled(tmp_path):
    from sim_core.geometry.closed import sphere

    ball = sphere(10.0, 4.0)
    path = sheet_file(tmp_path, ball.nodes, ball.triangles)
    mesh = read_solid(path, "mm", fill_edge_m=4e-3)
    a, b, c = np.moveaxis(1e-3 * ball.nodes[ball.triangles], 1, 0)
    assert solids.volume(mesh) == pytest.approx(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0, rel=5e-3)


def test_parts_of_triangles_make_up_the_sheet():
    fine = split_triangles(SHEET, 3)
    assert len(fine.triangles) == 9 * len(SHEET.triangles)
    assert fine.areas.sum() == pytest.approx(SHEET.areas.sum())
    a, b, c = np.moveaxis(fine.nodes[fine.triangles], 1, 0)
    assert np.cross(b - a, c - a)[:, 2].min() > 0.0
    assert len(np.unique(np.round(fine.nodes, 9), axis=0)) == len(fine.nodes)


def test_parts_of_tetrahedra_make_up_the_curved_gel():
    dome = solids.dome(0.01, 0.006, (2, 1, 1))
    fine = split_tets(dome)
    assert len(fine.tets) == 8 * len(dome.tets)
    assert solids.volume(fine) == pytest.approx(solids.volume(dome), rel=1e-12)
    for name, rows in dome.face_sets.items():
        assert len(fine.face_sets[name]) == 4 * len(rows)
        assert set(dome.node_sets[name]) <= set(fine.node_sets[name])


def test_points_are_found_on_a_curved_sheet():
    angle = np.linspace(0.0, 1.5, 9)
    flat = rectangle(1.5, 0.4, (8, 2))
    bent = np.column_stack([np.sin(flat.nodes[:, 0]), flat.nodes[:, 1], np.cos(flat.nodes[:, 0])])
    mesh = type(flat)(bent, flat.triangles)
    wanted = np.column_stack([np.sin(angle - 0.75), 0.1 + 0.0 * angle, np.cos(angle - 0.75)])
    triangle, weights = locate_near(mesh, wanted)
    found = np.einsum("ka,kai->ki", weights, mesh.nodes[mesh.triangles[triangle]])
    assert np.abs(found - wanted).max() < 0.01
    with pytest.raises(ConfigError, match="away from the sheet"):
        locate_near(mesh, np.array([[0.0, 0.0, 2.0]]))
