"""Bodies of a rig whose shapes come from mesh files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import yaml

from sim_core.errors import ConfigError
from sim_core.geometry import solids
from sim_core.geometry.sheets import rectangle
from sim_core.rigs import load_rig, parse_rig, rig_to_yaml
from sim_core.scene.scene import build_scene
from sim_core.simulate import Simulation

ARCH = rectangle(60.0, 20.0, (6, 2), "crossed")
GEL = solids.block((20.0, 10.0, 10.0), (2, 1, 1))


def rig_file(folder: Path, **changes: Any) -> Path:
    """A rig with an arch of foil and a gel next to it, in a folder of its own, meshes in another."""
    (folder / "meshes").mkdir()
    (folder / "rigs").mkdir()
    bent = ARCH.nodes.copy()
    bent[:, 0], bent[:, 2] = 25.0 * np.sin(ARCH.nodes[:, 0] / 25.0), 25.0 * np.cos(ARCH.nodes[:, 0] / 25.0)
    meshio.write(folder / "meshes/arch.obj", meshio.Mesh(bent, [("triangle", ARCH.triangles)]))
    meshio.write(folder / "meshes/gel.vtu", meshio.Mesh(GEL.nodes, [("tetra10", GEL.tets)]))
    data: dict[str, Any] = {
        "name": "own",
        "solver": {"dt_s": 0.01},
        "bodies": {
            "arch": {
                "type": "sheet",
                "shape": {"type": "mesh", "file": "../meshes/arch.obj", "unit": "mm"},
                "material": {"E_pa": 3e9, "nu": 0.3, "thickness_m": 1e-4, "density_kg_m3": 1300.0},
            },
            "gel": {
                "type": "gel",
                "shape": {
                    "type": "mesh",
                    "file": "../meshes/gel.vtu",
                    "unit": "mm",
                    "face_regions": {"base": {"z_m": [0.0, 0.0]}},
                },
                "pose": {"position_m": [0.1, 0.0, 0.0]},
                "material": {"E_pa": 1e5, "nu": 0.4, "density_kg_m3": 1000.0},
                "bonded": "base",
                "mount": "world",
            },
        },
        "clamps": [{"body": "arch", "region": {"z_m": [-1.0, 0.0176]}, "mount": "world"}],
        "sensors": {
            "crown": {
                "type": "markers", "body": "arch", "points": {"positions_m": [[0.0, 0.0, 0.025]]},
                "frame_id": "arch", "rate_hz": 10.0, "topic": "crown",
            }
        },
    }  # fmt: skip
    for path, value in changes.items():
        target: Any = data
        *parents, last = path.split("__")
        for step in parents:
            target = target[step]
        target[last] = value
    path = folder / "rigs/own.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def test_files_are_found_from_the_folder_of_the_rig_and_survive_a_round_trip(tmp_path: Path) -> None:
    rig = load_rig(rig_file(tmp_path))
    assert parse_rig(yaml.safe_load(rig_to_yaml(rig)), "again") == rig
    assert rig.bodies["arch"].shape.bounds()[1, 2] == pytest.approx(0.025)
    assert rig.bodies["gel"].shape.faces == ("base",)


def test_a_curved_sheet_is_at_rest_as_its_mesh_is(tmp_path: Path) -> None:
    rig = load_rig(rig_file(tmp_path, gravity_m_s2=[0.0, 0.0, 0.0]))
    simulation = Simulation(build_scene(rig))
    arch = simulation.scene.bodies["arch"]
    assert simulation.state.x[arch.nodes] == pytest.approx(arch.rest, abs=1e-9)
    seen = simulation.read()["crown"]
    assert seen == pytest.approx(np.array([[0.0, 0.0, 0.025]]), abs=1e-4)


def test_the_arch_sags_under_its_weight_and_stands(tmp_path: Path) -> None:
    simulation = Simulation(build_scene(load_rig(rig_file(tmp_path))))
    arch = simulation.scene.bodies["arch"]
    sunk = (arch.rest - simulation.state.x[arch.nodes])[:, 2].max()
    assert 1e-7 < sunk < 1e-3


@pytest.mark.parametrize("refine", [1, 2])
def test_meshes_are_refined_with_the_scene(tmp_path: Path, refine: int) -> None:
    scene = build_scene(load_rig(rig_file(tmp_path)), refine)
    assert len(scene.bodies["arch"].mesh.triangles) == refine**2 * len(ARCH.triangles)
    gel = scene.bodies["gel"]
    assert len(gel.mesh.tets) == refine**3 * len(GEL.tets)
    assert scene.held("gel").sum() == (4 * refine + 1) * (2 * refine + 1)


def test_tetrahedra_cannot_be_refined_by_three(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"by 2, 4, 8, \.\.\., not by 3"):
        build_scene(load_rig(rig_file(tmp_path)), 3)


REFUSED = [
    ({"bodies__arch__shape__unit": "m"}, r"bodies\.arch\.shape\.file is '.*arch\.obj'.*46.6 m large"),
    ({"bodies__arch__shape__file": "arch.obj"}, r"bodies\.arch\.shape\.file is '.*No such file"),
    ({"bodies__gel__bonded": "top"}, "is 'top', which is no face of a mesh"),
    ({"bodies__arch__shape__unit": "inch"}, r"bodies\.arch\.shape\.unit is the text 'inch'"),
    ({"sensors__crown__points": {"grid": [2, 2]}}, r"grid is given for a body whose shape is a mesh"),
    ({"sensors__crown__points": {"positions_m": [[0.0, 0.0, 0.015]]}}, "away from the sheet"),
]


@pytest.mark.parametrize(("changes", "words"), REFUSED)
def test_what_does_not_fit_is_refused_with_its_place(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        Simulation(build_scene(load_rig(rig_file(tmp_path, **changes))))
