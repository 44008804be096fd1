"""A strip in a gripper above a table that a second hand may move: what the compiled core covers, on a coarse mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig, parse_rig
from sim_core.rigs.trajectory import PoseTrajectory

HEIGHT = 0.1


def strip_rig(**changes: Any) -> Rig:
    """``changes``: parts of the rig to replace."""
    data: dict[str, Any] = {
        "name": "strip_over_table",
        "gravity_m_s2": [0.0, 0.0, -9.81],
        "solver": {"dt_s": 0.01, "inertia": True, "integrator": "bdf2"},
        "bodies": {
            "strip": {
                "type": "sheet",
                "shape": {
                    "type": "rectangle",
                    "length_m": 0.08,
                    "width_m": 0.02,
                    "cells": [8, 1],
                    "pattern": "crossed",
                },
                "pose": {"position_m": [0.03, 0.0, HEIGHT]},
                "material": {
                    "E_pa": 4.0e9,
                    "nu": 0.3,
                    "thickness_m": 1.5e-4,
                    "density_kg_m3": 1200.0,
                    "stiffness_damping_s": 1e-3,
                    "mass_damping_per_s": 0.5,
                },
            },
            "table": {
                "type": "rigid",
                "shape": {"type": "plane"},
                "mount": "tray",
                "pose": {"position_m": [0.0, 0.0, 0.0]},
            },
        },
        "clamps": [{"name": "jaws", "body": "strip", "region": {"x_m": [-0.041, -0.029]}, "mount": "gripper"}],
        "end_effectors": {
            "gripper": {"start": {"position_m": [0.0, 0.0, HEIGHT]}},
            "tray": {
                "start": {"position_m": [0.0, 0.0, 0.0]},
                "topics": {"target_pose": "tray/target_pose", "current_pose": "tray/current_pose"},
            },
        },
        "contacts": [{"between": ["strip", "table"], "friction": 0.3}],
        "sensors": {
            "wrist": {"type": "wrench", "on": "gripper", "rate_hz": 100.0},
            "under": {"type": "wrench", "on": "tray", "rate_hz": 100.0, "topic": "tray/wrench"},
        },
        "cameras": {
            "side": {
                "model": "pinhole", "width_px": 640, "height_px": 480, "fx_px": 500.0, "fy_px": 500.0,
                "cx_px": 320.0, "cy_px": 240.0, "mount": "tray",
                "pose": {"position_m": [0.03, -0.3, 0.08], "quaternion_xyzw": [-0.7071, 0.0, 0.0, 0.7071]},
                "sees": [
                    {
                        "body": "strip",
                        "points": {"positions_m": [[-0.01, 0.004, 0.0], [0.02, -0.005, 0.0], [0.035, 0.0, 0.0]]},
                    }
                ],
                "rate_hz": 30.0,
            }
        },
    }  # fmt: skip
    return parse_rig({**data, **changes}, "strip over a table")


def motion(times: list[float], shifts: list[list[float]], turns_deg: list[list[float]]) -> PoseTrajectory:
    """Poses of the gripper from where it starts."""
    return PoseTrajectory.from_samples(
        np.array(times),
        np.array([0.0, 0.0, HEIGHT]) + np.array(shifts),
        Rotation.from_rotvec(np.array(turns_deg), degrees=True).as_quat(),
    )


SWING = {
    "gripper": motion(
        [0.0, 0.15, 0.3], [[0, 0, 0], [0.01, 0.005, 0.02], [0, 0, 0]], [[0, 0, 0], [0, 40, 20], [0, 0, 0]]
    )
}
"""Above the table."""

LAND = {
    "gripper": motion(
        [0.0, 0.15, 0.25, 0.4],
        [[0, 0, 0], [0, 0, -0.055], [0.008, 0.004, -0.06], [0.012, 0.0, -0.05]],
        [[0, 0, 0], [0, 50, 0], [0, 55, 5], [0, 50, 0]],
    ),
    "tray": PoseTrajectory.from_samples(
        np.array([0.0, 0.2, 0.4]),
        np.array([[0, 0, 0], [0, 0, 0.004], [-0.004, 0, 0]], dtype=float),
        Rotation.from_rotvec([[0, 0, 0], [3, 2, 0], [0, 4, 3]], degrees=True).as_quat(),
    ),
}
"""The tip lands on a table that turns, and slides on it."""
