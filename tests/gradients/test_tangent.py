"""Forward sensitivities of whole rollouts against central differences of whole rollouts."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.gradients import simulate_tangent
from sim_core.rigs import list_parameters, with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, run, simulate, step_times
from sim_core.solve.step import NewtonSettings

EXACT = NewtonSettings(step_tolerance_m=1e-11)
"""Of the rollouts that differences are taken of."""
PRESS = ([0.0, 0.1, 0.3, 0.6], [[0, 0, 0], [0, 0, 0], [0, 0, -0.008], [0.004, 0, -0.008]])
RUB = (
    [0.0, 0.1, 0.25, 0.35, 0.6],
    [[0, 0, 0], [0.055, 0, 0], [0.055, 0, -0.0008], [0.055, 0, -0.0008], [0.059, 0, -0.0008]],
)


def compare(rig, poses, name, tolerance, wide=1e-4):
    times = step_times(0.0, float(poses["finger"].times[-1]), rig.solver.dt_s)
    value = next(p.value for p in list_parameters(rig) if p.name == name)
    scene = build_scene(rig)
    step = 1e-6
    neighbour = with_parameters(rig, {name: value * (1.0 + step)})
    trace, derivatives = simulate_tangent(scene, poses, times, [neighbour], [step])
    assert max(r.contacts for r in trace.reports) > 0
    low, high = (
        run(Simulation(build_scene(with_parameters(rig, {name: value * (1.0 + s * wide)})), EXACT), poses, times)
        for s in (-1, 1)
    )
    for channel in ("wrench", "side", "markers"):
        central = (high.outputs[channel] - low.outputs[channel]) / (2.0 * wide)
        ours = derivatives[channel][..., 0]
        if channel == "wrench":
            central, ours = central[:, :3], ours[:, :3]
        scale = np.abs(central).max()
        if scale > 1e-7:
            assert np.abs(ours - central).max() < tolerance * scale, channel


@pytest.mark.parametrize("name", ["card.E_pa", "card.density_kg_m3"])
def test_sheet_parameters_through_contact_and_motion(small_rig, visit, name):
    """Wide differences: a step's tolerance, pm where the card is first touched, shows in narrow ones."""
    compare(small_rig(), visit(*PRESS), name, 1e-3, wide=1e-3)


@pytest.mark.parametrize("name", ["card.E_pa", "card.density_kg_m3"])
def test_steps_that_look_back(small_rig, visit, name):
    rig = small_rig(solver={"dt_s": 0.02, "inertia": True, "integrator": "bdf2"})
    compare(rig, visit(*PRESS), name, 1e-3, wide=1e-3)


@pytest.mark.parametrize("name", ["gel.E_pa", "gel.nu", "contacts.gel-post.friction"])
def test_gel_parameters_through_sticking_and_sliding(small_rig, visit, name):
    compare(small_rig(), visit(*RUB), name, 2e-3)


def test_effect_with_memory(small_rig, visit):
    rig = small_rig(effects={"gel_relaxation": {"share": 0.3, "tau_s": 0.2}})
    compare(rig, visit(*RUB), "effects.gel_relaxation.tau_s", 2e-3, wide=1e-2)


def test_compliant_end_effector(small_rig, visit):
    rig = small_rig(effects={"end_effector_compliance": {"compliance_m_per_n": 2e-4}})
    compare(rig, visit(*RUB), "effects.end_effector_compliance.compliance_m_per_n", 2e-3)


def test_tangent_leaves_the_rollout_as_it_is(small_rig, visit):
    rig, poses = small_rig(), visit(*RUB)
    times = step_times(0.0, 0.4, 0.02)
    plain = simulate(build_scene(rig), poses, times)
    neighbour = with_parameters(rig, {"gel.E_pa": 1.000001e5})
    carried, _ = simulate_tangent(build_scene(rig), poses, times, [neighbour], [1e-6])
    for channel in plain.outputs:
        assert np.array_equal(plain.outputs[channel], carried.outputs[channel])
