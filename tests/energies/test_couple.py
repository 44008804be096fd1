"""A couple that follows the body: its potential, its forces, and what it does to a free body."""

import numpy as np
import pytest
import scipy.sparse as sp
from potentials import Look, check_derivatives

from sim_core.energies.couple import Couple
from sim_core.solve.system import System

AXIS = np.array([2.0, -1.0, 2.0]) / 3.0
MOMENT = 0.7


def system():
    """Two lines of nodes in general position."""
    nodes = np.random.default_rng(5).normal(size=(4, 3))
    term = Couple("couple", np.array([[0, 1], [3, 2]]), AXIS, np.array([0.25, 0.75]))
    term.configure({"moment_nm": MOMENT})
    mass = sp.identity(4).tocsr()
    return Look(System(nodes, mass, np.zeros((4, 3), dtype=bool), [term], np.zeros(3), inertia=False))


def test_forces_and_stiffness_are_derivatives_of_the_work():
    one = system()
    check_derivatives(one, one.x + 0.1 * np.random.default_rng(6).normal(size=(4, 3)), h=1e-6, tolerance=1e-7)


def test_it_has_no_resultant_and_its_moment_about_the_axis():
    one = system()
    force = -one.exerted()
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-15)
    assert np.cross(one.x, force).sum(axis=0) @ AXIS == pytest.approx(MOMENT)


def test_its_moment_turns_with_the_lines():
    one = system()
    before = -one.exerted()
    turn = 2.2
    cross = np.cross(np.eye(3), -AXIS)
    rotation = np.eye(3) + np.sin(turn) * cross + (1.0 - np.cos(turn)) * cross @ cross
    one.x[:] = one.x @ rotation.T
    np.testing.assert_allclose(-one.exerted(), before @ rotation.T, atol=1e-14)


def test_forces_and_stiffness_do_not_depend_on_where_the_step_starts():
    one, found = system(), []
    end = one.x + 0.3 * np.random.default_rng(8).normal(size=(4, 3))
    for seed in (1, 2):
        one.begin(one.system.nodes + 0.3 * np.random.default_rng(seed).normal(size=(4, 3)))
        one.x[:] = end
        found.append((one.energy(), one.exerted(), one.hessian(exact=True)))
    assert np.array_equal(found[0][1], found[1][1]) and np.array_equal(found[0][2], found[1][2])
    assert found[0][0] != found[1][0]


def test_the_work_between_two_ends_does_not_depend_on_where_the_step_starts():
    """Of turns of less than half a circle: the couple is conservative."""
    one, work = system(), []
    nodes = one.system.nodes
    ends = [nodes + 0.1 * np.random.default_rng(seed).normal(size=(4, 3)) for seed in (3, 4)]
    for start in (nodes, ends[0]):
        one.begin(start)
        energies = []
        for x in ends:
            one.x[:] = x
            energies.append(one.energy())
        work.append(energies[1] - energies[0])
    assert work[0] == pytest.approx(work[1], rel=1e-12)
