"""A soft finger rubs on a sheet that is glued flat: to it that is a rigid plane, whatever cells the sheet has."""

import numpy as np
import pytest

from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation

MU = 0.55
PRESS, STROKE, STEPS = 5e-4, 8e-3, 16
THICKNESS = 2e-4
AS_IT_IS = [0.0, 0.0, 0.0, 1.0]


def rubbed(ground):
    """Forces [N] on the gel ``(STEPS, 3)`` while it is rubbed on a body of which nothing can move."""
    rig = parse_rig(
        {
            "name": "rubbing",
            "gravity_m_s2": [0.0, 0.0, 0.0],
            "solver": {"dt_s": 0.05, "inertia": False},
            "bodies": {
                "gel": {
                    "type": "gel",
                    "shape": {"type": "block", "size_m": [0.012, 0.012, 0.006], "cells": [3, 3, 2]},
                    "pose": {"position_m": [0.0, 0.0, -0.003], "rpy_deg": [180.0, 0.0, 0.0]},
                    "material": {"E_pa": 1.4e5, "nu": 0.44, "density_kg_m3": 1000.0},
                    "bonded": "bottom",
                    "mount": "finger",
                },
                "ground": ground,
            },
            **({"clamps": [{"body": "ground", "region": {"x_m": [-1.0, 1.0]}, "mount": "world"}]}
               if ground["type"] == "sheet" else {}),
            "end_effectors": {"finger": {"start": {"position_m": [-0.5 * STROKE, 0.0, 0.0065]}}},
            "contacts": [{"between": ["gel", "ground"], "friction": MU}],
            "sensors": {"wrench": {"type": "wrench", "on": "gel", "rate_hz": 20.0, "frame_id": "gel"}},
        },
        "test",
    )  # fmt: skip
    simulation = Simulation(build_scene(rig))

    def move(x, z):
        simulation.step({"finger": frame_of(np.array([x, 0.0, z]), np.array(AS_IT_IS))}, 0.05)
        return simulation.read()["wrench"][:3]

    for z in np.linspace(6.5e-3, 6e-3 - PRESS, 6)[1:]:
        move(-0.5 * STROKE, z)
    return np.array([move(x, 6e-3 - PRESS) for x in np.linspace(-0.5, 0.5, STEPS + 1)[1:] * STROKE])


def sheet(cells):
    return {
        "type": "sheet",
        "shape": {"type": "rectangle", "length_m": 0.04, "width_m": 0.02, "cells": cells, "pattern": "crossed"},
        "pose": {"position_m": [0.0, 0.0, -0.5 * THICKNESS]},
        "material": {"E_pa": 3e9, "nu": 0.3, "thickness_m": THICKNESS, "density_kg_m3": 800.0},
    }


@pytest.fixture(scope="module")
def on_a_rigid_plane():
    pose = {"position_m": [0.0, 0.0, -0.01]}
    return rubbed({"type": "rigid", "shape": {"type": "box", "size_m": [0.04, 0.02, 0.02]}, "pose": pose})


@pytest.mark.parametrize("cells", [[4, 2], [7, 3], [15, 8], [30, 15], [40, 20]])
def test_it_feels_a_rigid_plane(cells, on_a_rigid_plane):
    found = rubbed(sheet(cells))
    np.testing.assert_allclose(found, on_a_rigid_plane, atol=2e-3 * np.abs(on_a_rigid_plane).max())
    sliding = found[STEPS // 2 :]
    np.testing.assert_allclose(np.hypot(sliding[:, 0], sliding[:, 1]), MU * np.abs(sliding[:, 2]), rtol=5e-3)
