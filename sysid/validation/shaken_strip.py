"""What a hand feels that shakes a strip: inertia in the wrench.

A strip of which the mass m is not in the hand, held at one end and shaken along itself, x = X (1 - cos(w t)), puts the
force -m a on the hand as long as its own vibrations along x are far faster: of the strip as a bar, m a tan(k) / k,
k = w L sqrt(rho / E). Across its length the same holds against its slowest bending vibration, so the strip is short and
stiff here. The cells in the hand are part of the hand.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig, parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sysid.validation.case import FORCES, Case

LENGTH, WIDTH, THICKNESS, MODULUS, DENSITY = 0.04, 0.02, 1e-3, 3e9, 1200.0
AMPLITUDE_M, FREQUENCY_HZ, STEPS = 2e-3, 4.0, 200
"""Of the motion, and steps a period."""
NEWTON = "Newton, F = -m a"


def shaken_rig() -> Rig:
    """The strip, of which a cell at one end is in the hand; the sensor is at the middle of the strip's grip line."""
    shape = {"type": "rectangle", "length_m": LENGTH, "width_m": WIDTH, "cells": [8, 4], "pattern": "regular"}
    material = {"E_pa": MODULUS, "nu": 0.0, "thickness_m": THICKNESS, "density_kg_m3": DENSITY}
    return parse_rig(
        {
            "name": "shaken_strip",
            "gravity_m_s2": [0.0, 0.0, 0.0],
            "solver": {"dt_s": 1.0 / FREQUENCY_HZ / STEPS, "integrator": "bdf2"},
            "bodies": {"strip": {"type": "sheet", "shape": shape, "material": material}},
            "clamps": [
                {"name": "grip", "body": "strip", "region": {"x_m": [-0.5 * LENGTH, -0.375 * LENGTH]}, "mount": "hand"}
            ],
            "end_effectors": {"hand": {}},
            "sensors": {"force": {"type": "wrench", "on": "grip", "topic": "wrench"}},
        },
        "shaken_strip",
    )


def felt(axis: int) -> np.ndarray:
    """Amplitudes of force [N] and torque [N m] ``(6,)``, in phase with the acceleration, over the second period of a
    motion along an axis."""
    simulation = Simulation(build_scene(shaken_rig()))
    times = np.arange(1, 2 * STEPS + 1) / STEPS / FREQUENCY_HZ
    readings = []
    for t in times:
        place = np.zeros(3)
        place[axis] = AMPLITUDE_M * (1.0 - np.cos(2.0 * np.pi * FREQUENCY_HZ * t))
        simulation.step({"hand": (place, Rotation.identity())}, 1.0 / FREQUENCY_HZ / STEPS)
        readings.append(simulation.read()["force"])
    wave = np.cos(2.0 * np.pi * FREQUENCY_HZ * times[STEPS:])
    return np.asarray(2.0 / STEPS * wave @ np.array(readings[STEPS:]))


def shaken_strip_cases() -> Iterator[Case]:
    """All comparisons of a strip that is shaken."""
    mass = 0.875 * LENGTH * WIDTH * THICKNESS * DENSITY
    push = -mass * AMPLITUDE_M * (2.0 * np.pi * FREQUENCY_HZ) ** 2
    mesh = f"regular 8 x 4, {STEPS} steps a period"
    for axis, words in ((0, "along itself"), (2, "across")):
        found = float(felt(axis)[axis])
        yield Case(f"strip shaken {words}", "force on the hand", "m a", 1.0, found / push, FORCES, mesh, NEWTON)
