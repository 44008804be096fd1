"""Force and torque of contacts: balance with what mounts bear, and with each other."""

import numpy as np
import pytest
from scipy.interpolate import interp1d
from scipy.spatial.transform import Rotation

from sim_core.contact_wrenches import contact_topic, contact_wrenches
from sim_core.rigs import parse_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, simulate

PAD = {
    "type": "gel",
    "shape": {"type": "block", "size_m": [0.02, 0.02, 0.008], "cells": [2, 2, 1]},
    "material": {"E_pa": 1e5, "nu": 0.4, "density_kg_m3": 1000.0},
    "bonded": "bottom",
}


def pressed(order, other):
    """A pad on the table that a ball or another pad in the hand presses and drags."""
    reach = 0.008 if other["type"] == "rigid" else 0.004
    bodies = {"pad": {**PAD, "mount": "world"}, "tool": {**other, "mount": "hand"}}
    return parse_rig(
        {
            "name": "pressed",
            "gravity_m_s2": [0.0, 0.0, 0.0],
            "solver": {"dt_s": 0.1, "inertia": False},
            "bodies": bodies,
            "contacts": [{"between": order, "friction": 0.5}],
            "end_effectors": {"hand": {"start": {"position_m": [0.003, 0.001, 0.0041 + reach]}}},
            "sensors": {
                "under": {"type": "wrench", "on": "pad", "pose": {"position_m": [0.0, 0.0, 0.0]}, "topic": "under"}
            },
        },
        "pressed",
    )


BALL = {"type": "rigid", "shape": {"type": "sphere", "radius_m": 0.008}}
OTHER = {**PAD, "pose": {"rpy_deg": [180.0, 0.0, 0.0]}, "shape": {**PAD["shape"], "size_m": [0.012, 0.012, 0.008]}}
WAY = [[0.0, 0.0, -3e-4], [0.0, 0.0, -8e-4], [4e-4, 2e-4, -8e-4]]


TIMES = np.arange(16) * 0.02  # short steps: a long one may end on another branch
PATH = interp1d(np.arange(4) * 0.1, [[0.0, 0.0, 0.0], *WAY], axis=0)(TIMES)


def dragged(rig):
    simulation = Simulation(build_scene(rig))
    start = simulation.frames["hand"][0]
    for shift in PATH[1:]:
        simulation.step({"hand": (start + shift, Rotation.identity())}, 0.02)
    return simulation


@pytest.mark.parametrize("other", [BALL, OTHER], ids=["ball", "pad"])
def test_what_a_contact_exerts_is_what_the_mount_bears(other):
    """Without weight and inertia, all that acts on the pad passes to its mount: force and torque about the origin."""
    simulation = dragged(pressed(["pad", "tool"], other))
    wrench = simulation.contact_wrenches()["pad-tool"]
    assert wrench[2] < -0.01
    assert np.hypot(*wrench[:2]) > 1e-3
    np.testing.assert_allclose(wrench, simulation.read()["under"], atol=1e-6 * np.abs(wrench).max())


@pytest.mark.parametrize("other", [BALL, OTHER], ids=["ball", "pad"])
def test_the_other_body_bears_the_opposite(other):
    one = dragged(pressed(["pad", "tool"], other)).contact_wrenches()["pad-tool"]
    two = dragged(pressed(["tool", "pad"], other)).contact_wrenches()["tool-pad"]
    np.testing.assert_allclose(two, -one, rtol=1e-6, atol=1e-6 * np.abs(one).max())


def test_wrenches_of_a_whole_trace_are_those_of_its_steps():
    rig = pressed(["pad", "tool"], BALL)
    path = np.array([0.003, 0.001, 0.0121]) + PATH
    poses = {"hand": PoseTrajectory(TIMES, path, np.tile([0.0, 0.0, 0.0, 1.0], (len(TIMES), 1)))}
    scene = build_scene(rig)
    states = simulate(scene, poses, TIMES, keep_states=True).states
    found = contact_wrenches(scene, states.positions, states.pair_forces)["pad-tool"]
    assert found.shape == (16, 6)
    assert not found[0].any()
    np.testing.assert_allclose(found[-1], dragged(rig).contact_wrenches()["pad-tool"], rtol=1e-9)


def test_topics_have_no_hyphens():
    assert contact_topic("gel-card") == "contacts/gel/card"
