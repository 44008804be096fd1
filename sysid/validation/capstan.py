"""A strip pulled around a drum that is fixed: the ratio of the tensions at its ends (Euler, Eytelwein).

    T_pulled / T_held = exp(mu phi)

for a thin strip that slips everywhere, wrapped around the angle phi. The rig is one that anybody can write: clamps,
contact with its default constants, wrenches at the clamps. The strip is folded around the drum, drawn tight, and then
both of its ends move the same way.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.rigs import Rig, parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sysid.validation.case import FORCES, Case

RADIUS, THICKNESS, WIDTH, LEG, MU = 0.01, 1e-4, 0.01, 0.02, 0.3
TIGHT_M, PULL_M = 1e-4, 1e-3
"""Way of both ends apart, and then along the strip."""

SOURCE = "Euler-Eytelwein, exp(mu phi)"


def capstan_rig(angle_deg: float, cells: int) -> Rig:
    """The strip around the drum by an angle, with cells along it."""
    middle = RADIUS + 0.5 * THICKNESS
    arc = float(np.radians(angle_deg)) * middle
    length, grip = arc + 2 * LEG, 0.1 * LEG
    half = 0.5 * length
    strip = {
        "type": "sheet",
        "shape": {
            "type": "rectangle",
            "length_m": length,
            "width_m": WIDTH,
            "cells": [cells, 1],
            "pattern": "regular",
            "folds": [{"at_m": 0.0, "angle_deg": angle_deg, "over_m": arc}],
        },
        "material": {"E_pa": 3e9, "nu": 0.0, "thickness_m": THICKNESS, "density_kg_m3": 1000.0},
    }
    drum = {
        "type": "rigid",
        "shape": {"type": "cylinder", "radius_m": RADIUS, "length_m": 5 * WIDTH},
        "pose": {"position_m": [-0.5 * arc, 0.0, middle], "rpy_deg": [90.0, 0.0, 0.0]},
    }
    ends = {
        "held": {"body": "strip", "region": {"x_m": [-half, grip - half]}, "mount": "low"},
        "pulled": {"body": "strip", "region": {"x_m": [half - grip, half]}, "mount": "high"},
    }
    return parse_rig(
        {
            "name": "capstan",
            "gravity_m_s2": [0.0, 0.0, 0.0],
            "solver": {"dt_s": 0.01, "inertia": False},
            "bodies": {"strip": strip, "drum": drum},
            "clamps": [{"name": name, **clamp} for name, clamp in ends.items()],
            "end_effectors": {
                mount: {"topics": {"target_pose": f"{mount}/target", "current_pose": f"{mount}/current"}}
                for mount in ("low", "high")
            },
            "contacts": [{"between": ["strip", "drum"], "friction": MU}],
            "sensors": {f"on_{name}": {"type": "wrench", "on": name, "topic": name} for name in ends},
        },
        "capstan",
    )


def tension_ratio(angle_deg: float, cells: int, steps: tuple[int, int] = (8, 20)) -> float:
    """Pulled over held; ``steps``: to draw the strip tight, and to pull it."""
    simulation = Simulation(build_scene(capstan_rig(angle_deg, cells)))
    start, angle = dict(simulation.frames), np.radians(angle_deg)
    away = {"low": np.array([-1.0, 0.0, 0.0]), "high": np.array([np.cos(angle), 0.0, np.sin(angle)])}
    tight = [(TIGHT_M * k / steps[0], 0.0) for k in range(1, steps[0] + 1)]
    pulled = [(TIGHT_M, PULL_M * k / steps[1]) for k in range(1, steps[1] + 1)]
    for apart, along in [*tight, *pulled]:
        way = {"low": apart - along, "high": apart + along}
        frames = {mount: (start[mount][0] + way[mount] * away[mount], start[mount][1]) for mount in away}
        simulation.step(frames, 0.01)
    read = simulation.read()
    return float(np.linalg.norm(read["on_pulled"][:3]) / np.linalg.norm(read["on_held"][:3]))


def capstan_cases() -> Iterator[Case]:
    """All comparisons of a strip around a drum."""
    for angle, cells in ((90.0, 30), (180.0, 40)):
        exact = float(np.exp(MU * np.radians(angle)))
        found = tension_ratio(angle, cells)
        yield Case(
            f"strip around a drum by {angle:g} degrees, mu = {MU:g}", "ratio of tensions", "1", exact, found, FORCES,
            f"regular {cells} x 1", SOURCE,
        )  # fmt: skip
