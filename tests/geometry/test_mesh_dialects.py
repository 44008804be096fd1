"""Meshes as Blender, CAD programs, Gmsh and Abaqus write them are one and the same sheet or gel."""

from __future__ import annotations

import os
import struct
import warnings
from pathlib import Path

import meshio
import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.geometry.mesh_file import MeshRepaired, read_sheet, read_solid

ROOT = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared")) / "faults"

POINTS = np.array([[x, y, 0.0] for x in range(4) for y in range(3)])
QUADS = [[3 * i + j, 3 * i + j + 3, 3 * i + j + 4, 3 * i + j + 1] for i in range(3) for j in range(2)]
TRIANGLES = [t for a, b, c, d in QUADS for t in ([a, b, c], [a, c, d])]
MIXED = [*QUADS[:3], *TRIANGLES[6:]]
AREA = 6e-6
TET_POINTS = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9], [9, 9, 9.0]])
TETS = [[0, 1, 2, 3], [1, 2, 3, 4]]


def obj(faces=TRIANGLES, corner="{0}", vertex="v {0} {1} {2}", extra=(), nl="\n", before=""):
    lines = [vertex.format(*p) for p in POINTS] + list(extra)
    lines += ["f " + " ".join(corner.format(i + 1, i - len(POINTS)) for i in face) for face in faces]
    return before + nl.join(lines) + nl


NORMALS = ["vn 0 0 1", "vt 0 0", "vt 1 0", "vt 1 1"]
RELATIVE = "".join(
    "\n".join(
        [*(f"v {x} {y} {z}" for x, y, z in POINTS[face]), "f -3 -2 -1" if len(face) == 3 else "f -4 -3 -2 -1", ""]
    )
    for face in TRIANGLES
)
"""Each triangle right behind its own vertices, counted from there."""
OBJ = {
    "plain": obj(),
    "normals": obj(corner="{0}//1", extra=NORMALS),
    "textures": obj(corner="{0}/2", extra=NORMALS),
    "normals and textures": obj(corner="{0}/2/1", extra=NORMALS),
    "colours": obj(vertex="v {0} {1} {2} 0.5 0.25 1.0"),
    "weights": obj(vertex="v {0} {1} {2} 1.0"),
    "relative": obj(corner="{1}"),
    "relative with normals": obj(corner="{1}//-1", extra=NORMALS),
    "byte-order mark": "\ufeff" + obj(),
    "windows": obj(nl="\r\n"),
    "quads": obj(QUADS),
    "mixed": obj(MIXED, corner="{0}/1/1", extra=NORMALS),
    "groups and materials": obj(
        extra=["o Plane", "g left right", "usemtl Material.001", "s off", "l 1 2", "vp 0.3 0.1"],
        before="# Blender 4.1.0\nmtllib card.mtl\n",
    ),
    "continued lines": obj().replace("f 1 4 5", "f 1 \\\n 4 5"),
    "remarks behind": obj().replace("\n", " # remark\n"),
}


def binary_stl(head=b"", tail=b""):
    found = head.ljust(80, b" ") + struct.pack("<I", len(TRIANGLES))
    return found + b"".join(struct.pack("<12fH", 0, 0, 1, *POINTS[t].ravel(), 0) for t in TRIANGLES) + tail


def text_stl(triangles=TRIANGLES, name="card"):
    facets = "".join(
        "  facet normal 0 0 1\n    outer loop\n"
        + "".join(f"      vertex {x:e} {y:e} {z:e}\n" for x, y, z in POINTS[t])
        + "    endloop\n  endfacet\n"
        for t in triangles
    )
    return f"solid {name}\n{facets}endsolid {name}\n"


