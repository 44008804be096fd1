"""Few tangents a step: what a kept one learns, when it is given up, and how an overshoot is taken back."""

import numpy as np
import pytest
from sheet_systems import both_ends, film, left

from sim_core.rigs import load_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sim_core.solve.line_search import ENOUGH, shorten
from sim_core.solve.step import NewtonSettings, State, advance
from sim_core.solve.tangent import Tangent


class Dense:
    """A factorised matrix."""

    def __init__(self, matrix):
        self._inverse = np.linalg.inv(matrix)

    def solve(self, rhs):
        return self._inverse @ rhs


class Spring:
    """Unknowns of a system with a residual of one's own."""

    def __init__(self, force):
        self._force = force
        self.at = np.zeros(2)

    def set_unknowns(self, values):
        self.at = values.copy()

    def residual(self):
        return self._force(self.at)


def stiffness(seed=0, n=6):
    root = np.random.default_rng(seed).standard_normal((n, n))
    return root @ root.T + n * np.eye(n)


def test_a_kept_tangent_reproduces_what_the_residual_did_over_the_last_step():
    k = stiffness()
    tangent = Tangent(Dense(k), definite=True)
    rng = np.random.default_rng(1)
    before, after = rng.standard_normal((2, 6))
    full = tangent.answer(before)
    step = 0.6 * full
    tangent.learn(full, step, after)
    np.testing.assert_allclose(-tangent.answer(after - before), step, atol=1e-12)


def test_a_kept_tangent_learns_a_contact_that_was_not_in_it():
    """One stiff direction is missing in the matrix; a plain modified Newton diverges, this one finds it."""
    k = stiffness()
    normal = np.eye(6)[2]
    true = k + 1e3 * np.outer(normal, normal)
    load = np.arange(1.0, 7.0)
    tangent = Tangent(Dense(k), definite=True)
    x = np.zeros(6)
    direction = tangent.answer(true @ x - load)
    for _ in range(4):
        x = x + direction
        direction = tangent.learn(direction, direction, true @ x - load)
    np.testing.assert_allclose(x, np.linalg.solve(true, load), atol=1e-9)


@pytest.mark.parametrize("kink", [0.2, 0.9])
def test_an_overshoot_is_shortened_to_where_the_residual_along_it_is_small(kink):
    """Soft up to the kink and ten times stiffer beyond, as where contact closes within a step."""
    step = np.array([1.0, 0.5])

    def force(at):
        along = at @ step / (step @ step)
        return (along - 1.0 + 10.0 * max(0.0, along - kink)) * step

    spring = Spring(force)
    before, after = force(np.zeros(2)) @ step, force(step) @ step
    share, there, tries = shorten(spring, np.zeros(2), step, before, after)
    np.testing.assert_allclose(spring.at, share * step)
    np.testing.assert_array_equal(there, force(spring.at))
    assert abs(there @ step) <= ENOUGH * abs(before)
    assert 1 <= tries <= 4


def test_a_step_that_does_not_overshoot_is_left_alone():
    spring = Spring(lambda at: at - 1.0)
    assert shorten(spring, np.zeros(2), np.ones(2), -2.0, 0.1) == (1.0, None, 0)


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
    """The last Hessian that is factorised, and found positive definite, is the one at the solution."""
    system, mesh = film(both_ends, inertia=False, cells=(16, 2))
    factorised = []
    plain = system.factor_data

    def factor_data(data, definite):
        factorised.append(system.x.copy())
        return plain(data, definite)

    system.factor_data = factor_data
    targets = mesh.nodes.copy()
    targets[mesh.nodes[:, 0] > 0.031] += [-0.001, 0.0, 0.002]
    state = State(0.0, mesh.nodes, np.zeros_like(mesh.nodes), system.initial_internals())
    found, report = advance(system, state, targets, 1.0)
    assert report.factorisations < report.iterations - 1
    assert np.abs(factorised[-1] - found.x).max() < NewtonSettings().step_tolerance_m
