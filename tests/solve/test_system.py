import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.transform import Rotation
from sheet_systems import DENSITY, FILM, both_ends, film, left, nothing

import sim_core.solve.sparsity as pattern_module
from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sim_core.solve.factor import factorise
from sim_core.solve.integrator import step_context
from sim_core.solve.step import State, advance
from sim_core.solve.unknowns import Compliant


def rough(system, amplitude=2e-4, seed=0):
    free = ~system.prescribed
    return system.nodes + amplitude * np.random.default_rng(seed).standard_normal(system.nodes.shape) * free


def begin(system, x, dt=0.01):
    system.set_targets(x)
    system.x[:] = x
    system.begin_step(step_context(system.nodes, np.zeros_like(x), dt), system.initial_internals())
    system.set_targets(x)


def dense(upper):
    matrix = upper.toarray()
    return matrix + np.triu(matrix, 1).T


def by_differences(system, h=1e-8):
    """The whole Hessian, column by column, from residuals."""
    unknowns = system.unknowns()
    columns = []
    for k in range(unknowns.size):
        shift = h * np.eye(1, unknowns.size, k)[0]
        system.set_unknowns(unknowns + shift)
        plus = system.residual().copy()
        system.set_unknowns(unknowns - shift)
        columns.append((plus - system.residual()) / (2.0 * h))
    system.set_unknowns(unknowns)
    return np.array(columns).T


@pytest.mark.parametrize("inertia", [True, False])
def test_every_entry_of_the_hessian_is_where_it_belongs(inertia):
    system, _ = film(left, inertia=inertia, cells=(5, 2))
    begin(system, rough(system))
    found, expected = dense(system.hessian(exact=True)), by_differences(system)
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def compliant_film():
    _, mesh = film(both_ends, cells=(5, 2))
    right = np.flatnonzero(mesh.nodes[:, 0] > 0.031)
    group = Compliant(right, np.array([1e-4, 2e-4, 5e-4]))
    return film(both_ends, cells=(5, 2), compliant=[group])[0], right


def test_hessian_with_nodes_that_give_way_together():
    system, right = compliant_film()
    begin(system, rough(system))
    values = system.unknowns()
    values[-3:] = [1e-4, -2e-4, 3e-4]
    system.set_unknowns(values)
    np.testing.assert_allclose(system.x[right] - system.nodes[right], np.tile(values[-3:], (len(right), 1)))
    found, expected = dense(system.hessian(exact=True)), by_differences(system)
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_a_spring_gives_way_by_force_times_compliance():
    system, right = compliant_film()
    system.inertia = False
    system.gravity = np.zeros(3)
    system.loads[right] = np.array([0.0, 0.0, 0.1]) / len(right)
    state = State(0.0, system.nodes, np.zeros_like(system.nodes), system.initial_internals())
    advance(system, state, system.nodes, 1.0)
    pull = -system.static_gradient()[right].sum(axis=0) + system.loads[right].sum(axis=0)
    np.testing.assert_allclose(system.deflections[0], pull * [1e-4, 2e-4, 5e-4], rtol=1e-6, atol=1e-12)
    assert system.deflections[0, 2] > 1e-7


def test_force_on_the_unknowns_from_moving_what_is_prescribed():
    system, _ = film(left)
    x = rough(system)
    begin(system, x)
    system.hessian(exact=True)
    move = np.where(system.prescribed, 1e-7 * np.random.default_rng(1).standard_normal(x.shape), 0.0)
    predicted = system.follow(move)
    system.set_targets(x + move)
    after = system.residual().copy()
    system.set_targets(x - move)
    change = 0.5 * (after - system.residual())
    np.testing.assert_allclose(predicted, change, atol=1e-5 * np.abs(change).max())


def test_factor_solves_and_is_refused_where_the_matrix_is_not_definite():
    system, _ = film(left)
    begin(system, system.nodes)
    upper = system.hessian()
    rhs = np.random.default_rng(2).standard_normal((system.n_unknowns, 2))
    solution = system.factor(upper, definite=True).solve(rhs)
    np.testing.assert_allclose(dense(upper) @ solution, rhs, atol=1e-9)
    one = factorise(upper, definite=True).solve(rhs[:, 0])
    np.testing.assert_allclose(one, solution[:, 0], rtol=1e-9, atol=1e-15)


def test_storage_grows_when_contact_needs_more_than_was_spared(monkeypatch):
    """With hardly any place spared, the results of a press are the same to round-off."""
    rig = pressed_rig()
    reference = pressed(rig)
    monkeypatch.setattr(pattern_module, "SPARE_PAIRS", 4)
    np.testing.assert_allclose(pressed(rig), reference, atol=1e-12)


