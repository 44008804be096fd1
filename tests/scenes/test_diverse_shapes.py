"""Bodies of other shapes than slabs: each goes through its experiment without a failed step."""

from __future__ import annotations

import runpy
import warnings
from pathlib import Path

import numpy as np
import pytest

from sim_core.geometry.mesh_file import MeshRepaired
from sim_core.rigs import config_folder, load_rig
from sim_core.rigs.motion import compile_experiment, load_experiment
from sim_core.scene.scene import build_scene
from sim_core.simulate import simulate

SHAPES = {"envelope": "paper", "gel_ear": "ear", "glove_finger": "glove", "mug_side": "mug", "punched_card": "card"}
MESHES = config_folder() / "meshes"


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
def test_a_ball_is_pressed_on_the_body_and_leaves_it(name: str) -> None:
    rig = load_rig(name)
    poses = compile_experiment(load_experiment("touch"), rig)
    end = max(float(p.times[-1]) for p in poses.values())
    trace = simulate(build_scene(rig), poses, np.arange(0.0, end, rig.solver.dt_s))
    force = np.linalg.norm(trace.outputs["wrench"][:, :3], axis=1)
    assert force.max() > 1e-3
    assert force[0] == 0.0
    assert force[-1] == 0.0
    assert trace.reports[-1].contacts == 0


@pytest.mark.parametrize("name", SHAPES)
def test_the_bodies_are_built_without_a_repair(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", MeshRepaired)
        assert len(build_scene(load_rig(name)).bodies[SHAPES[name]].nodes) < 700


def test_the_slit_parts_and_the_hole_is_open() -> None:
    card = build_scene(load_rig("punched_card")).bodies["card"]
    _, count = np.unique(np.round(card.rest, 9), axis=0, return_counts=True)
    assert np.sum(count == 2) == 5
    away = np.linalg.norm(card.rest[:, :2] - [-0.015, 0.01], axis=1)
    assert away.min() == pytest.approx(0.005)


def test_the_meshes_are_those_that_the_script_makes(tmp_path: Path) -> None:
    made = runpy.run_path(str(MESHES / "make_meshes.py"))
    made["main"](tmp_path)
    for path in tmp_path.iterdir():
        assert path.read_text() == (MESHES / path.name).read_text()
    assert len(list(tmp_path.iterdir())) == 4
