import numpy as np
import pytest
import scipy.sparse as sp
from potentials import Look
from scipy.spatial.transform import Rotation
from sheet_systems import DENSITY, FILM, both_ends, film, left, nothing

from sim_core.energies.membrane import Membrane
from sim_core.errors import ConfigError
from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.solve.step import State, advance, deflections, exerted
from sim_core.solve.system import System
from sim_core.solve.unknowns import Compliant
from sim_core.stepping import Simulation


def rough(system, amplitude=2e-4, seed=0):
    free = ~system.prescribed
    return system.nodes + amplitude * np.random.default_rng(seed).standard_normal(system.nodes.shape) * free


@pytest.mark.parametrize("inertia", [True, False])
def test_every_entry_of_the_hessian_is_where_it_belongs(inertia):
    system, _ = film(left, inertia=inertia, cells=(5, 2))
    look = Look(system)
    look.begin(system.nodes, dt=0.01)
    assert_derivatives(look, rough(system))


def assert_derivatives(look, x):
    """The whole Hessian, column by column, from residuals."""
    columns, h = [], 1e-8
    for shift in h * np.eye(look.system.n_unknowns):
        ends = []
        for sign in (1.0, -1.0):
            look.x[:] = x
            look.move(sign * shift)
            ends.append(look.residual())
        columns.append((ends[0] - ends[1]) / (2.0 * h))
    look.x[:], expected = x, np.array(columns).T
    np.testing.assert_allclose(look.hessian(exact=True), expected, atol=1e-6 * np.abs(expected).max())


def compliant_film():
    _, mesh = film(both_ends, cells=(5, 2))
    right = np.flatnonzero(mesh.nodes[:, 0] > 0.031)
    group = Compliant(right, np.array([1e-4, 2e-4, 5e-4]))
    return film(both_ends, cells=(5, 2), compliant=[group])[0], right


def test_hessian_with_nodes_that_give_way_together():
    system, right = compliant_film()
    look = Look(system)
    look.begin(system.nodes, dt=0.01)
    look.targets, x = system.nodes, rough(system)
    x[right] += [1e-4, -2e-4, 3e-4]
    assert_derivatives(look, x)


def test_a_spring_gives_way_by_force_times_compliance():
    system, right = compliant_film()
    system.inertia = False
    system.gravity = np.zeros(3)
    system.loads[right] = np.array([0.0, 0.0, 0.1]) / len(right)
    state = State(0.0, system.nodes, np.zeros_like(system.nodes), system.initial_internals())
    advance(system, state, system.nodes, 1.0)
    pull = -exerted(system)[right].sum(axis=0) + system.loads[right].sum(axis=0)
    given = deflections(system)[0]
    np.testing.assert_allclose(given, pull * [1e-4, 2e-4, 5e-4], rtol=1e-6, atol=1e-12)
    assert given[2] > 1e-7


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
    Look(system).energy()
    assert np.array_equal(pressed(rig), first)


@pytest.mark.parametrize("turn", list(Rotation.random(2, random_state=12)), ids=["one way", "another way"])
def test_turning_the_whole_scene_turns_its_motion(turn):
    """Elasticity, contact and friction know no preferred direction."""
    upright, turned = pressed(pressed_rig()), pressed(pressed_rig(turn))
    expected = turn.apply(upright.reshape(-1, 3)).reshape(upright.shape)
    np.testing.assert_allclose(turned, expected, atol=1e-9)


def soft(system):
    system.terms[0].configure({**FILM, "E_pa": 1e8})


def graded(system):
    system.terms[0].scale(np.linspace(0.5, 1.0, len(system.terms[0].triangles)))


def bent(system):
    system.terms[1].set_rest_angles(np.full_like(system.terms[1].rest_angles, 0.05))


def yielding(system):
    system.terms[1].configure({**FILM, "yield_curvature_per_m": 0.1, "hardening_ratio": 0.1})


def tired(system):
    """As far as it has yielded there."""
    count = len(system.terms[1].stiffness)
    system.terms[1].scale_flow(np.full(count, 0.2), np.full(count, 0.5))


def heavy(system):
    system.mass = 2.0 * system.mass


@pytest.mark.parametrize("change", [soft, graded, bent, heavy, tired])
def test_numbers_that_are_changed_count_from_the_next_step_on(change):
    """To the bit as in a system that had them from the start; between such steps they are kept."""
    changed, anew, plain = (film(left, cells=(5, 2))[0] for _ in range(3))
    for system in (changed, anew, plain) if change is tired else ():
        yielding(system)
    begin = State(0.0, changed.nodes, np.zeros_like(changed.nodes), changed.initial_internals())
    state, _ = advance(changed, begin, changed.nodes, 0.01)
    change(changed)
    change(anew)
    there, other, unchanged = (advance(system, state, system.nodes, 0.01)[0] for system in (changed, anew, plain))
    assert np.array_equal(there.x, other.x)
    assert np.abs(there.x - unchanged.x).max() > 1e-8
    on_core = changed.on_core._handle
    advance(changed, there, changed.nodes, 0.01)
    assert changed.on_core._handle == on_core


def test_a_term_that_the_core_has_no_elements_for_is_refused():
    class Own(Membrane):
        pass

    mesh = film(left)[1]
    term = Own("own", mesh.nodes, mesh.triangles, np.array([1.0, 0.0, 0.0]))
    term.configure(FILM)
    none = sp.csr_matrix((len(mesh.nodes),) * 2)
    system = System(mesh.nodes, none, np.ones(mesh.nodes.shape, dtype=bool), [term], np.zeros(3))
    with pytest.raises(ConfigError, match=r"no elements for own \(Own\)"):
        Look(system).energy()


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
    reaction = exerted(system)[held].sum(axis=0)
    free_weight = 9.81 * system.mass.diagonal()[~held].sum()
    np.testing.assert_allclose(-reaction, [0.0, 0.0, -free_weight], atol=1e-6 * free_weight)
