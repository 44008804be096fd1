from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sheet_systems import both_ends, film, left

from sim_core.errors import ConvergenceError
from sim_core.solve.step import NewtonSettings, Result, State, advance, potential


def at_rest(system):
    return State(0.0, system.nodes, np.zeros_like(system.nodes), system.initial_internals())


def bent(system, mesh, angle, settings=None):
    """The right end of a film turned by ``angle`` about y in one static step, and moved along."""
    right = mesh.nodes[:, 0] > 0.031
    targets = mesh.nodes.copy()
    turn = Rotation.from_rotvec([0.0, -angle, 0.0])
    pivot = np.array([0.031, 0.0, 0.0])
    targets[right] = pivot + turn.apply(mesh.nodes[right] - pivot) + [-0.012 * angle, 0.0, 0.014 * angle]
    return *advance(system, at_rest(system), targets, 1.0, settings), targets


def largest_force(system, found):
    return max(
        np.abs(found.gradient).max(), np.abs(system.mass @ np.tile(system.gravity, (len(system.nodes), 1))).max()
    )


def honest(system, state, targets, report):
    """The residual is what the report says, and within the tolerance."""
    found = potential(system, state, targets=targets)
    residual = np.abs(found.gradient[~system.prescribed]).max()
    assert residual == pytest.approx(report.residual_n, rel=1e-3, abs=1e-11)
    assert residual <= NewtonSettings().force_tolerance * largest_force(system, found)


def test_both_newtons_find_the_same_equilibrium_and_the_fast_one_needs_fewer_iterations():
    system, mesh = film(both_ends, inertia=False, cells=(16, 2))
    fast, quick, targets = bent(system, mesh, 0.6)
    honest(system, fast, targets, quick)
    slow, patient, _ = bent(system, mesh, 0.6, NewtonSettings(fast_iterations=0, max_iterations=300))
    honest(system, slow, targets, patient)
    np.testing.assert_allclose(fast.x, slow.x, atol=1e-9)
    assert quick.iterations < 20
    assert quick.iterations < 0.5 * patient.iterations


def test_large_load_in_one_step():
    """A film sags by most of its length under ten times its weight, from flat, in one static step."""
    system, mesh = film(left, inertia=False, cells=(16, 2), gravity=(0.0, 0.0, -98.1))
    state, report = advance(system, at_rest(system), mesh.nodes, 1.0)
    honest(system, state, mesh.nodes, report)
    assert report.iterations < 60
    assert state.x[:, 2].min() < -0.02


def test_snap_through_of_a_static_arch_converges():
    """Pushed together and then through at the middle, an arch loses its balance and finds the other one."""
    system, mesh = film(both_ends, inertia=False, cells=(12, 2), gravity=(0.0, 0.0, 0.5))
    right = mesh.nodes[:, 0] > 0.031
    targets, state = mesh.nodes.copy(), at_rest(system)
    for _ in range(5):
        targets[right, 0] -= 8e-4
        state, _ = advance(system, state, targets, 1.0)
    top = int(np.argmax(state.x[:, 2]))
    assert state.x[top, 2] > 5e-3
    height = state.x[top, 2]
    for k in range(1, 13):
        system.loads[:] = 0.0
        system.loads[np.abs(mesh.nodes[:, 0]) < 0.006, 2] = -0.004 * k
        state, report = advance(system, state, targets, 1.0)
        honest(system, state, targets, report)
    assert state.x[top, 2] < -0.5 * height


def test_a_step_that_does_not_converge_raises_and_says_so():
    system, mesh = film(both_ends, inertia=False, cells=(16, 2))
    few = NewtonSettings(fast_iterations=0, max_iterations=3)
    with pytest.raises(ConvergenceError, match="iteration limit"):
        bent(system, mesh, 0.6, few)
    targets = mesh.nodes.copy()
    targets[mesh.nodes[:, 0] > 0.031, 0] -= 0.01
    state, report = advance(system, at_rest(system), targets, 1.0, few, check=False)
    assert report.result is Result.ITERATION_LIMIT
    assert not report.converged
    found = potential(system, state, targets=targets)
    assert report.residual_n > NewtonSettings().force_tolerance * largest_force(system, found)


def test_not_finite_is_reported():
    system, mesh = film(left)
    state = replace(at_rest(system), v=np.full_like(mesh.nodes, np.nan))
    _, report = advance(system, state, mesh.nodes, 0.01, check=False)
    assert report.result is Result.NOT_FINITE


def test_a_guess_changes_the_way_but_not_the_result():
    system, mesh = film(left, inertia=False)
    state, _ = advance(system, at_rest(system), mesh.nodes, 1.0)
    guess = state.x + 1e-4 * np.random.default_rng(0).standard_normal(state.x.shape) * ~system.prescribed
    again, report = advance(system, at_rest(system), mesh.nodes, 1.0, guess=guess)
    honest(system, again, mesh.nodes, report)
    np.testing.assert_allclose(again.x, state.x, atol=1e-9)


def test_steps_do_not_change_the_state_they_start_from():
    system, mesh = film(left)
    state = at_rest(system)
    kept = state.x.copy(), state.v.copy()
    moved, _ = advance(system, state, mesh.nodes, 0.01)
    assert np.array_equal(state.x, kept[0])
    assert np.array_equal(state.v, kept[1])
    again, _ = advance(system, state, mesh.nodes, 0.01)
    np.testing.assert_array_equal(moved.x, again.x)
