"""Stiff bodies, sheets and gels at 2 mm a step: nothing crosses; an oracle of its own looks on."""

import sys
from pathlib import Path

import numpy as np
import pytest
from body_scenes import affine, centre, gel, plane, simulation, stretch
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.scene.assembly import contact_triangles

sys.path.append(str(Path(__file__).parents[1] / "contact"))
from crossing import crossings_of

DT, STEP = 0.01, 0.002
DOWN = [0.0, 0.0, -STEP / DT]


def watch(sim, steps, frames=lambda k: {}):
    """Every step must leave gaps and cross nothing; the largest number of loaded points."""
    triangles = [contact_triangles(b) for b in sim.scene.bodies.values() if b.mesh is not None]
    most = 0
    for k in range(steps):
        report = sim.step(frames(k), DT)
        assert report.min_gap_m > 0.0
        assert crossings_of(sim.state.x, *triangles) == 0
        most = max(most, report.contacts)
    assert stretch(sim) < 1e-4
    return most


def between(names, friction=0.4):
    return [{"between": [a, b], "friction": friction} for i, a in enumerate(names) for b in names[i + 1 :]]


def test_boxes_that_fall_on_each_other_and_on_a_plane():
    bodies = {"plane": plane()}
    bodies["low"] = affine((0.01, 0.012, 0.014), (0.0, 0.0, 0.013), (0.0, 30.0, 0.0), velocity_m_s=DOWN)
    bodies["high"] = affine((0.01, 0.012, 0.014), (0.003, 0.002, 0.032), (20.0, 30.0, 10.0), velocity_m_s=DOWN)
    sim = simulation(bodies, DT, contacts=between(list(bodies)))
    assert watch(sim, 24) > 2
    for name in ("low", "high"):
        nodes = sim.scene.bodies[name].nodes[:-4]
        assert sim.state.x[nodes, 2].min() > 0.0


def test_a_ball_and_a_box_are_caught_by_a_film():
    film = {
        "type": "sheet",
        "shape": {"type": "rectangle", "length_m": 0.06, "width_m": 0.03, "cells": [8, 4], "pattern": "crossed"},
        "material": {"E_pa": 1e8, "nu": 0.3, "thickness_m": 2e-4, "density_kg_m3": 800.0},
    }
    bodies = {
        "film": film,
        "ball": affine(0.005, (0.0, 0.0, 0.009), velocity_m_s=DOWN, edge_m=0.003),
        "box": affine((0.01, 0.008, 0.006), (0.014, 0.003, 0.013), (30.0, 40.0, 0.0), velocity_m_s=DOWN),
    }
    clamps = [
        {"body": "film", "region": {"x_m": [s * 0.03 - 0.0075 * (s > 0), s * 0.03 + 0.0075 * (s < 0)]}} for s in (-1, 1)
    ]
    sim = simulation(bodies, DT, clamps=clamps, contacts=between(list(bodies)))
    assert watch(sim, 20) > 5
    assert centre(sim, "ball")[2] > 0.003 and centre(sim, "box")[2] > 0.002


def test_a_pusher_drives_a_block_into_a_gel_and_a_wall_of_card():
    """2 mm a step: rigid pusher, free block, thin free card, gel that is held."""
    bodies = {
        "plane": plane(),
        "block": affine((0.02, 0.02, 0.02), (0.0, 0.0, 0.01 + 3e-5)),
        "card": affine((0.001, 0.03, 0.03), (0.015, 0.0, 0.015 + 3e-5)),
        "pad": gel((0.006, 0.02, 0.02), (1, 2, 2), (0.0235, 0.0, 0.012), 5e4, bonded="x_max", mount="world"),
        "push": {
            "type": "rigid",
            "shape": {"type": "box", "size_m": [0.01, 0.01, 0.01]},
            "pose": {"position_m": [-0.02, 0.001, 0.008]},
            "mount": "arm",
        },
    }
    pairs = [("block", "plane"), ("card", "plane"), ("block", "card"), ("card", "pad"), ("block", "push")]
    contacts = [{"between": list(p), "friction": 0.3} for p in (*pairs, ("block", "pad"))]
    sim = simulation(bodies, DT, contacts=contacts, end_effectors={"arm": {}})
    turn = Rotation.identity()
    most = watch(sim, 10, lambda k: {"arm": (np.array([min(STEP * k, 0.0105), 0.0, 0.0]), turn)})
    assert most > 8
    assert centre(sim, "block")[0] > 0.004


def test_bodies_that_start_inside_each_other_are_refused():
    bodies = {"a": affine((0.02, 0.02, 0.02)), "b": affine((0.02, 0.02, 0.02), (0.011, 0.004, 0.003), (0.0, 0.0, 30.0))}
    with pytest.raises(ConfigError, match="go through each other"):
        simulation(bodies, contacts=between(["a", "b"]))


def test_contact_of_a_body_with_itself_is_refused():
    with pytest.raises(ConfigError, match="keeps its shape"):
        simulation({"a": affine((0.02, 0.02, 0.02))}, contacts=[{"between": ["a", "a"]}])
