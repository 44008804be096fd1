"""Parts of the guarded Newton by themselves."""

import numpy as np
import pytest

from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sim_core.solve import contact_newton as guarded
from sim_core.solve.integrator import step_context

DT = 0.02
DROP = 9.81 * DT**2
"""How far the minimum of the first step of a fall is [m]."""


def further(height, first):
    """Total move [m] of a free strip at ``height`` [m] over a plane that has made a ``first`` part of its fall."""
    strip = {
        "type": "sheet",
        "shape": {"type": "rectangle", "length_m": 0.06, "width_m": 0.01, "cells": [4, 1]},
        "pose": {"position_m": [0.0, 0.0, height]},
        "material": {"preset": "paper_80gsm"},
    }
    table = {"type": "rigid", "shape": {"type": "plane"}}
    contacts = [{"between": ["strip", "table"]}]
    rig = parse_rig({"name": "fall", "bodies": {"strip": strip, "table": table}, "contacts": contacts}, "fall")
    simulation = Simulation(build_scene(rig))
    system, x = simulation.scene.system, simulation.state.x
    system.set_targets(x)
    system.begin_step(step_context(x, np.zeros_like(x), DT), simulation.state.internals)
    system.guard(True)
    start = system.unknowns()
    down = np.tile([0.0, 0.0, -first], len(start) // 3)
    system.set_unknowns(start + down)
    guarded._further(system, start, 0.0, x.copy(), np.zeros_like(x))
    moved = start - system.unknowns()
    assert np.ptp(moved[2::3]) == pytest.approx(0.0, abs=1e-12)
    return float(moved[2])


def test_moves_are_doubled_while_the_energy_falls():
    """The energy is a parabola with its minimum at the drop: 3.92 mm."""
    assert further(0.05, 1e-3) == pytest.approx(4e-3, rel=1e-9)  # 8 mm is as far beyond as 0 is short of it
    assert further(0.05, 1.5e-3) == pytest.approx(3e-3, rel=1e-9)
    assert further(0.05, 4.5e-3) == pytest.approx(4.5e-3, rel=1e-9)


def test_moves_are_doubled_so_often_at_most():
    assert further(0.05, 1e-6) == pytest.approx(2.0**guarded.DOUBLINGS * 1e-6, rel=1e-9)


def test_moves_are_not_doubled_into_contact():
    assert DROP > 2e-3
    assert further(1e-3, 1e-4) == pytest.approx(8e-4, rel=1e-9)
