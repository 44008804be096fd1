"""Strips that cross, one that is folded onto itself, and a strip under a ball: contact of surfaces and of edges."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig, parse_rig
from sim_core.rigs.trajectory import PoseTrajectory

THICKNESS = 4e-4


def _strip(position: list[float], turn_deg: float, cells: list[int], **shape: Any) -> dict[str, Any]:
    return {
        "type": "sheet",
        "shape": {
            "type": "rectangle",
            "length_m": 0.06,
            "width_m": 0.02,
            "cells": cells,
            "pattern": "crossed",
            **shape,
        },
        "pose": {
            "position_m": position,
            "quaternion_xyzw": Rotation.from_euler("z", turn_deg, degrees=True).as_quat().tolist(),
        },
        "material": {
            "E_pa": 2.0e8,
            "nu": 0.3,
            "thickness_m": THICKNESS,
            "density_kg_m3": 900.0,
            "stiffness_damping_s": 1e-3,
        },
    }


def _rig(name: str, bodies: dict[str, Any], contacts: list[list[str]], clamps: list[dict[str, Any]]) -> Rig:
    return parse_rig(
        {
            "name": name,
            "gravity_m_s2": [0.0, 0.0, -9.81],
            "solver": {"dt_s": 0.01, "inertia": True, "integrator": "bdf2"},
            "bodies": bodies,
            "clamps": clamps,
            "end_effectors": {"gripper": {"start": {"position_m": [0.0, 0.0, 0.0]}}},
            "contacts": [{"between": pair, "friction": 0.3} for pair in contacts],
            "sensors": {"wrist": {"type": "wrench", "on": "gripper", "rate_hz": 100.0}},
        },
        name,
    )


def _box(position: list[float]) -> dict[str, Any]:
    return {
        "type": "rigid",
        "shape": {"type": "box", "size_m": [0.01, 0.04, 0.01]},
        "mount": "gripper",
        "pose": {
            "position_m": position,
            "quaternion_xyzw": Rotation.from_euler("y", 40.0, degrees=True).as_quat().tolist(),
        },
    }


def crossing() -> Rig:
    """Two strips, the upper one in the gripper, which cross with their free ends."""
    lower, upper = _strip([0.0, 0.0, 0.0], 0.0, [6, 2]), _strip([0.012, -0.02, 0.001], 80.0, [5, 2])
    clamps = [
        {"name": "vice", "body": "lower", "region": {"x_m": [-0.031, -0.02]}, "mount": "world"},
        {"name": "jaws", "body": "upper", "region": {"x_m": [-0.031, -0.02]}, "mount": "gripper"},
    ]
    return _rig("crossing", {"lower": lower, "upper": upper}, [["lower", "upper"]], clamps)


def under_a_box() -> Rig:
    """A strip under the edge of a box in the gripper."""
    clamps = [{"name": "vice", "body": "strip", "region": {"x_m": [-0.031, -0.02]}, "mount": "world"}]
    bodies = {"strip": _strip([0.0, 0.0, 0.0], 0.0, [6, 2]), "box": _box([0.0151, 0.0013, 0.0081])}
    return _rig("under_a_box", bodies, [["strip", "box"]], clamps)


def folded() -> Rig:
    """A strip whose upper half a box presses on its lower half, which is held."""
    strip = _strip([0.0, 0.0, 0.0], 0.0, [16, 2], folds=[{"at_m": 0.0, "angle_deg": 176.0, "over_m": 0.008}])
    clamps = [{"name": "vice", "body": "strip", "region": {"x_m": [-0.031, -0.004]}, "mount": "world"}]
    bodies = {"strip": strip, "box": _box([-0.0179, 0.0013, 0.0151])}
    return _rig("folded", bodies, [["strip", "strip"], ["strip", "box"]], clamps)


RIGS = {"crossing": crossing, "under_a_box": under_a_box, "folded": folded}


def moved(times: list[float], shifts: list[list[float]]) -> dict[str, PoseTrajectory]:
    """Shifts [m] of the gripper."""
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1))
    return {"gripper": PoseTrajectory.from_samples(np.array(times), np.array(shifts, dtype=float), quaternions)}


PRESS_AND_RUB = {
    name: moved([0.0, 0.1, 0.2, 0.3], [[0, 0, 0], [0, 0, -by], [0.002, 0.003, -by - 0.001], [0.003, 0.002, 0.002 - by]])
    for name, by in (("crossing", 0.003), ("under_a_box", 0.003), ("folded", 0.0058))
}
"""Shifts of the gripper by which they touch, rub and part."""
