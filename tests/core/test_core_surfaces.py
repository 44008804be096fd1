"""Contact of surfaces and of edges on the compiled core, against the same laws launched one by one from Python."""

from __future__ import annotations

import numpy as np
import pytest
from strip_over_table import by_python
from strips_that_touch import PRESS_AND_RUB, RIGS

from sim_core.core.covers import covers
from sim_core.core.rollout import CoreRollout
from sim_core.gradients import directions, simulate_tangent
from sim_core.gradients.tangent import TangentSimulation, recorded
from sim_core.rigs import list_parameters
from sim_core.scene import build_scene
from sim_core.simulate import step_times
from sim_core.solve.integrator import step_context
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-12, force_tolerance=1e-10)


@pytest.mark.parametrize("name", RIGS)
def test_rollouts_are_those_of_the_launched_laws(name):
    scene, times = build_scene(RIGS[name]()), step_times(0.0, 0.3, 0.01)
    assert covers(scene) is None
    core = CoreRollout(scene, PRESS_AND_RUB[name], times, TIGHT)
    core.settle()
    x = np.concatenate([chunk.at.x for chunk in core.run()])
    expected = by_python(build_scene(RIGS[name]()), PRESS_AND_RUB[name], times, TIGHT)
    assert np.abs(x - expected.path.positions[1:]).max() < 1e-8
    assert max(r.contacts for r in core.reports) > 0
    assert core.handed_over < len(times) - 1


@pytest.mark.parametrize("name", RIGS)
def test_energy_gradient_and_hessian_are_those_of_the_launched_laws(name):
    """At random states about one in contact, entry by entry."""
    scene, times = build_scene(RIGS[name]()), step_times(0.0, 0.3, 0.01)
    core = CoreRollout(scene, PRESS_AND_RUB[name], times, TIGHT)
    core.settle()
    loaded, rng, system = 0, np.random.default_rng(0), scene.system
    for chunk in core.run():
        k = chunk.steps.stop - 1
        state = core.state_now(0.0)
        there = state.x + 1e-6 * rng.standard_normal(state.x.shape)
        there[system.prescribed] = state.x[system.prescribed]
        energy, gradient, hessian = core.potential(0.01, there, k)
        system.set_targets(scene.targets(core.frames(k)))
        system.x[:] = state.x
        system.begin_step(step_context(state.x, state.v, 0.01, state.past, 0.0), state.internals)
        system.x[:] = there
        system.cover()
        upper, spread = np.triu(system.hessian(exact=True).toarray()), system.spread_matrix
        expected = upper + np.triu(upper, 1).T
        assert energy == pytest.approx(system.energy(), rel=1e-10)
        slope = system.gradient()
        np.testing.assert_allclose(gradient, slope, atol=1e-10 * np.abs(slope).max())
        np.testing.assert_allclose(spread.T @ hessian @ spread, expected, atol=1e-10 * np.abs(expected).max())
        loaded += system.contacts()[0]
    assert loaded > 0


@pytest.mark.parametrize("name", ["under_a_box", "folded"])
def test_derivatives_are_those_of_the_launched_laws(name):
    rig, times = RIGS[name](), step_times(0.0, 0.2, 0.01)
    wanted = ("E_pa", "friction", "thickness", "offset_z", "offset_x_m")
    names = [p.name for p in list_parameters(rig) if p.value is not None and any(w in p.name for w in wanted)]
    scene, along = build_scene(rig), directions(rig, names)
    _, found = simulate_tangent(scene, PRESS_AND_RUB[name], times, along, settings=TIGHT)
    _, expected = recorded(TangentSimulation(build_scene(rig), along, TIGHT, []), PRESS_AND_RUB[name], times, along)
    for channel, slopes in expected.items():
        for k, parameter in enumerate(names):
            size = np.nanmax(np.abs(slopes[..., k]))
            assert np.nanmax(np.abs(found[channel][..., k] - slopes[..., k])) <= 1e-8 * size, (channel, parameter)
