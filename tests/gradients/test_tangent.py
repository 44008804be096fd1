"""Forward sensitivities of whole rollouts against central differences of whole rollouts."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.gradients import directions, simulate_tangent
from sim_core.rigs import list_parameters, parse_rig, with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sim_core.solve.step import NewtonSettings

PRESS = ([0.0, 0.1, 0.3, 0.6], [[0, 0, 0], [0, 0, 0], [0, 0, -0.008], [0.004, 0, -0.008]])
RUB = (
    [0.0, 0.1, 0.25, 0.35, 0.6],
    [[0, 0, 0], [0.055, 0, 0], [0.055, 0, -0.0008], [0.055, 0, -0.0008], [0.059, 0, -0.0008]],
)
TIGHT = NewtonSettings(step_tolerance_m=1e-15, force_tolerance=1e-13)


def compare(rig, poses, name, tolerance=1e-6, wide=1e-4):
    times = step_times(0.0, float(poses["finger"].times[-1]), rig.solver.dt_s)
    value = next(p.value for p in list_parameters(rig) if p.name == name)
    trace, derivatives = simulate_tangent(build_scene(rig), poses, times, directions(rig, [name]), settings=TIGHT)
    assert max(r.contacts for r in trace.reports) > 0
    low, high = (
        simulate(build_scene(with_parameters(rig, {name: value * (1.0 + s * wide)})), poses, times, settings=TIGHT)
        for s in (-1, 1)
    )
    for channel in ("wrench", "side", "markers"):
        central = (high.outputs[channel] - low.outputs[channel]) / (2.0 * wide * value)
        ours = derivatives[channel][..., 0]
        for part in (slice(0, 3), slice(3, 6)) if channel == "wrench" else (slice(None),):
            scale = np.abs(central[:, part]).max()
            if scale * value > 1e-9:
                assert np.abs(ours - central)[:, part].max() < tolerance * scale, channel


@pytest.mark.parametrize("name", ["card.E_pa", "card.density_kg_m3", "contacts.gel-card.friction"])
def test_sheet_parameters_through_contact_and_motion(small_rig, visit, name):
    compare(small_rig(), visit(*PRESS), name, wide=3e-4)


@pytest.mark.parametrize("name", ["card.E_pa", "card.density_kg_m3"])
def test_steps_that_look_back(small_rig, visit, name):
    rig = small_rig(solver={"dt_s": 0.02, "inertia": True, "integrator": "bdf2"})
    compare(rig, visit(*PRESS), name, 2e-6, wide=3e-4)


@pytest.mark.parametrize("name", ["gel.E_pa", "gel.nu", "contacts.gel-post.friction"])
def test_gel_parameters_through_sticking_and_sliding(small_rig, visit, name):
    compare(small_rig(), visit(*RUB), name, wide=3e-4)


@pytest.mark.parametrize("integrator", ["implicit_euler", "bdf2"])
@pytest.mark.parametrize(
    "name", ["card.mass_damping_per_s", "card.stiffness_damping_s", "gel.stiffness_damping_s", "card.density_kg_m3"]
)
def test_damping(small_rig, visit, name, integrator):
    """As a parameter, and while others are differentiated."""
    rig = small_rig(solver={"dt_s": 0.02, "inertia": True, "integrator": integrator})
    given = {"card.mass_damping_per_s": 5.0, "card.stiffness_damping_s": 5e-3, "gel.stiffness_damping_s": 0.02}
    # Positions change so little by damping of mass that round-off shows over a smaller step.
    wide = {"card.mass_damping_per_s": 1e-2, "card.density_kg_m3": 3e-4}.get(name, 3e-3)
    compare(with_parameters(rig, given), visit(*PRESS), name, 2e-6, wide=wide)


@pytest.mark.parametrize("flow", [False, True], ids=["elastic", "plastic"])
@pytest.mark.parametrize("beta", [0.0, 1e-3])
@pytest.mark.parametrize("name", ["card.stiffness_damping_s", "gel.stiffness_damping_s"])
def test_little_damping_or_none(small_rig, visit, name, beta, flow):
    """Far less than the time step, where a central difference would go below zero: differences to one side."""
    effects = {"bending_plasticity": {"yield_curvature_per_m": 0.5, "hardening_ratio": 0.3}} if flow else {}
    rig = with_parameters(small_rig(effects=effects), {name: beta})
    poses, times, h = visit(*PRESS), step_times(0.0, 0.26, rig.solver.dt_s), 2e-5
    _, derivatives = simulate_tangent(build_scene(rig), poses, times, directions(rig, [name]), settings=TIGHT)
    here, near, far = (
        simulate(build_scene(with_parameters(rig, {name: beta + k * h})), poses, times, settings=TIGHT)
        for k in range(3)
    )
    for channel in ("wrench", "side"):
        sided = (4.0 * near.outputs[channel] - 3.0 * here.outputs[channel] - far.outputs[channel]) / (2.0 * h)
        ours = derivatives[channel][..., 0]
        assert np.nanmax(np.abs(ours - sided)) < 1e-3 * np.nanmax(np.abs(sided)) > 0.0, channel


def test_effect_with_memory(small_rig, visit):
    rig = small_rig(effects={"gel_relaxation": {"share": 0.3, "tau_s": 0.2}})
    compare(rig, visit(*RUB), "effects.gel_relaxation.tau_s", wide=3e-4)


def test_plastic_bend(small_rig, visit):
    rig = small_rig(effects={"bending_plasticity": {"yield_curvature_per_m": 0.5, "hardening_ratio": 0.3}})
    compare(rig, visit(*PRESS), "effects.bending_plasticity.yield_curvature_per_m", 1e-5)


def test_static_friction(small_rig, visit):
    rig = small_rig(effects={"static_friction": {"excess": 0.4}})
    compare(rig, visit(*RUB), "effects.static_friction.excess")


def test_compliant_end_effector(small_rig, visit):
    rig = small_rig(effects={"end_effector_compliance": {"compliance_m_per_n": 2e-4}})
    compare(rig, visit(*RUB), "effects.end_effector_compliance.compliance_m_per_n")


def test_what_rests_without_friction_stays_where_it_rests(small_rig, visit):
    """A card that lies with its end on a smooth post: nothing moves, so derivatives of its place do not change."""
    rig = small_rig(contacts=[{"between": ["card", "post"], "friction": 0.0}])
    data = rig.model_dump()
    data["bodies"]["post"]["pose"] = {"position_m": [0.05, 0.0, 0.05 - 2.5e-4 - 0.02]}
    rig = parse_rig(data, "resting")
    poses, times = visit([0.0, 0.1], [[0, 0, 0], [0, 0, 0]]), step_times(0.0, 0.1, 0.02)
    trace, derivatives = simulate_tangent(
        build_scene(rig), poses, times, directions(rig, ["card.E_pa"]), settings=TIGHT
    )
    seen = derivatives["side"][..., 0]
    assert min(r.contacts for r in trace.reports) > 0 and np.abs(seen).max() > 0.0
    assert np.abs(seen - seen[0]).max() < 1e-6 * np.abs(seen[0]).max()


def test_tangent_leaves_the_rollout_as_it_is(small_rig, visit):
    rig, poses = small_rig(), visit(*RUB)
    times = step_times(0.0, 0.4, 0.02)
    plain = simulate(build_scene(rig), poses, times)
    carried, _ = simulate_tangent(build_scene(rig), poses, times, directions(rig, ["gel.E_pa"]))
    for channel in plain.outputs:
        assert np.array_equal(plain.outputs[channel], carried.outputs[channel])
