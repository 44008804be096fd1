"""A soft block on a rigid plane and a sheet on a gel, tilted: Coulomb's law in the whole machinery."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation

MU, G = 0.4, 9.81
DT = 0.005


def block_on_plane(turn):
    """A free 10 mm cube of gel just above a plane, the whole scene turned."""
    rpy = [float(a) for a in turn.as_euler("xyz", degrees=True)]
    rest = [float(c) for c in turn.apply([0.0, 0.0, 0.005 + 9.1e-6])]
    return build_scene(
        parse_rig(
            {
                "name": "slope",
                "solver": {"dt_s": DT},
                "bodies": {
                    "plane": {"type": "rigid", "shape": {"type": "plane"}, "pose": {"rpy_deg": rpy}},
                    "block": {
                        "type": "gel",
                        "shape": {"type": "block", "size_m": [0.01, 0.01, 0.01], "cells": [1, 1, 1]},
                        "pose": {"position_m": rest, "rpy_deg": rpy},
                        "material": {"E_pa": 2e5, "nu": 0.4, "density_kg_m3": 1000.0},
                    },
                },
                "contacts": [{"between": ["block", "plane"], "friction": MU}],
            },
            "test",
        )
    )


def slide(scene, turn, ratio, heading, steps=60):
    """Lie still first, then tilt gravity so that tan(slope) = ratio * mu; displacements along the slope."""
    slope = np.arctan(ratio * MU)
    down = np.array([np.cos(heading), np.sin(heading), 0.0])
    nodes = scene.bodies["block"].nodes
    scene.system.gravity = turn.apply([0.0, 0.0, -G])
    simulation = Simulation(scene, settle=False)
    for _ in range(30):
        simulation.step({}, DT)
    start = simulation.state.x[nodes].mean(axis=0)
    scene.system.gravity = turn.apply(G * (np.sin(slope) * down - np.cos(slope) * np.array([0.0, 0.0, 1.0])))
    simulation.refresh()
    path = []
    for _ in range(steps):
        simulation.step({}, DT)
        path.append((simulation.state.x[nodes].mean(axis=0) - start) @ turn.apply(down))
    return np.array(path), slope


TURNS = [Rotation.identity(), *Rotation.random(2, random_state=11)]


@pytest.mark.parametrize("turn", TURNS, ids=["upright", "turned", "turned again"])
def test_a_block_slips_if_and_only_if_the_slope_exceeds_the_friction(turn):
    """Below the threshold it stays where it is, without creep; above it accelerates as in a textbook; whatever
    the orientation of the scene and the direction of the slope."""
    scene = block_on_plane(turn)
    for heading in (0.3, 2.5):
        still, _ = slide(scene, turn, 0.98, heading)
        assert abs(still[-1]) < 2e-5
        assert np.abs(np.diff(still[-10:])).max() < 1e-9
        moving, slope = slide(scene, turn, 1.1, heading)
        acceleration = np.diff(moving[20:], 2) / DT**2
        expected = G * (np.sin(slope) - MU * np.cos(slope))
        np.testing.assert_allclose(acceleration, expected, rtol=0.02)


def test_the_threshold_lies_within_one_percent():
    scene = block_on_plane(TURNS[1])
    drift = {ratio: slide(scene, TURNS[1], ratio, 1.0)[0] for ratio in (0.99, 1.01)}
    assert abs(drift[0.99][-1] - drift[0.99][-20]) < 1e-8
    assert drift[1.01][-1] - drift[1.01][-20] > 1e-5


def sheet_on_gel(friction):
    return build_scene(
        parse_rig(
            {
                "name": "tray",
                "solver": {"dt_s": DT},
                "bodies": {
                    "gel": {
                        "type": "gel",
                        "shape": {"type": "block", "size_m": [0.03, 0.03, 0.006], "cells": [3, 3, 1]},
                        "pose": {"position_m": [0.0, 0.0, -0.003]},
                        "material": {"E_pa": 2e5, "nu": 0.4, "density_kg_m3": 1000.0},
                        "bonded": "bottom",
                        "mount": "world",
                    },
                    "card": {
                        "type": "sheet",
                        "shape": {"type": "rectangle", "length_m": 0.016, "width_m": 0.012, "cells": [4, 3]},
                        "pose": {"position_m": [0.0, 0.0, 1.345e-4]},
                        "material": {"preset": "card_200gsm"},
                    },
                },
                "contacts": [{"between": ["card", "gel"], "friction": friction}],
            },
            "test",
        )
    )


def test_a_card_on_a_gel_slips_if_and_only_if_the_slope_exceeds_the_friction():
    """Both orders of the pair of surfaces share the load; together they hold mu times it."""
    scene = sheet_on_gel(MU)
    card = scene.bodies["card"].nodes

    def velocity(ratio):
        slope = np.arctan(ratio * MU)
        scene.system.gravity = np.array([0.0, 0.0, -G])
        simulation = Simulation(scene, settle=False)
        for _ in range(30):
            simulation.step({}, DT)
        scene.system.gravity = G * np.array([np.sin(slope), 0.0, -np.cos(slope)])
        simulation.refresh()
        for _ in range(12):
            simulation.step({}, DT)
        return simulation.state.v[card, 0].mean()

    assert abs(velocity(0.9)) < 1e-7
    slope = np.arctan(1.3 * MU)
    expected = G * (np.sin(slope) - MU * np.cos(slope)) * 12 * DT
    assert velocity(1.3) == pytest.approx(expected, rel=0.05)


def card_on_card(turn):
    """A free card on the held part of another one, the whole scene turned."""
    rpy = [float(a) for a in turn.as_euler("xyz", degrees=True)]
    thickness = 2e-4
    material = {"E_pa": 1e9, "nu": 0.3, "thickness_m": thickness, "density_kg_m3": 800.0}

    def card(length, width, cells, height, aside=0.0):
        place = turn.apply([aside, 0.3 * aside, height])
        shape = {"type": "rectangle", "length_m": length, "width_m": width, "cells": cells, "pattern": "crossed"}
        pose = {"position_m": [float(p) for p in place], "rpy_deg": rpy}
        return {"type": "sheet", "shape": shape, "pose": pose, "material": material}

    return build_scene(
        parse_rig(
            {
                "name": "cards",
                "solver": {"dt_s": DT},
                "bodies": {"held": card(0.04, 0.03, [5, 4], 0.0), "block": card(0.016, 0.012, [4, 3], 2.28e-4, 7e-4)},
                "clamps": [{"body": "held", "region": {"x_m": [-0.02, 0.0125]}}],
                "contacts": [{"between": ["held", "block"], "friction": MU}],
            },
            "test",
        )
    )


@pytest.mark.parametrize("turn", TURNS, ids=["upright", "turned", "turned again"])
def test_a_card_on_a_card_slips_within_one_percent_of_the_friction(turn):
    """Points on faces both ways and edges on edges share the load; together they hold mu times it."""
    scene = card_on_card(turn)
    for heading in (0.3, 2.5):
        still, _ = slide(scene, turn, 0.99, heading, steps=30)
        assert np.abs(np.diff(still[-5:])).max() < 1e-8
        moving, slope = slide(scene, turn, 1.01, heading, steps=30)
        assert moving[-1] - moving[-10] > 1e-5
        moving, slope = slide(scene, turn, 1.2, heading, steps=30)
        acceleration = np.diff(moving[10:], 2).mean() / DT**2
        expected = G * (np.sin(slope) - MU * np.cos(slope))
        assert acceleration == pytest.approx(expected, rel=0.02)
