"""A limp fabric falls on a ball and drapes over it, with the default constants of contact."""

from __future__ import annotations

import numpy as np

from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.scene.contact_constants import WIDEST_M
from sim_core.simulate import Simulation

RADIUS, THICKNESS, DT = 0.02, 3e-4, 5e-3


def test_a_fabric_drapes_over_a_ball_without_a_failed_step() -> None:
    """E h = 300 N/m: 0.2 kg/m^2 of it hang down around the ball after 0.15 s of fall and drape, outside of it."""
    sheet = {
        "type": "sheet",
        "shape": {"type": "rectangle", "length_m": 0.1, "width_m": 0.1, "cells": [8, 8], "pattern": "regular"},
        "pose": {"position_m": [3e-4, 2e-4, 0.043]},
        "material": {"E_pa": 1e6, "nu": 0.3, "thickness_m": THICKNESS, "density_kg_m3": 0.2 / THICKNESS},
    }
    ball = {"type": "rigid", "shape": {"type": "sphere", "radius_m": RADIUS}, "pose": {"position_m": [0, 0, RADIUS]}}
    pairs = (["sheet", "ball"], ["sheet", "table"], ["sheet", "sheet"])
    data = {
        "name": "drape",
        "solver": {"dt_s": DT},
        "bodies": {"table": {"type": "rigid", "shape": {"type": "plane"}}, "ball": ball, "sheet": sheet},
        "contacts": [{"between": pair, "friction": 0.3} for pair in pairs],
    }
    simulation = Simulation(build_scene(parse_rig(data, "drape")))
    for _ in range(30):
        report = simulation.step({}, DT)
        assert report.converged
        assert report.min_gap_m > 0.0
    assert simulation.halvings == 0
    x = simulation.state.x[simulation.scene.bodies["sheet"].nodes]
    away = np.linalg.norm(x - [0.0, 0.0, RADIUS], axis=1)
    assert away.min() > RADIUS + 0.5 * THICKNESS - WIDEST_M
    assert x[:, 2].min() < RADIUS < x[:, 2].max()
