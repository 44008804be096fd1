"""Gels whose cells are graded, and halves and quarters of them, as a rig has them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.rigs import Gel, Points, marker_positions, parse_rig
from sim_core.scene.scene import Scene, build_scene
from sim_core.simulate import Simulation
from sysid.validation.gels import HALF_SIDE, LAYER, MODULUS, RADIUS, THICKNESS

QUARTER = {"symmetry": ["x", "y"]}
GRADED = [{"towards": "x_middle", "ratio": 0.12}, {"towards": "y_middle", "ratio": 0.12}]


def rig_of(shape: dict[str, Any], nu: float = 0.3, **gel: Any) -> dict[str, Any]:
    """A ball above a gel that is bonded to the table, without weight and inertia."""
    return {
        "name": "layer",
        "gravity_m_s2": [0.0, 0.0, 0.0],
        "solver": {"inertia": False, "dt_s": 1.0},
        "bodies": {
            "gel": {
                "type": "gel",
                "shape": shape,
                "material": {"E_pa": MODULUS, "nu": nu, "density_kg_m3": 1000.0},
                "pose": {"position_m": [0.0, 0.0, -0.5 * THICKNESS]},
                "bonded": "bottom",
                "mount": "world",
                **gel,
            },
            "ball": {"type": "rigid", "shape": {"type": "sphere", "radius_m": RADIUS}, "mount": "hand"},
        },
        "end_effectors": {"hand": {"start": {"position_m": [0.0, 0.0, RADIUS + 1e-6]}}},
        "contacts": [{"between": ["gel", "ball"], "stiffness_pa_per_m": 2e11, "range_m": 4e-7}],
        "sensors": {"wrench": {"type": "wrench", "on": "ball", "frame_id": "ball", "rate_hz": 10.0, "topic": "wrench"}},
    }


def turned(degrees: float) -> dict[str, Any]:
    """Pose of the layer, turned about the vertical."""
    return {"position_m": [0.0, 0.0, -0.5 * THICKNESS], "rpy_deg": [0.0, 0.0, degrees]}


def built(data: dict[str, Any]) -> Scene:
    """The scene of the rig."""
    return build_scene(parse_rig(data, "test"))


def pressed(data: dict[str, Any], depth: float, steps: int = 4) -> np.ndarray:
    """Force on the ball [N] ``(3,)``."""
    simulation = Simulation(built(data))
    for k in range(1, steps + 1):
        place = np.array([0.0, 0.0, RADIUS - depth * k / steps])
        simulation.step({"hand": (place, Rotation.identity())}, 1.0)
    return simulation.read()["wrench"][:3]


def layer(cells: list[int], **more: Any) -> dict[str, Any]:
    return {"type": "block", "size_m": [2 * HALF_SIDE, 2 * HALF_SIDE, THICKNESS], "cells": cells, **more}


@pytest.mark.parametrize("nu", [0.3, 0.49])
def test_a_graded_quarter_of_a_bonded_layer_bears_a_ball_within_one_percent(nu: float) -> None:
    chi, reference = LAYER[nu]
    depth = (chi * THICKNESS) ** 2 / RADIUS
    graded = [*GRADED, {"towards": "top", "ratio": 0.5}]
    force = 4.0 * pressed(rig_of(layer([16, 16, 4], graded=graded, **QUARTER), nu), depth, steps=2)[2]
    hertz = 4.0 / 3.0 * MODULUS / (1.0 - nu**2) * np.sqrt(RADIUS) * depth**1.5
    assert force / hertz == pytest.approx(reference, rel=0.01)


def test_a_quarter_bears_a_quarter_of_what_the_whole_bears() -> None:
    """Of a mesh that is its own mirror image in both planes."""
    whole = pressed(rig_of(layer([8, 8, 2], graded=GRADED)), 3e-5)
    part = pressed(rig_of(layer([8, 8, 2], graded=GRADED, **QUARTER)), 3e-5)
    half = pressed(rig_of(layer([8, 8, 2], graded=GRADED, symmetry=["y"])), 3e-5)
    assert np.abs(whole[:2]).max() < 1e-6 * whole[2]
    assert 4.0 * part[2] == pytest.approx(whole[2], rel=1e-6)
    assert 2.0 * half[2] == pytest.approx(whole[2], rel=1e-6)


def test_nodes_of_a_plane_of_symmetry_follow_the_mount_along_its_normal_alone() -> None:
    data = rig_of(layer([4, 4, 1], symmetry=["x"]), pose=turned(90.0))
    scene = built(data)
    gel = scene.bodies["gel"]
    plane = gel.mesh.node_sets["x_cut"]
    held = scene._prescribed[gel.nodes]
    loose = np.setdiff1d(plane, gel.mesh.node_sets["bottom"])
    assert held[loose].tolist() == [[False, True, False]] * len(loose)
    assert np.abs(gel.rest[plane, 1]).max() < 1e-12
    elsewhere = np.setdiff1d(np.arange(len(gel.nodes)), np.union1d(plane, gel.mesh.node_sets["bottom"]))
    assert not held[elsewhere].any()


def test_a_plane_of_symmetry_askew_to_the_world_is_refused() -> None:
    data = rig_of(layer([4, 4, 1], symmetry=["x"]), pose=turned(30.0))
    with pytest.raises(ConfigError, match="plane of symmetry of gel normal to its x axis is not normal to an axis"):
        built(data)


def test_contact_is_looked_for_on_the_free_faces_of_a_part_only() -> None:
    gel = built(rig_of(layer([4, 4, 1], **QUARTER))).bodies["gel"]
    from sim_core.scene.assembly import contact_triangles

    centres = gel.rest[contact_triangles(gel)].mean(axis=1)
    assert centres[:, :2].min() > 1e-6
    assert centres[:, 2].min() > -THICKNESS + 1e-6


DISC = {"type": "disc", "radius_m": 0.012, "height_m": THICKNESS, "cells": [4, 2, 2]}


def test_a_disc_stands_at_its_centre_and_takes_markers_on_its_faces() -> None:
    scene = built(rig_of({**DISC, "graded": [{"towards": "top", "ratio": 0.5}, {"towards": "axis", "ratio": 0.6}]}))
    gel = scene.bodies["gel"]
    assert gel.rest[:, 2].min() == pytest.approx(-THICKNESS)
    assert gel.rest[:, 2].max() == pytest.approx(0.0, abs=1e-12)
    spec = gel.spec
    assert isinstance(spec, Gel)
    top, ids = marker_positions(Points(face="top", grid=(5, 5)), spec)
    assert len(top) == 21 and len(ids) == 21 and 0 not in ids
    assert top[:, 2] == pytest.approx(np.full(21, 0.5 * THICKNESS))
    side, _ = marker_positions(Points(face="side", grid=(2, 8)), spec)
    assert np.hypot(side[:, 0], side[:, 1]) == pytest.approx(np.full(16, 0.012))


@pytest.mark.parametrize("points", [{"face": "top", "grid": [4, 4]}, {"face": "side", "grid": [2, 7]}])
def test_markers_on_a_disc_are_found_in_its_elements(points: dict[str, Any]) -> None:
    data = rig_of(DISC)
    data["sensors"]["skin"] = {
        "type": "markers", "body": "gel", "points": points, "frame_id": "gel", "rate_hz": 10.0, "topic": "skin",
    }  # fmt: skip
    simulation = Simulation(built(data))
    seen = simulation.read()["skin"]
    expected, _ = marker_positions(simulation.scene.rig.sensors["skin"].points, simulation.scene.rig.bodies["gel"])
    assert seen == pytest.approx(expected, abs=1e-9)


REFUSED = [
    ({"graded": [{"towards": "middle", "ratio": 0.5}]}, "is 'middle', which is no place of a block"),
    ({"graded": [{"towards": "top", "ratio": 0.5}] * 2}, "names top twice"),
    ({"symmetry": ["x"], "cells": [3, 4, 1]}, "half of the body along x, where the whole has 3 cells"),
    ({"symmetry": ["x", "x"]}, "names an axis twice"),
    ({"refine": [{"x_m": [0.03, 0.04], "edge_m": 1e-3}]}, "misses the body, which reaches from -0.02 to 0.02 m"),
    ({"refine": [{"x_m": [0.0, 0.01]}]}, "edge_m is missing"),
]


@pytest.mark.parametrize(("change", "words"), REFUSED)
def test_what_cannot_be_meshed_is_refused_with_its_place(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse_rig(rig_of({**layer([4, 4, 1]), **change}), "test")


def test_a_face_that_symmetry_cuts_off_cannot_be_bonded() -> None:
    with pytest.raises(ConfigError, match="is 'x_min', which is no face of a block"):
        parse_rig(rig_of(layer([4, 4, 1], symmetry=["x"]), bonded="x_min"), "test")
