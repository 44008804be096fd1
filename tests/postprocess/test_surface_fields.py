"""Curvature, strain and pressure on surfaces against what is known of spheres, cylinders and homogeneous strains."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.geometry import closed, sheets
from sim_core.postprocess import QUANTITIES, lay_out, quantity, surfaces
from sim_core.postprocess.curvature import largest_curvature
from sim_core.postprocess.fields import strain
from sim_core.rigs import Rig, load_rig
from sim_core.state_history import StateHistory


def test_curvature_of_a_sphere_is_one_over_its_radius() -> None:
    mesh = closed.sphere(0.02, 0.002)
    found = largest_curvature(mesh.nodes, mesh.triangles)
    assert np.median(found) == pytest.approx(50.0, rel=0.03)
    assert np.quantile(np.abs(found / 50.0 - 1.0), 0.95) < 0.08


def test_curvature_of_a_rolled_sheet_is_that_of_the_cylinder_and_of_a_flat_one_zero() -> None:
    mesh = sheets.rectangle(0.06, 0.02, (60, 20), "crossed")
    radius = 0.03
    angle = mesh.nodes[:, 0] / radius
    rolled = np.column_stack([radius * np.sin(angle), mesh.nodes[:, 1], radius * (1.0 - np.cos(angle))])
    inside = (np.abs(mesh.nodes[:, 0]) < 0.027) & (np.abs(mesh.nodes[:, 1]) < 0.008)
    assert largest_curvature(rolled, mesh.triangles)[inside] == pytest.approx(1.0 / radius, rel=0.03)
    assert largest_curvature(mesh.nodes, mesh.triangles) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("rig", "body"), [("gel_sensor", "gel"), ("card_press", "card")])
def test_strain_of_a_homogeneous_stretch_in_any_orientation(rig: str, body: str) -> None:
    layout = lay_out(load_rig(rig))
    skin = next(s for s in surfaces(layout) if s.body == body)
    turn = np.linalg.qr(np.array([[1.0, 0.3, -0.2], [0.1, 1.0, 0.5], [0.4, -0.2, 1.0]]))[0]
    x = layout.rest.copy()
    nodes = layout.bodies[body].nodes
    x[nodes] = (layout.bodies[body].local * [1.1, 1.0, 1.0]) @ turn.T
    assert strain(layout, skin, x) == pytest.approx(0.5 * (1.1**2 - 1.0), rel=1e-9)


def at_rest(rig: Rig) -> tuple[StateHistory, object]:
    layout = lay_out(rig)
    count = len(layout.rest)
    zero = np.zeros((1, count))
    return StateHistory(layout.rest[None], {}, {}, {}, zero, zero), layout


@pytest.mark.parametrize("name", ["displacement", "strain", "pressure", "slip"])
def test_a_rig_at_rest_shows_zero_of_everything(name: str) -> None:
    layout = lay_out(load_rig("card_press"))
    states, _ = at_rest(layout.rig)
    for skin in surfaces(layout):
        values = quantity(name, layout, skin, states, 0, layout.start)
        if skin.kind in QUANTITIES[name].bodies:
            assert values == pytest.approx(0.0, abs=1e-9)
        else:
            assert np.isnan(values).all()


@pytest.mark.parametrize("rig", ["gel_sensor", "lifting", "tactip_cr"])
def test_surfaces_of_solids_are_closed_and_point_outward(rig: str) -> None:
    layout = lay_out(load_rig(rig))
    for skin in surfaces(layout):
        if skin.kind in ("sheet", "plane"):
            continue
        corner = skin.vertices(layout, layout.rest, layout.start)[skin.triangles]
        volume = np.einsum("ti,ti->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
        assert volume > 0.0
        area = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert area.sum(axis=0) == pytest.approx(0.0, abs=1e-9 * np.abs(area).sum())
