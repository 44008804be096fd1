"""Makes the meshes in this folder: ``python config/meshes/make_meshes.py``. All coordinates are in mm."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np

from sim_core.geometry.sheets import SheetMesh, rectangle
from sim_core.geometry.solids import block


def mug_side() -> SheetMesh:
    """The side of a tapered mug of 40 to 34 mm radius and 60 mm height, its axis along x, 100 degrees of it, open."""
    flat = rectangle(60.0, 100.0, (8, 10), "crossed")
    radius = 37.0 - 0.05 * flat.nodes[:, 0]
    angle = np.deg2rad(flat.nodes[:, 1])
    nodes = np.column_stack([flat.nodes[:, 0], radius * np.sin(angle), radius * np.cos(angle)])
    return SheetMesh(nodes, flat.triangles)


def punched_card() -> SheetMesh:
    """A card of 80 x 50 mm with a round hole of 10 mm diameter and a slit of 30 mm along x, whose sides part."""
    flat = rectangle(80.0, 50.0, (16, 10), "crossed")
    centres = flat.nodes[flat.triangles].mean(axis=1)
    hole = np.array([-15.0, 10.0])
    kept = flat.triangles[np.abs(centres[:, :2] - hole).max(axis=1) > 5.0]
    rim = np.abs(np.abs(flat.nodes[:, :2] - hole).max(axis=1) - 5.0) < 1e-9
    nodes = flat.nodes.copy()
    away = nodes[rim, :2] - hole
    nodes[rim, :2] = hole + 5.0 * away / np.linalg.norm(away, axis=1, keepdims=True)
    on_slit = np.flatnonzero((np.abs(nodes[:, 1] + 5.0) < 1e-9) & (nodes[:, 0] > -1e-9) & (nodes[:, 0] < 30.0 + 1e-9))
    on_slit = on_slit[np.argsort(nodes[on_slit, 0])][1:-1]
    twin = np.arange(len(nodes))
    twin[on_slit] = len(nodes) + np.arange(len(on_slit))
    above = centres[np.abs(centres[:, :2] - hole).max(axis=1) > 5.0, 1] > -5.0
    triangles = np.where(above[:, None], twin[kept], kept)
    nodes = np.vstack([nodes, nodes[on_slit]])
    used, triangles = np.unique(triangles, return_inverse=True)
    return SheetMesh(nodes[used], triangles.reshape(-1, 3).astype(np.int32))


def glove_finger() -> SheetMesh:
    """A tube of 8 mm radius and 36 mm length along x, open at its left, closed by half a ball at its right."""
    around, radius = 14, 8.0
    rings = [(x, radius) for x in np.linspace(-18.0, 18.0, 10)]
    rings += [(18.0 + radius * np.sin(a), radius * np.cos(a)) for a in np.deg2rad([22.5, 45.0, 67.5])]
    nodes = []
    for k, (x, r) in enumerate(rings):
        angle = 2.0 * np.pi * (np.arange(around) + 0.5 * (k % 2)) / around
        nodes.append(np.column_stack([np.full(around, x), r * np.sin(angle), r * np.cos(angle)]))
    triangles = []
    first = np.arange(around)
    for k in range(len(rings) - 1):
        low, high = first + k * around, first + (k + 1) * around
        after, above = np.roll(low, -1), np.roll(high, -1)
        pairs = [(low, high, after), (after, high, above)] if k % 2 == 0 else [(low, high, above), (low, above, after)]
        triangles += [np.column_stack(p) for p in pairs]
    last = first + (len(rings) - 1) * around
    tip = len(rings) * around
    triangles.append(np.column_stack([last, np.full(around, tip), np.roll(last, -1)]))
    return SheetMesh(np.vstack([*nodes, [[18.0 + radius, 0.0, 0.0]]]), np.vstack(triangles).astype(np.int32))


def ear() -> meshio.Mesh:
    """An auricle: a bow of gel about z with a thick rim, wide at its middle, its foot at z = 0 a named face."""
    solid = block((2.0, 2.0, 1.0), (10, 3, 2))
    used, tets = np.unique(solid.tets[:, :4], return_inverse=True)
    s, t, z = solid.nodes[used].T
    angle = -np.deg2rad(110.0) * s
    width = 5.0 + 4.0 * np.cos(0.5 * np.pi * s)
    radius = 12.0 + 0.5 * width * t
    height = 5.0 * (1.0 + 0.2 * t)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height * z])
    number = np.full(len(solid.nodes), -1)
    number[used] = np.arange(len(used))
    foot = number[solid.surface[solid.face_sets["bottom"], :3]]
    tets = tets.reshape(-1, 4)
    tags = [np.full(len(tets), 2), np.full(len(foot), 1)]
    return meshio.Mesh(
        points,
        [("tetra", tets), ("triangle", foot)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"foot": np.array([1, 2]), "ear": np.array([2, 3])},
    )


def main(folder: Path) -> None:
    """Write all meshes."""
    for name, mesh in (("mug_side.obj", mug_side()), ("punched_card.obj", punched_card())):
        meshio.write(folder / name, meshio.Mesh(np.round(mesh.nodes, 9), [("triangle", mesh.triangles)]))
    finger = glove_finger()
    meshio.write(folder / "glove_finger.ply", meshio.Mesh(finger.nodes, [("triangle", finger.triangles)]), binary=False)
    meshio.write(folder / "ear.msh", ear(), file_format="gmsh22", binary=False)
    for path in (folder / "mug_side.obj", folder / "punched_card.obj", folder / "glove_finger.ply"):
        lines = path.read_text().splitlines(keepends=True)
        path.write_text("".join(line for line in lines if "meshio" not in line))  # the time of day


if __name__ == "__main__":
    main(Path(__file__).resolve().parent)
