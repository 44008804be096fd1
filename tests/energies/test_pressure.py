"""Pressure on triangles and quadratic faces: its work, its derivatives, and where it is the pressure itself."""

import numpy as np
import pytest
from potentials import check_derivatives
from shell_terms import alone

from sim_core.energies.dead_load import DeadLoad, Schedule
from sim_core.energies.pressure import Pressure
from sim_core.geometry.sheets import rectangle
from sim_core.geometry.solids import block

ALWAYS = Schedule(np.empty(0), np.empty(0))
PRESSURE = 3.0e4


def sheet():
    mesh = rectangle(0.04, 0.03, (4, 3), "irregular")
    return mesh.nodes, mesh.triangles


def brick():
    mesh = block([0.02, 0.03, 0.01], (1, 2, 1))
    return mesh.nodes, mesh.surface


def loaded(build, sign=1.0):
    nodes, faces = build()
    term = Pressure("pressure", faces, sign, ALWAYS)
    term.configure({"pressure_pa": PRESSURE})
    system, rng = alone(term, nodes), np.random.default_rng(3)
    start = nodes + 2e-3 * rng.standard_normal(nodes.shape)
    return system, term, start, start + 2e-3 * rng.standard_normal(nodes.shape)


def begun(system, start, end):
    system.begin(start)
    system.x[:] = end
    return -system.exerted()


def pressed(nodes, faces):
    """Forces of the pressure on faces as they are: sums over the middles of 2500 small triangles each."""
    count = 50
    i, j, third = (a.ravel() for a in np.meshgrid(*(np.arange(count),) * 2, [1.0 / 3.0, 2.0 / 3.0], indexing="ij"))
    inside = i + j + np.round(3.0 * third) - 1.0 < count
    xi, eta = (i + third)[inside] / count, (j + third)[inside] / count
    bary, slopes = np.stack([1.0 - xi - eta, xi, eta]), np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
    assert bary.shape == (3, count**2) and bary.min() > 0.0
    out = np.zeros_like(nodes)
    for face in faces:
        shape, by = bary, np.repeat(np.eye(3)[:, :, None], count**2, axis=2)
        if len(face) == 6:
            a, b = np.array([0, 1, 2]), np.array([1, 2, 0])
            shape, by = np.concatenate([bary * (2.0 * bary - 1.0), 4.0 * bary[a] * bary[b]]), np.zeros((6, 3, count**2))
            by[a, a], by[3 + a, a], by[3 + a, b] = 4.0 * bary - 1.0, 4.0 * bary[b], 4.0 * bary[a]
        sides = np.einsum("nbq,sb,nc->sqc", by, slopes, nodes[face])
        np.add.at(out, face, PRESSURE * shape @ np.cross(*sides) * 0.5 / count**2)
    return out


@pytest.mark.parametrize("build", [sheet, brick])
def test_forces_and_stiffness_are_derivatives_of_the_work(build):
    system, _, start, end = loaded(build)
    begun(system, start, end)
    check_derivatives(system, end)


@pytest.mark.parametrize("build", [sheet, brick])
def test_where_the_step_starts_it_is_the_pressure_itself(build):
    system, _, start, _ = loaded(build)
    _, faces = build()
    forces = begun(system, start, start)
    expected = pressed(start, faces)
    np.testing.assert_allclose(forces, expected, atol=2e-3 * np.abs(expected).max())


def test_on_a_closed_surface_it_is_the_pressure_wherever_the_step_started():
    system, _, start, end = loaded(brick)
    moved = begun(system, start, end)
    np.testing.assert_allclose(moved, begun(system, end, end), atol=1e-12 * np.abs(moved).max())


def test_away_from_a_free_rim_it_is_the_pressure_wherever_the_step_started():
    system, _, start, end = loaded(sheet)
    nodes, _ = sheet()
    inner = (np.abs(nodes[:, 0]) < 0.0199) & (np.abs(nodes[:, 1]) < 0.0149)
    moved, there = begun(system, start, end), begun(system, end, end)
    np.testing.assert_allclose(moved[inner], there[inner], atol=1e-12 * np.abs(there).max())
    assert np.abs(moved - there).max() > 1e-3 * np.abs(there).max()  # at the rim it is not


def test_the_work_of_a_closed_surface_is_the_pressure_times_the_volume_swept():
    system, _, start, _ = loaded(brick)
    faces = brick()[1]
    probe = Pressure("probe", faces, 1.0, ALWAYS)
    probe.configure({"pressure_pa": 1.0})
    single = alone(probe, start)
    volume = float(np.vdot(begun(single, start, start), start)) / 3.0  # divergence theorem
    begun(system, start, 1.2 * start)
    assert -system.energy() == pytest.approx(PRESSURE * (1.2**3 - 1.0) * volume, rel=1e-9)


def test_values_between_times_are_linear_and_held_beyond():
    """A load at the end of a step has the value of that time."""
    term = DeadLoad("load", np.array([0]), np.ones(1), Schedule(np.array([1.0, 2.0]), np.array([0.0, 4.0])))
    term.configure({"x": 1.0, "y": 0.0, "z": 0.0})
    system, found = alone(term, np.zeros((1, 3))), []
    for start in (0.0, 1.0, 3.0):
        system.begin(system.x, dt=0.5, t=start)
        found.append(-system.exerted()[0, 0])
    assert found == [0.0, 2.0, 4.0]


def test_a_dead_load_is_the_derivative_of_its_work():
    nodes = np.random.default_rng(1).standard_normal((4, 3))
    term = DeadLoad("load", np.array([1, 3]), np.array([0.25, 0.75]), ALWAYS)
    term.configure({"x": 1.0, "y": -2.0, "z": 0.5})
    system = alone(term, nodes)
    forces = begun(system, nodes, 2.0 * nodes)
    np.testing.assert_allclose(forces[[1, 3]], np.outer([0.25, 0.75], [1.0, -2.0, 0.5]))
    assert system.energy() == pytest.approx(-float(np.vdot(forces, 2.0 * nodes)))
