"""What is measured on shapes at rest, against differences: the curvature operator, and what contacts exert and
remember."""

from __future__ import annotations

import numpy as np
import pytest
from test_rest_shape import check, shake

from sim_core.energies.curvature import curvature_operator
from sim_core.energies.curvature_rest import CurvatureRest
from sim_core.energies.membrane import material_frames
from sim_core.errors import ConfigError
from sim_core.geometry.sheets import find_hinges, rectangle
from sim_core.gradients import Tape
from sim_core.rigs import parse_rig
from sim_core.scene import build_scene


@pytest.mark.parametrize("pattern", ["regular", "crossed", "irregular"])
def test_curvature_operator_against_its_differences(pattern):
    """Of a crumpled sheet of which a part is held, in axes that are oblique."""
    rng = np.random.default_rng(0)
    mesh = rectangle(0.08, 0.04, (6, 4), pattern)
    x, triangles = mesh.nodes + 4e-4 * rng.standard_normal(mesh.nodes.shape), mesh.triangles
    hinges = find_hinges(triangles)
    rigid = (mesh.nodes[:, 0] < -0.02)[triangles].all(axis=1)
    axes = np.broadcast_to([0.8, 0.6, 0.1], (len(triangles), 3))

    def operator(x):
        return curvature_operator(x, triangles, hinges, material_frames(x, triangles, axes), rigid)

    rest = CurvatureRest(x, triangles, hinges, axes, rigid)
    given = rng.standard_normal((rest.pairs.shape[1], 3))
    where, of = (3 * rest.pairs[0][:, None] + np.arange(3)).ravel(), np.repeat(rest.pairs[1], 3)
    inside = np.zeros(operator(x).shape, dtype=bool)
    inside[where, of] = True
    assert 0 < rigid.sum() < len(rigid) and not np.any(operator(x).toarray()[~inside])
    found = rest.back(given)
    for along in (rng.standard_normal(x.shape), *np.eye(x.size)[[40, -20]].reshape(2, *x.shape)):
        ends = [np.asarray(operator(x + s * along)[where, of]).ravel() @ given.ravel() for s in (1e-8, -1e-8)]
        scale = np.abs(found).max() * np.linalg.norm(along)
        assert abs((ends[0] - ends[1]) / 2e-8 - np.vdot(found, along)) < 1e-6 * scale


def cards():
    """Two cards 10 um apart, within the gap of 27 um that contact counts from before it; their edges are parallel but
    for half a degree."""
    shape = {"type": "rectangle", "length_m": 0.03, "width_m": 0.02, "cells": [3, 2]}
    material = {"E_pa": 2.0e9, "nu": 0.3, "thickness_m": 2.0e-4, "density_kg_m3": 700.0}
    pose = {"position_m": [1e-3, 4e-5, 2.1e-4 - 2.7e-5], "rpy_deg": [0.0, 0.0, 0.5]}
    plate = {"position_m": [2e-3, 1e-3, -1.1e-4 + 2.7e-5 - 0.01]}
    return parse_rig(
        {
            "name": "cards",
            "gravity_m_s2": [0.5, 0.3, -20.0],
            "solver": {"dt_s": 0.0005},
            "bodies": {
                "low": {"type": "sheet", "shape": shape, "material": material},
                "high": {"type": "sheet", "shape": shape, "material": material, "pose": pose},
                "plate": {"type": "rigid", "shape": {"type": "box", "size_m": [0.013, 0.009, 0.02]}, "pose": plate},
            },
            "contacts": [
                {"between": ["low", "high"], "friction": 0.4},
                {"between": ["low", "plate"], "friction": 0.4},
            ],
            "sensors": {
                f"on_{name}": {"type": "markers", "body": name, "points": {"grid": [3, 2]}, "topic": f"on/{name}"}
                for name in ("low", "high")
            },
        },
        "cards",
    )


def test_every_contact_against_differences_of_rollouts():
    """Cards that fall on one another and on a plate, with points and edges; some of them slide."""
    scene, times = build_scene(cards()), np.linspace(0.0, 0.008, 17)
    shake(scene, 1e-6)
    state = Tape(scene, {}, times).end.internals
    assert sum(np.count_nonzero(own["slip_speed"]) for own in state.values() if "slip_speed" in own) > 5
    for name in ("low-high.0", "low-high.1", "low-plate", "low-plate.core0.points", "low-plate.core0.edges"):
        assert np.any(state[f"contact.{name}"]["load"]), name
    check(scene, {}, times, 1e-5, singles=1, steps=(1e-8, 3e-9, 3e-8))


def test_a_strip_of_one_cell_has_no_derivative_of_its_bending():
    """Its hinges leave one component of the curvature open; a node that moves makes it appear."""
    mesh = rectangle(0.08, 0.01, (6, 1), "regular")
    axes = np.broadcast_to([1.0, 0.0, 0.0], (len(mesh.triangles), 3))
    with pytest.raises(ConfigError, match="two cells in each direction"):
        rigid = np.zeros(len(mesh.triangles), dtype=bool)
        CurvatureRest(mesh.nodes, mesh.triangles, find_hinges(mesh.triangles), axes, rigid)
