"""Clamps of single components and single vertices, and which scenes settle before they start."""

import numpy as np
import pytest
from body_scenes import G, affine, gel, rig_of

from sim_core.errors import ConfigError
from sim_core.scene import build_scene
from sim_core.simulate import Simulation

L, W, H = 0.1, 0.02, 1e-3
SHEET = {"E_pa": 2e9, "nu": 0.0, "thickness_m": H, "density_kg_m3": 1000.0}


def strip(clamps, cells=(20, 4), **more):
    shape = {"type": "rectangle", "length_m": L, "width_m": W, "cells": list(cells), "pattern": "crossed"}
    return rig_of({"s": {"type": "sheet", "shape": shape, "material": SHEET}}, clamps=clamps, **more)


def end(side, *axes, **more):
    return {"body": "s", "region": {"x_m": [side * 0.5 * L] * 2}, "axes": list(axes), **more}


def test_a_beam_on_two_supports():
    """A pin and a roller: 5 q L^4 / (384 E I) in the middle, half the weight on each."""
    clamps = [end(-1, "x", "y", "z", name="pin"), end(1, "z", name="roller")]
    sensors = {f"on_{n}": {"type": "wrench", "on": n, "rate_hz": 100.0, "topic": n} for n in ("pin", "roller")}
    sim = Simulation(build_scene(strip(clamps, sensors=sensors)))
    body = sim.scene.bodies["s"]
    middle = np.abs(body.local[:, 0]) < 1e-9
    weight = SHEET["density_kg_m3"] * H * G
    stiffness = SHEET["E_pa"] * H**3 / 12.0
    expected = 5.0 * weight * L**4 / (384.0 * stiffness)
    assert -sim.state.x[body.nodes[middle], 2].mean() == pytest.approx(expected, rel=0.01)
    load = sim.read()
    for name in ("pin", "roller"):
        assert -load[f"on_{name}"][2] == pytest.approx(0.5 * weight * W * L, rel=1e-4)
    assert np.abs(load["on_roller"][:2]).max() < 1e-9


def test_one_component_of_one_vertex():
    """Only z of one corner of a gel is held: it stays, slides and turns about it."""
    region = {"x_m": [-0.005, -0.005], "y_m": [-0.005, -0.005], "z_m": [-0.005, -0.005]}
    rig = rig_of(
        {"g": gel((0.01, 0.01, 0.01), (1, 1, 1), (0.0, 0.0, 0.0))}, gravity=(G, 0.0, -G),
        clamps=[{"body": "g", "region": region, "axes": ["z"]}],
    )  # fmt: skip
    scene = build_scene(rig)
    assert scene.system.prescribed.sum() == 1 and not scene.all_held
    sim = Simulation(scene)
    corner = int(np.flatnonzero(scene.system.prescribed[:, 2])[0])
    for _ in range(5):
        sim.step({}, 0.005)
    assert sim.state.x[corner, 2] == pytest.approx(-0.005, abs=1e-15)
    fallen = sim.state.x.mean(axis=0)
    assert fallen[0] == pytest.approx(G * 0.005**2 * 15, rel=0.3)
    assert sim.state.x[:, 2].mean() < -1e-4


def test_what_settles_before_it_starts():
    """Bodies that cannot move as a whole; a pin alone may swing to rest; what rolls or is free starts in motion."""
    pinned = [end(-1, "x", "y", "z")]
    assert build_scene(strip(pinned)).all_held
    assert build_scene(strip([end(-1, "x", "z"), end(1, "y", "z")])).all_held
    assert not build_scene(strip([end(-1, "x", "z"), end(1, "z")])).all_held
    bodies = {"b": affine((0.01, 0.01, 0.01))}
    scene = build_scene(rig_of(bodies, joints=[{"type": "ball", "body": "b"}]))
    assert not scene.all_held
    assert Simulation(scene).state.t == 0.0


def test_a_line_of_nodes_is_a_hinge_only_where_the_rig_says_so():
    with pytest.raises(ConfigError, match=r"axes: \[x, y, z\]"):
        build_scene(strip([{"body": "s", "region": {"x_m": [-0.5 * L] * 2}}]))
    with pytest.raises(ConfigError, match="twice"):
        strip([end(-1, "x", "x")])
    with pytest.raises(ConfigError, match="axes"):
        strip([end(-1, "w")])


def test_a_compliant_mount_moves_the_held_components_alone():
    clamps = [{"body": "s", "region": {"x_m": [-0.5 * L, -0.4 * L]}}, end(1, "z", mount="hand")]
    compliance = 1e-3
    rig = strip(
        clamps, end_effectors={"hand": {}}, effects={"end_effector_compliance": {"compliance_m_per_n": compliance}}
    )
    sim = Simulation(build_scene(rig))
    system = sim.scene.system
    nodes = np.flatnonzero(system.prescribed[:, 2] & ~system.prescribed[:, 0])
    sag = sim.state.x[nodes, 2]
    deflection = sim.actual_frames()["hand"][0] - sim.frames["hand"][0]
    np.testing.assert_allclose(sag, deflection[2], atol=1e-15)
    assert deflection[2] == pytest.approx(compliance * sim.reactions()[nodes, 2].sum(), rel=1e-6)
    assert np.ptp(sim.state.x[nodes, 0]) < 1e-6 and deflection[0] == 0.0
