"""Searches end where nothing but round-off is left to balance."""

from __future__ import annotations

import pytest

from sim_core.rigs import load_rig, with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sim_core.solve.report import NewtonSettings


@pytest.mark.parametrize("gravity", [0.0, 1e-6, 9.81])
def test_a_gel_that_nothing_loads_settles_in_few_iterations(gravity: float) -> None:
    """Its elastic forces have round-off of 1e-14 N, far above a millionth of its weight where that is 1e-8 N."""
    rig = with_parameters(load_rig("tactip_cr"), {"gravity.x_m_s2": gravity, "gravity.z_m_s2": 0.0})
    scene = build_scene(rig)
    tried = 0
    residual = scene.system.residual

    def counted():
        nonlocal tried
        tried += 1
        assert tried < 150
        return residual()

    scene.system.residual = counted
    Simulation(scene, NewtonSettings(step_tolerance_m=1e-14))
    assert tried > 0
    assert 0.0 < scene.system.force_noise() < 1e-13


def test_a_mount_that_hardly_gives_way_makes_no_force_uncertain(small_rig) -> None:
    """The spring of a compliance acts on a deflection, which is small and knows no origin."""
    noises = []
    for compliance in (1e-4, 1e-8):
        scene = build_scene(small_rig(effects={"end_effector_compliance": {"compliance_m_per_n": compliance}}))
        Simulation(scene)
        noises.append(scene.system.force_noise())
    assert 0.0 < noises[1] < 1e-9 and noises[1] == pytest.approx(noises[0], rel=0.1)