STL = {
    "binary": binary_stl(),
    "binary, begins with solid": binary_stl(b"solid exported by Onshape"),
    "binary, colours": binary_stl(b"COLOR=\xff\xff\xff\xff,MATERIAL="),
    "binary, bytes behind": binary_stl(b"facet", b"\r\n"),
    "text": text_stl(),
    "text, capitals": text_stl().upper(),
    "text, windows": text_stl().replace("\n", "\r\n"),
    "text, tabs": text_stl().replace("  ", "\t"),
    "text, no name": text_stl(name=""),
    "text, byte-order mark": "\ufeff" + text_stl(),
    "text, two solids": text_stl(TRIANGLES[:4], "a") + text_stl(TRIANGLES[4:], "b"),
}


def ply(order="", faces=TRIANGLES, index="vertex_indices", kind="float", extra=False, edges=False):
    form = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = f"ply\nformat {form} 1.0\ncomment Created in Blender version 4.1.0\nobj_info made here\n"
    head += f"element vertex {len(POINTS)}\n" + "".join(f"property {kind} {axis}\n" for axis in "xyz")
    more = ["float nx", "float ny", "float nz", "float s", "float t", "uchar red", "uchar green", "uchar blue"]
    head += "".join(f"property {p}\n" for p in more) if extra else ""
    head += f"element face {len(faces)}\nproperty list uchar int {index}\n"
    head += "element edge 1\nproperty int vertex1\nproperty int vertex2\n" if edges else ""
    head += "end_header\n"
    if not order:
        tail = " 0 0 1 0.5 0.5 255 0 255" if extra else ""
        rows = [" ".join(map(str, p)) + tail for p in POINTS] + [f"{len(f)} {' '.join(map(str, f))}" for f in faces]
        return head + "\n".join([*rows, *(["0 1"] if edges else [])]) + "\n"
    more_bytes = struct.pack(order + "5f3B", 0, 0, 1, 0.5, 0.5, 255, 0, 255) if extra else b""
    floats = order + ("3d" if kind == "double" else "3f")
    data = b"".join(struct.pack(floats, *p) + more_bytes for p in POINTS)
    data += b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
    return head.encode() + data + (struct.pack(order + "2i", 0, 1) if edges else b"")


PLY = {
    "text": ply(),
    "text, vertex_index": ply(index="vertex_index"),
    "text, all that Blender adds": ply(extra=True, edges=True, faces=MIXED),
    "little endian": ply("<"),
    "little endian, mixed, colours": ply("<", faces=MIXED, extra=True),
    "little endian, doubles, edges": ply("<", kind="double", edges=True, index="vertex_index"),
    "big endian": ply(">", extra=True),
    "windows": ply().replace("\n", "\r\n"),
}


def inp(kind, cells, points=POINTS, first=1, step=1, part=True):
    nodes = "".join(f"{first + step * k:7d}, {x:12.6g}, {y:12.6g}, {z:12.6g}\n" for k, (x, y, z) in enumerate(points))
    rows = "".join(f"{k + 1}, {', '.join(str(first + step * i) for i in c)}\n" for k, c in enumerate(cells))
    head = "*Heading\n** Generated by: Abaqus/CAE 2023\n*Part, name=Part-1\n" if part else ""
    tail = (
        f"*Nset, nset=Set-1, generate\n 1, 3, 1\n*Elset, elset=All, generate\n 1, {len(cells)}, 1\n"
        "*Shell Section, elset=All, material=Steel\n0.1, 5\n*End Part\n*Assembly, name=Assembly\n"
        "*Instance, name=Part-1-1, part=Part-1\n*End Instance\n*End Assembly\n"
        "*Material, name=Steel\n*Elastic\n70., 0.3\n"
    )
    return head + f"*Node\n{nodes}*Element, type={kind}\n{rows}" + (tail if part else "")


INP = {
    **{f"triangles {kind}": inp(kind, TRIANGLES) for kind in ("S3", "S3R", "STRI3", "M3D3", "CPS3", "SFM3D3", "R3D3")},
    **{f"quads {kind}": inp(kind, QUADS) for kind in ("S4", "S4R", "M3D4R", "CPE4")},
    "numbers with gaps": inp("S3", TRIANGLES, first=15, step=10, part=False),
    "small letters": inp("S3", TRIANGLES).lower(),
}

