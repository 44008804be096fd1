"""Sheets that are folded at rest: no stretch, no moment, the shape that was asked for."""

import numpy as np
import pytest
from potentials import Look

from sim_core.errors import ConfigError
from sim_core.geometry.folds import Fold, folded
from sim_core.geometry.sheets import rectangle
from sim_core.rigs import parse_rig
from sim_core.scene import build_scene


def lines(mesh):
    return np.unique(mesh.nodes[mesh.nodes[:, 1] == mesh.nodes[:, 1].min(), 0])


@pytest.mark.parametrize("pattern", ["regular", "crossed"])
def test_no_edge_of_a_folded_mesh_is_stretched(pattern):
    mesh = rectangle(0.1, 0.03, (12, 4), pattern)
    form = folded(mesh.nodes, lines(mesh), [Fold(-0.02, 1.2, 0.03), Fold(0.025, -2.0)])
    sides = mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    length = [np.linalg.norm(x[sides[:, 0]] - x[sides[:, 1]], axis=1) for x in (mesh.nodes, form)]
    np.testing.assert_allclose(length[1], length[0], rtol=1e-12)
    assert np.ptp(form[:, 2]) > 0.02


def test_an_arc_is_a_circle_of_its_radius():
    """180 deg over a length of pi R: the second layer is 2 R above the first, to the polygon's error (step / R)^2."""
    radius = 0.01
    for cells in (24, 96):
        mesh = rectangle(0.1, 0.01, (cells, 1))
        form = folded(mesh.nodes, lines(mesh), [Fold(0.0, np.pi, np.pi * radius)])
        error = (0.1 / cells / radius) ** 2
        assert np.ptp(form[:, 2]) == pytest.approx(2 * radius, rel=error)
        far = form[mesh.nodes[:, 0] == mesh.nodes[:, 0].max()]
        assert far[0, 0] == pytest.approx(-0.05, abs=error * radius)  # it comes back to above its other end


def test_a_crease_turns_by_its_angle_at_its_place():
    mesh = rectangle(0.1, 0.02, (10, 2), through_m=((0.0123,), ()))
    form = folded(mesh.nodes, lines(mesh), [Fold(0.0123, 1.7)])
    beyond = mesh.nodes[:, 0] > 0.0123
    np.testing.assert_allclose(form[~beyond], mesh.nodes[~beyond], atol=1e-15)
    reach = mesh.nodes[beyond, 0] - 0.0123
    np.testing.assert_allclose(form[beyond, 0], 0.0123 + np.cos(1.7) * reach, atol=1e-15)
    np.testing.assert_allclose(form[beyond, 2], np.sin(1.7) * reach, atol=1e-15)


def sheet(**shape):
    return {
        "name": "folds",
        "gravity_m_s2": [0.0, 0.0, 0.0],
        "bodies": {
            "sheet": {
                "type": "sheet",
                "shape": {"type": "rectangle", "length_m": 0.06, "width_m": 0.03, "cells": [8, 3], **shape},
                "pose": {"position_m": [0.1, 0.2, 0.3], "rpy_deg": [10.0, 20.0, 30.0]},
                "material": {"preset": "paper_80gsm"},
            }
        },
        "clamps": [{"body": "sheet", "region": {"x_m": [-0.03, -0.0225]}}],
    }


FOLDS = [{"at_m": -0.005, "angle_deg": -97.4}, {"at_m": 0.015, "angle_deg": 120.0, "over_m": 0.02}]


def test_a_folded_sheet_is_at_rest_and_resists_being_flattened():
    scene = build_scene(parse_rig(sheet(pattern="crossed", folds=FOLDS), "test"))
    look = Look(scene.system)
    assert np.abs(look.exerted()).max() < 1e-9
    # Turned by 97.4 deg at a crease alone: the energy does not depend on where the sheet is.
    look.x[:] = scene.bodies["sheet"].place(scene.bodies["sheet"].local)
    assert np.abs(look.exerted()).max() > 1e-3


def test_a_folded_sheet_stays_as_it_is_without_load():
    from sim_core.simulate import Simulation

    scene = build_scene(parse_rig(sheet(pattern="crossed", folds=FOLDS), "test"))
    simulation = Simulation(scene)
    simulation.step({}, 0.01)
    assert np.abs(simulation.state.x - scene.rest).max() < 1e-9


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ({"folds": [{"at_m": 0.029, "angle_deg": 20.0, "over_m": 0.01}]}, "beyond the sheet's end"),
        ({"folds": [{"at_m": 0.0, "angle_deg": 20.0, "over_m": 0.01}, {"at_m": 0.003, "angle_deg": 5.0}]}, "another"),
        ({"folds": [{"at_m": 0.0, "angle_deg": 200.0}]}, "angle_deg"),
        ({"folds": [{"at_m": 0.0, "angle_deg": 20.0}], "pattern": "irregular"}, "lines of nodes"),
    ],
)
def test_folds_that_cannot_be_are_refused(shape, words):
    with pytest.raises(ConfigError, match=words):
        parse_rig(sheet(**shape), "test")


def test_cells_that_would_turn_too_far_are_refused():
    with pytest.raises(ConfigError, match="more cells"):
        build_scene(parse_rig(sheet(folds=[{"at_m": 0.0, "angle_deg": 175.0}]), "test"))
