"""A body that something holds begins a recording where its hands are, not where the rig was drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.gradients.boundary_motion import carried_along, carried_freely
from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.scene.carriage import carried_places, start_state
from sim_core.simulate import Simulation

LENGTH = 0.12


def strip(hands=("left",), **effects):
    """A strip along x in the air, held by one hand at its left end, or by another one too at its right end."""
    ends = {"left": [-0.06, -0.05], "right": [0.05, 0.06]}
    return parse_rig(
        {
            "name": "carried",
            "solver": {"dt_s": 0.01},
            "bodies": {
                "strip": {
                    "type": "sheet",
                    "shape": {"type": "rectangle", "length_m": LENGTH, "width_m": 0.02, "cells": [12, 1]},
                    "pose": {"position_m": [0.0, 0.0, 0.3]},
                    "material": {"E_pa": 2.0e9, "nu": 0.0, "thickness_m": 2.5e-4, "density_kg_m3": 700.0},
                }
            },
            "clamps": [{"name": h, "body": "strip", "region": {"x_m": ends[h]}, "mount": f"{h}_hand"} for h in hands],
            "end_effectors": {
                f"{h}_hand": {
                    "start": {"position_m": [ends[h][0], 0.0, 0.3]},
                    "topics": {"target_pose": f"{h}/target_pose", "current_pose": f"{h}/current_pose"},
                }
                for h in hands
            },
            "sensors": {
                "wrench": {
                    "type": "wrench", "on": f"{hands[0]}_hand", "frame_id": "wrench", "rate_hz": 100.0,
                    "topic": "wrench",
                }
            },
            "effects": effects,
        },
        "test",
    )  # fmt: skip


def moved(frame, turn, shift):
    """A frame, moved as one with everything that is turned about the origin and shifted."""
    return turn.apply(frame[0]) + shift, turn * frame[1]


TURN, SHIFT = Rotation.from_rotvec([0.0, 3.0, 0.1]), np.array([0.02, -0.01, 0.05])


@pytest.mark.parametrize("hands", [("left",), ("left", "right")])
def test_a_sheet_goes_along_with_hands_that_move_as_one(hands):
    scene = build_scene(strip(hands))
    frames = {name: moved(frame, TURN, SHIFT) for name, frame in scene.start.items()}
    x, _ = start_state(scene, frames)
    np.testing.assert_allclose(x, TURN.apply(scene.rest) + SHIFT, atol=1e-12)


def test_a_sheet_that_yields_rests_alike_wherever_the_hand_begins():
    """Upside down it sags by the same amount to the other side of the hand; its own weight does not make it yield."""
    yields = {"bending_plasticity": {"yield_curvature_per_m": 8.0, "hardening_ratio": 0.2}}
    simulation = Simulation(build_scene(strip(**yields)))
    simulation.reset()
    drawn = simulation.state.x
    half = Rotation.from_rotvec([0.0, np.pi, 0.0])
    simulation.reset({"left_hand": (np.array([0.1, 0.0, 0.2]), half)})
    (origin, _), there = simulation.scene.start["left_hand"], simulation.state.x - [0.1, 0.0, 0.2]
    np.testing.assert_allclose(there * [-1.0, 1.0, 1.0], drawn - origin, atol=1e-7)
    assert not simulation.state.internals["strip.bending"]["plastic_curvature"].any()


def test_nodes_between_two_hands_are_shared_by_their_distance():
    scene = build_scene(strip(("left", "right")))
    raised = (scene.start["right_hand"][0] + [0.0, 0.0, 0.01], Rotation.identity())
    x, _ = start_state(scene, {**scene.start, "right_hand": raised})
    along, up = scene.rest[:, 0], x[:, 2] - scene.rest[:, 2]
    assert up[along < -0.049].max() == 0.0 and up[along > 0.049].min() == pytest.approx(0.01)
    middle = np.abs(along) < 1e-9
    assert middle.any() and up[middle] == pytest.approx(0.005)
    assert np.all(np.diff(up[np.argsort(along)].round(9)) >= 0.0)


def test_where_a_sheet_is_put_is_differentiated_by_each_hand():
    scene = build_scene(strip(("left", "right")))
    frames = {name: moved(frame, TURN, SHIFT) for name, frame in scene.start.items()}
    start, _ = start_state(scene, frames)
    motion = np.random.default_rng(3).standard_normal((6, 1))

    def at(h):
        (origin, turn), (rho, phi) = frames["right_hand"], h * motion.reshape(2, 3)
        there = origin + turn.apply(rho), turn * Rotation.from_rotvec(phi)
        return start_state(scene, {**frames, "right_hand": there})[0]

    numeric = (at(1e-5) - at(-1e-5)) / 2e-5
    found = np.zeros_like(start)
    for carrier in carried_freely(scene, start, frames):
        if carrier.mount == "right_hand":
            share = carrier.weights[:, None, None]
            found[carrier.nodes] += (share * carried_along(carrier.local, frames[carrier.mount], motion))[..., 0]
    free = ~scene.held("strip")
    np.testing.assert_allclose(found[free], numeric[free], atol=1e-9)
    assert np.abs(found).max() > 1e-2


def test_nodes_in_the_place_of_held_ones_go_along_with_their_hand():
    """A slit that begins at a clamp has two nodes in one place, of which the clamp may hold one."""
    scene = build_scene(strip(("left", "right")))
    held = scene.held("strip")
    double, twin = scene.bodies["strip"].nodes[~held][0], scene.bodies["strip"].nodes[held][0]
    scene.rest[double] = scene.rest[twin]
    frames = {mount: moved(frame, TURN, SHIFT) for mount, frame in scene.start.items()}
    frames["right_hand"] = scene.start["right_hand"]
    nodes, places = carried_places(scene, "strip", frames)
    assert np.isfinite(places).all()
    expected = TURN.apply(scene.rest[twin]) + SHIFT
    np.testing.assert_allclose(places[list(nodes).index(double)], expected, atol=1e-9)
