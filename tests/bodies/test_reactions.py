"""What a clamp bears: the whole weight of what hangs from it on any mesh, and its inertia."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation

LENGTH, GRIP, WIDTH, G = 0.1, 0.01, 0.02, 9.81
MATERIAL = {"E_pa": 2e9, "nu": 0.3, "thickness_m": 2e-4, "density_kg_m3": 1300.0}
WEIGHT = MATERIAL["density_kg_m3"] * MATERIAL["thickness_m"] * WIDTH * (LENGTH - GRIP) * G
"""Of what is outside the clamp [N]."""


def hanging(cells: list[int], pattern: str, **solver: Any) -> Simulation:
    """A strip that hangs straight down from a clamp around its upper end."""
    shape = {"type": "rectangle", "length_m": LENGTH, "width_m": WIDTH, "cells": cells, "pattern": pattern}
    grip = {"x_m": [-0.5 * LENGTH, GRIP - 0.5 * LENGTH]}
    data = {
        "name": "hanging",
        "gravity_m_s2": [0.0, 0.0, -G],
        "solver": {"dt_s": 0.01, **solver},
        "bodies": {
            "strip": {
                "type": "sheet",
                "shape": shape,
                "material": MATERIAL,
                "pose": {"position_m": [0.0, 0.0, 0.5], "rpy_deg": [0.0, 90.0, 0.0]},
            }
        },
        "clamps": [{"name": "jaws", "body": "strip", "region": grip, "mount": "hand"}],
        "end_effectors": {"hand": {"start": {"position_m": [0.0, 0.0, 0.5]}}},
        "sensors": {"wrench": {"type": "wrench", "on": "jaws", "topic": "wrench"}},
    }
    return Simulation(build_scene(parse_rig(data, "hanging")))


@pytest.mark.parametrize(("cells", "pattern"), [([3, 1], "regular"), ([8, 2], "crossed"), ([10, 3], "irregular")])
def test_a_strip_at_rest_shows_its_whole_weight_on_any_mesh(cells: list[int], pattern: str) -> None:
    simulation = hanging(cells, pattern, inertia=False)
    simulation.step({}, 0.01)
    np.testing.assert_allclose(simulation.read()["wrench"][:3], [0.0, 0.0, -WEIGHT], rtol=1e-6, atol=1e-6 * WEIGHT)


@pytest.mark.parametrize("integrator", ["implicit_euler", "bdf2"])
def test_a_strip_that_is_lifted_faster_and_faster_shows_mass_times_acceleration(integrator: str) -> None:
    """F = -m (g + a): along its length the strip is stiff, and follows at once."""
    simulation, rate, dt = hanging([6, 1], "regular", integrator=integrator), 3.0, 0.01
    for k in range(1, 26):
        place = np.array([0.0, 0.0, 0.5 + 0.5 * rate * (k * dt) ** 2])
        simulation.step({"hand": (place, Rotation.identity())}, dt)
    force = simulation.read()["wrench"][2]
    assert force == pytest.approx(-WEIGHT * (1.0 + rate / G), rel=1e-3)


def test_what_a_clamp_bears_is_the_change_of_momentum_while_it_is_shaken() -> None:
    """In every step, to the tolerance of the solver: F = sum m g - d(sum m v)/dt."""
    simulation, dt = hanging([6, 2], "crossed"), 0.01
    mass = simulation.scene.system.mass
    before = mass @ simulation.state.v
    for k in range(1, 9):
        place = np.array([2e-3 * np.sin(40.0 * k * dt), 0.0, 0.5])
        simulation.step({"hand": (place, Rotation.identity())}, dt)
        now = mass @ simulation.state.v
        change, before = (now - before).sum(axis=0) / dt, now
        expected = np.array([0.0, 0.0, -WEIGHT]) - change
        np.testing.assert_allclose(simulation.read()["wrench"][:3], expected, atol=1e-5 * WEIGHT)