FILES = [
    (f"{kind}-{name}", kind, text)
    for kind, group in (("obj", OBJ), ("stl", STL), ("ply", PLY), ("inp", INP))
    for name, text in group.items()
]


def write(folder: Path, kind: str, text: str | bytes) -> Path:
    path = folder / f"card.{kind}"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def read_quietly(path: Path, weld: bool | None = None):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshRepaired)
        return read_sheet(path, "mm", weld)


@pytest.mark.parametrize(("kind", "text"), [(k, t) for _, k, t in FILES], ids=[name for name, _, _ in FILES])
@pytest.mark.parametrize("upper", [False, True])
def test_one_sheet_as_several_programs_write_it(tmp_path: Path, kind: str, text: str | bytes, upper: bool) -> None:
    mesh = read_quietly(write(tmp_path, kind.upper() if upper else kind, text))
    assert len(mesh.nodes) == 12 and len(mesh.triangles) == 12
    assert mesh.areas.sum() == pytest.approx(AREA, rel=1e-6)
    a, b, c = np.moveaxis(mesh.nodes[mesh.triangles], 1, 0)
    assert np.cross(b - a, c - a)[:, 2].min() > 0.0


def test_relative_indices_count_back_from_their_line(tmp_path: Path) -> None:
    mesh = read_quietly(write(tmp_path, "obj", RELATIVE), weld=True)
    assert len(mesh.nodes) == 12 and mesh.areas.sum() == pytest.approx(AREA, rel=1e-6)


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("version", ["gmsh22", "gmsh"])
def test_gmsh_of_both_versions(tmp_path: Path, version: str, binary: bool) -> None:
    sheet, solid = meshio.Mesh(POINTS, [("triangle", TRIANGLES)]), meshio.Mesh(TET_POINTS, [("tetra", TETS)])
    for name, mesh in (("sheet.msh", sheet), ("SOLID.MSH", solid)):
        meshio.write(tmp_path / name, mesh, file_format=version, binary=binary)
    assert read_quietly(tmp_path / "sheet.msh").areas.sum() == pytest.approx(AREA)
    assert len(read_solid(tmp_path / "SOLID.MSH", "mm").tets) == 2


@pytest.mark.parametrize("kind", ["C3D4", "DC3D4", "C3D4H"])
def test_tetrahedra_of_abaqus(tmp_path: Path, kind: str) -> None:
    solid = read_solid(write(tmp_path, "inp", inp(kind, TETS, TET_POINTS)), "mm")
    assert len(solid.tets) == 2


def test_a_concave_quadrilateral_is_cut_inside(tmp_path: Path) -> None:
    """A dart of the area 4 with its reflex corner second: cut from the first corner it would cover 6."""
    path = write(tmp_path, "obj", "v 0 0 0\nv 1 1 0\nv 4 0 0\nv 1 3 0\nf 1 2 3 4\n")
    assert read_quietly(path).areas.sum() == pytest.approx(4e-6)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (obj().replace("f 1 4 5", "f 1 4 99"), "an element with the corner 98"),
        (obj(corner="{1}").replace("f -12", "f -40"), "an element with the corner -28"),
        (obj().replace("f 1 4 5", "f 0 4 5"), r"the face '0 4 5' in line 13"),
        (obj([[0, 3, 6, 7, 4, 1]]), "has polygon, and triangles are wanted"),
    ],
)
def test_faces_that_are_none_are_named(tmp_path: Path, text: str, fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        read_sheet(write(tmp_path, "obj", text), "mm")


@pytest.mark.skipif(not ROOT.is_dir(), reason="the shared inputs are not here")
@pytest.mark.parametrize("name", ["vt", "rgb", "neg", "bom"])
def test_shared_exports(name: str) -> None:
    mesh = read_sheet(ROOT / "obj_exports" / f"{name}.obj", "m")
    assert (len(mesh.nodes), len(mesh.triangles)) == (44, 60)
    assert mesh.areas.sum() == pytest.approx(0.003)
