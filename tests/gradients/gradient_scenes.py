"""Scenes for the tests of gradients: damped motion with memory, contact of all kinds, a card that has settled."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import load_rig, parse_rig, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory

EFFECTS = {
    "gel_relaxation": {"share": 0.3, "tau_s": 0.1},
    "bending_plasticity": {"yield_curvature_per_m": 0.5, "hardening_ratio": 0.3},
    "air_drag": {"drag_coefficient": 1.2},
    "static_friction": {"excess": 0.5},
}
PRESS = ([0.0, 0.1, 0.3, 0.6], [[0, 0, 0], [0, 0, 0], [0, 0, -0.008], [0.004, 0.002, -0.008]])


def damped(integrator, small_rig, visit):
    """Both kinds of damping together with plastic flow and relaxation, in motion."""
    rig = small_rig(effects=EFFECTS, solver={"dt_s": 0.02, "integrator": integrator})
    for body, alpha, beta in (("card", 3.0, 5e-3), ("gel", 2.0, 0.02)):
        given = {f"{body}.mass_damping_per_s": alpha, f"{body}.stiffness_damping_s": beta}
        rig = with_parameters(rig, given)
    return rig, visit(*PRESS), np.linspace(0.0, 0.26, 14)


def forming():
    """A round gel presses a card on a table and draws it: points and faces both ways, edges, a plane."""
    rig = load_rig("forming").model_copy(update={"effects": {"static_friction": {"excess": 0.5}}})
    start = rig.end_effectors["finger"].start.position()
    path = start + np.array([[0, 0, 0], [0, 0, -6.5e-3], [1e-2, 0, -6.5e-3]])
    poses = {"finger": PoseTrajectory(np.array([0.0, 0.15, 0.30]), path, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)))}
    return rig, poses, np.linspace(0.0, 0.165, 34)


def ball():
    """A ball on an arm rolls over a card: its normal turns with the place, and its frame with the arm."""
    sheet = {"type": "rectangle", "length_m": 0.06, "width_m": 0.06, "cells": [8, 8], "pattern": "crossed"}
    rig = parse_rig(
        {
            "name": "ball",
            "solver": {"dt_s": 0.005},
            "bodies": {
                "card": {
                    "type": "sheet", "shape": sheet, "pose": {"position_m": [0.0, 0.0, -0.002]},
                    "material": {"preset": "card_200gsm"},
                },
                "ball": {"type": "rigid", "shape": {"type": "sphere", "radius_m": 0.02}, "mount": "arm"},
            },
            "clamps": [{"body": "card", "region": {"x_m": [-0.03, -0.02]}}],
            "end_effectors": {"arm": {"start": {"position_m": [0.01, 0.0, 0.0184], "rpy_deg": [0.0, 0.0, 60.0]}}},
            "contacts": [{"between": ["card", "ball"], "friction": 0.3}],
            "sensors": {"wrench": {"type": "wrench", "on": "arm"}},
        },
        "ball",
    )  # fmt: skip
    path = np.array([[0.01, 0.0, 0.0184], [0.01, 0.0, 0.0152], [0.012, 0.001, 0.0152]])
    turned = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0], [0.03, 0.05, 0.02, 0.998]])
    turned = (Rotation.from_quat(turned) * Rotation.from_euler("z", 60.0, degrees=True)).as_quat()
    return rig, {"arm": PoseTrajectory(np.array([0.0, 0.05, 0.1]), path, turned)}, np.linspace(0.0, 0.07, 15)


def laid(small_rig, friction, **changes):
    """A card that is held at one end and has settled on a post; ``friction``: of both, and the contact's stiffness."""
    rig = small_rig(**changes)
    given = rig.model_dump(mode="json", exclude_none=True)
    given["bodies"]["post"]["pose"]["position_m"] = [0.04, 0.0, 0.0297]
    given["contacts"] = [{"between": ["card", "post"], **friction}]
    return parse_rig(given, "laid")
