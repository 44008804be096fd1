"""Searches end where nothing but round-off is left to balance."""

from __future__ import annotations

import pytest

from sim_core.rigs import load_rig, with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sim_core.solve.report import NewtonSettings


@pytest.mark.parametrize("gravity", [0.0, 1e-6, 9.81])
def test_a_gel_that_nothing_loads_is_in_balance_after_few_iterations(gravity: float) -> None:
    """Its elastic forces have round-off of 1e-14 N, far above a millionth of its weight where that is 4e-10 N."""
    rig = with_parameters(load_rig("tactip_cr"), {"gravity.x_m_s2": gravity, "gravity.z_m_s2": 0.0})
    simulation = Simulation(build_scene(rig), NewtonSettings(step_tolerance_m=1e-14))
    report = simulation.step({}, rig.solver.dt_s)
    assert report.iterations < 10 and report.residual_n < 1e-13
