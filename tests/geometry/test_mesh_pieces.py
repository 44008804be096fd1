"""Bodies hold together: seams are welded aloud or refused, pieces and what holds them are said."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.geometry.mesh_checks import pieces_of
from sim_core.geometry.mesh_file import MeshRepaired, read_sheet
from sim_core.geometry.sheets import rectangle
from sim_core.preflight import review
from sim_core.rigs import Rig, load_rig, parse_rig

FAULT = (
    Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
    / "faults"
    / "mesh_in_pieces"
)
SHEET = rectangle(40.0, 20.0, (8, 4), "crossed")
"""In mm; its shortest edges are 3.5 mm."""


def stl(path: Path, triangles: np.ndarray) -> Path:
    """A text STL of triangles [mm] ``(m, 3, 3)``."""
    facets = "".join(
        "facet normal 0 0 1\nouter loop\n"
        + "".join("vertex {:.9g} {:.9g} {:.9g}\n".format(*p) for p in t)
        + "endloop\nendfacet\n"
        for t in triangles
    )
    path.write_text(f"solid x\n{facets}endsolid x\n")
    return path


def obj(path: Path, points: np.ndarray, triangles: np.ndarray) -> Path:
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*p) for p in points] + ["f {} {} {}".format(*(t + 1)) for t in triangles]
    path.write_text("\n".join(lines) + "\n")
    return path


def torn(gap_mm: float) -> np.ndarray:
    """Triangles whose corners each miss their place by up to so much."""
    draw = np.random.default_rng(3)
    corners = SHEET.nodes[SHEET.triangles]
    return corners + gap_mm * draw.uniform(-0.5, 0.5, corners.shape) * [1.0, 1.0, 0.0]


@pytest.mark.parametrize("gap_mm", [1e-5, 1e-3])
def test_seams_of_an_stl_file_are_welded_aloud(tmp_path: Path, gap_mm: float) -> None:
    with pytest.warns(MeshRepaired, match=r"(welded|joined): \d+ vertices became " + str(len(SHEET.nodes))):
        mesh = read_sheet(stl(tmp_path / "torn.stl", torn(gap_mm)), "mm")
    assert len(mesh.nodes) == len(SHEET.nodes) and pieces_of(mesh.triangles).max() == 0
    assert mesh.areas.sum() == pytest.approx(8e-4, rel=1e-3)


def test_gaps_wider_than_a_degenerate_element_are_no_seams(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="vertices on edges of other triangles, which they do not share"):
        read_sheet(stl(tmp_path / "torn.stl", torn(0.01)), "mm")
    apart = SHEET.nodes[SHEET.triangles]
    middle = apart.mean(axis=1, keepdims=True)
    mesh = read_sheet(stl(tmp_path / "apart.stl", middle + 0.9 * (apart - middle)), "mm")
    assert pieces_of(mesh.triangles).max() + 1 == len(SHEET.triangles)


def halves(gap_mm: float) -> tuple[np.ndarray, np.ndarray]:
    points = np.vstack([SHEET.nodes, SHEET.nodes + [40.0 + gap_mm, 0.0, 0.0]])
    return points, np.vstack([SHEET.triangles, SHEET.triangles + len(SHEET.nodes)])


def test_a_seam_of_other_files_is_refused_until_the_rig_says(tmp_path: Path) -> None:
    path = obj(tmp_path / "halves.obj", *halves(1e-3))
    with pytest.raises(ConfigError, match=r"5 pairs of vertices at one place but for up to 1e-06 m") as caught:
        read_sheet(path, "mm")
    assert "weld: true" in caught.value.remedy
    with pytest.warns(MeshRepaired, match=r"Seams up to 1e-06 m wide were welded"):
        assert pieces_of(read_sheet(path, "mm", weld=True).triangles).max() == 0
    assert pieces_of(read_sheet(path, "mm", weld=False).triangles).max() == 1


def test_a_vertex_on_the_edge_of_another_triangle_is_refused(tmp_path: Path) -> None:
    """One side of the seam has a vertex in the middle, which the other lacks."""
    points = np.array([[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0], [5, 0, 0], [0, -10, 0], [10, -10, 0.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [5, 4, 0], [5, 6, 4], [6, 1, 4]])
    path = obj(tmp_path / "t.obj", points, triangles)
    with pytest.raises(ConfigError, match=r"vertices on edges of other triangles.*: 4, as 4 on the edge \[0, 1\]"):
        read_sheet(path, "mm")


def rig_of(file: Path, clamps: list[dict], inertia: bool = False) -> Rig:
    return parse_rig(
        {
            "name": "pull",
            "solver": {"dt_s": 0.05, "inertia": inertia},
            "bodies": {
                "card": {
                    "type": "sheet",
                    "shape": {"type": "mesh", "file": str(file), "unit": "mm", "weld": False},
                    "material": {"E_pa": 2.0e9, "nu": 0.3, "thickness_m": 1.0e-4, "density_kg_m3": 1400.0},
                }
            },
            "clamps": clamps,
            "end_effectors": {"hand": {}},
        },
        "rig",
    )


JAW = {"name": "jaw", "body": "card", "region": {"x_m": [-0.021, -0.014]}, "mount": "world"}
GRIP = {"name": "grip", "body": "card", "region": {"x_m": [0.054, 0.07]}, "mount": "hand"}


def test_a_piece_that_nothing_holds_is_refused_when_the_rig_is_read(tmp_path: Path) -> None:
    path = obj(tmp_path / "halves.obj", *halves(1.0))
    with pytest.raises(
        ConfigError, match=r"bodies\.card is in 2 pieces, and piece 2 \(128 elements, x 0\.021 to 0\.061"
    ):
        rig_of(path, [JAW])
    with pytest.raises(ConfigError, match=r"bodies\.card is in 2 pieces, and piece 1"):
        rig_of(path, [])


def test_pieces_that_are_held_or_free_to_fall_are_said(tmp_path: Path) -> None:
    path = obj(tmp_path / "halves.obj", *halves(1.0))
    (said,) = [f.problem for f in review(rig_of(path, [JAW, GRIP])) if f.kind == "pieces"]
    assert "card is in 2 pieces" in said and "held by jaw;" in said and "held by grip." in said
    (said,) = [f.problem for f in review(rig_of(path, [JAW], inertia=True)) if f.kind == "pieces"]
    assert "held by nothing" in said


def test_a_whole_body_that_nothing_holds_is_refused(tmp_path: Path) -> None:
    path = obj(tmp_path / "one.obj", SHEET.nodes, SHEET.triangles)
    with pytest.raises(ConfigError, match=r"bodies\.card is held by nothing: no clamp and no contact"):
        rig_of(path, [])
    rig_of(path, [], inertia=True)
    assert not [f for f in review(rig_of(path, [JAW])) if f.kind == "pieces"]


@pytest.mark.skipif(not FAULT.is_dir(), reason="the shared inputs are not here")
def test_shared_meshes_in_pieces() -> None:
    with pytest.warns(MeshRepaired, match="180 vertices became 44"):
        mesh = read_sheet(FAULT / "cracked.stl", "m")
    assert pieces_of(mesh.triangles).max() == 0 and mesh.areas.sum() == pytest.approx(0.003, rel=1e-4)
    with pytest.raises(ConfigError, match=r"is in 2 pieces, and piece 2 .* is held by nothing"):
        load_rig(str(FAULT / "rig_two_parts.yaml"))
