"""Few tangents a step find what many find, and each search is judged by one of its own."""

import numpy as np
from sheet_systems import both_ends, film, left

from sim_core.rigs import load_rig
from sim_core.scene import build_scene
from sim_core.solve.step import NewtonSettings, State, advance
from sim_core.stepping import Simulation
from sysid.validation.small_motions import tangent_stiffness


def swing(settings=None, steps=6):
    """A film let go from straight, held at its left end: positions and reports."""
    system, mesh = film(left, cells=(16, 2))
    state = State(0.0, system.nodes, np.zeros_like(system.nodes), system.initial_internals())
    path, reports = [], []
    for _ in range(steps):
        state, report = advance(system, state, mesh.nodes, 0.01, settings)
        path.append(state.x)
        reports.append(report)
    return np.array(path), reports


def test_few_tangents_find_what_a_tangent_an_iteration_finds():
    path, reports = swing()
    careful, slow = swing(NewtonSettings(fast_iterations=0, step_tolerance_m=1e-10, max_iterations=300))
    np.testing.assert_allclose(path, careful, atol=1e-9)
    assert all(r.factorisations < r.iterations - 1 for r in reports)
    assert sum(r.factorisations for r in reports) < 0.5 * sum(r.factorisations for r in slow)


def test_a_steady_motion_is_foreseen():
    """A film carried along through space at constant speed is where its velocity leads."""
    system, mesh = film(left, gravity=(0.0, 0.0, 0.0))
    speed = np.array([0.3, 0.0, 0.1])
    state = State(0.0, mesh.nodes, np.tile(speed, (len(mesh.nodes), 1)), system.initial_internals())
    for k in range(1, 4):
        state, report = advance(system, state, mesh.nodes + 0.01 * k * speed, 0.01)
        assert report.update_m < 1e-12
        assert report.factorisations == 1
    np.testing.assert_allclose(state.x, mesh.nodes + 0.03 * speed, atol=1e-12)


def test_points_that_stick_and_slip_in_turn_do_not_stop_the_fast_newton():
    """A finger presses a card on a table: no step needs many tangents."""
    rig = load_rig("forming")
    scene = build_scene(rig)
    simulation = Simulation(scene)
    origin, rotation = scene.start["finger"]
    most = 0
    for k in range(1, 61):
        shift = np.array([0.0, 0.0, -6.5e-3 * k / 60])
        report = simulation.step({"finger": (origin + shift, rotation)}, rig.solver.dt_s)
        most = max(most, report.factorisations)
        assert report.converged
    assert report.contacts > 50
    assert most <= 8


def test_a_static_solution_is_judged_by_a_tangent_of_its_own():
    """Where the search ends the true Hessian is positive definite, though fewer tangents than iterations are made."""
    system, mesh = film(both_ends, inertia=False, cells=(16, 2))
    targets = mesh.nodes.copy()
    targets[mesh.nodes[:, 0] > 0.031] += [-0.001, 0.0, 0.002]
    state = State(0.0, mesh.nodes, np.zeros_like(mesh.nodes), system.initial_internals())
    _, report = advance(system, state, targets, 1.0)
    assert report.factorisations < report.iterations - 1
    assert np.linalg.eigvalsh(tangent_stiffness(system).toarray()).min() > 0.0