def pressed_rig(turn=None):
    """A gel finger over a card; ``turn``: of the whole scene, gravity included."""
    turn = Rotation.identity() if turn is None else turn
    rpy = [float(a) for a in turn.as_euler("xyz", degrees=True)]
    down = [float(c) for c in turn.apply([0.0, 0.0, -9.81])]
    above = [float(c) for c in turn.apply([0.01, 0.0, 0.0045])]
    return parse_rig(
        {
            "name": "press",
            "gravity_m_s2": down,
            "solver": {"dt_s": 0.01},
            "bodies": {
                "card": {
                    "pose": {"rpy_deg": rpy},
                    "type": "sheet",
                    "shape": {"type": "rectangle", "length_m": 0.05, "width_m": 0.02, "cells": [8, 3]},
                    "material": {"preset": "card_200gsm"},
                },
                "gel": {
                    "type": "gel",
                    "shape": {"type": "block", "size_m": [0.01, 0.01, 0.004], "cells": [2, 2, 1]},
                    "pose": {"position_m": [0.0, 0.0, -0.002], "rpy_deg": [180.0, 0.0, 0.0]},
                    "material": {"E_pa": 2e5, "nu": 0.45, "density_kg_m3": 1000.0},
                    "bonded": "bottom",
                    "mount": "finger",
                },
            },
            "clamps": [{"name": "vice", "body": "card", "region": {"x_m": [-0.025, -0.02]}, "mount": "world"}],
            "end_effectors": {"finger": {"start": {"position_m": above, "rpy_deg": rpy}}},
            "contacts": [{"between": ["gel", "card"], "friction": 0.3}],
        },
        "test",
    )


def pressed(rig, steps=10):
    """Positions while a gel is pressed on a card and drawn along it."""
    scene = build_scene(rig)
    simulation = Simulation(scene)
    origin, rotation = scene.start["finger"]
    path, contacts = [], 0
    for k in range(1, steps + 1):
        shift = rotation.apply([2e-4 * max(0, k - 6), 0.0, -4e-4 * min(k, 6)])
        contacts += simulation.step({"finger": (origin + shift, rotation)}, 0.01).contacts
        path.append(simulation.state.x)
    assert contacts > 0
    return np.array(path)


def test_two_runs_are_equal_bit_for_bit():
    """Also the second of two runs in one process, with another rig between them."""
    rig = pressed_rig()
    first = pressed(rig)
    system, _ = film(left)
    begin(system, system.nodes)
    assert np.array_equal(pressed(rig), first)


@pytest.mark.parametrize("turn", list(Rotation.random(2, random_state=12)), ids=["one way", "another way"])
def test_turning_the_whole_scene_turns_its_motion(turn):
    """Elasticity, contact and friction know no preferred direction."""
    upright, turned = pressed(pressed_rig()), pressed(pressed_rig(turn))
    expected = turn.apply(upright.reshape(-1, 3)).reshape(upright.shape)
    np.testing.assert_allclose(turned, expected, atol=1e-9)


def test_mass_of_another_pattern_is_refused():
    system, mesh = film(left)
    with pytest.raises(ValueError, match="pattern"):
        system.set_mass(sp.csr_matrix(np.ones((len(mesh.nodes),) * 2)))


def test_free_flight_keeps_momentum_and_falls_as_it_should():
    system, mesh = film(nothing)
    rng = np.random.default_rng(3)
    v = 0.2 * rng.standard_normal(mesh.nodes.shape)
    mass = system.mass.diagonal()
    state = State(0.0, mesh.nodes, v, system.initial_internals())
    momentum = mass @ v
    for k in range(1, 6):
        state, _ = advance(system, state, mesh.nodes, 0.005)
        expected = momentum + mass.sum() * np.array([0.0, 0.0, -9.81]) * 0.005 * k
        np.testing.assert_allclose(mass @ state.v, expected, atol=1e-9 * np.abs(momentum).sum())
    assert mass.sum() == pytest.approx(DENSITY * FILM["thickness_m"] * 0.08 * 0.02)


def test_spin_decays_only_with_the_order_of_the_integrator():
    """Implicit Euler loses angular momentum in proportion to the step."""
    system, mesh = film(nothing, gravity=(0.0, 0.0, 0.0))
    mass = system.mass.diagonal()
    v = np.cross([0.0, 0.0, 20.0], mesh.nodes)

    def lost(dt):
        state = State(0.0, mesh.nodes, v, system.initial_internals())
        for _ in range(round(0.02 / dt)):
            state, _ = advance(system, state, mesh.nodes, dt)
        spin = np.einsum("n,nj->j", mass, np.cross(state.x, state.v))[2]
        return 1.0 - spin / np.einsum("n,nj->j", mass, np.cross(mesh.nodes, v))[2]

    coarse, fine = lost(2e-3), lost(1e-3)
    assert 0.0 < fine < coarse < 0.5
    assert coarse / fine == pytest.approx(2.0, rel=0.15)


def test_the_clamp_carries_the_weight():
    system, mesh = film(left, inertia=False)
    state = State(0.0, mesh.nodes, np.zeros_like(mesh.nodes), system.initial_internals())
    advance(system, state, mesh.nodes, 1.0)
    held = left(mesh.nodes)
    reaction = system.static_gradient()[held].sum(axis=0)
    free_weight = 9.81 * system.mass.diagonal()[~held].sum()
    np.testing.assert_allclose(-reaction, [0.0, 0.0, -free_weight], atol=1e-6 * free_weight)
