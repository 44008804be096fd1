"""Damping by mass and by the rate of strain: closed forms, what rigid motion must not feel, derivatives."""

import numpy as np
import pytest
from potentials import Look, check_derivatives
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.rigs import list_parameters, with_parameters
from sim_core.scene import build_scene
from sim_core.solve.integrator import Past
from sysid.validation.damping import damped as damped_specimen
from sysid.validation.damping import decrement, expected, flown, gel_bar, sheet, spun, vibrations
from sysid.validation.small_motions import natural_vibrations

SPECIMENS = ("cantilever, first bending mode", "strip, first axial mode", "bar of gel, first axial mode")
TURNS = [Rotation.from_rotvec(v) for v in ([0.2, -0.7, 0.4], [0.5, -0.1, 1.4])]


def specimens(beta, alpha=0.0):
    found = {"sheet": sheet((4, 2), "free", alpha, beta), "gel": gel_bar(2, alpha, beta, free=True)}
    return {kind: Look(system) for kind, system in found.items()}


def crumpled(look, seed, size=1e-3):
    nodes = look.system.nodes
    return nodes + size * np.random.default_rng(seed).standard_normal(nodes.shape)


def begin(look, start, before, looking_back):
    look.begin(start, dt=0.01, past=Past(before, np.zeros_like(before), 0.007) if looking_back else None)


@pytest.mark.parametrize("kind", [(1.0, 0.0), (0.0, 1.0)], ids=["mass", "stiffness"])
@pytest.mark.parametrize("name", SPECIMENS)
def test_a_vibration_fades_as_rayleigh_damping_says(name, kind):
    """The decrement of zeta = alpha / 2 w + beta w / 2 within 2 %, at a ratio of 0.03."""
    undamped, omega = vibrations()[name]
    alpha, beta = 0.06 * omega * kind[0], 0.06 / omega * kind[1]
    found = decrement(damped_specimen(name, alpha, beta), natural_vibrations(undamped, 1)[1][0], omega)
    assert found == pytest.approx(expected(omega, alpha, beta), rel=0.02)


@pytest.mark.parametrize("looking_back", [False, True], ids=["euler", "bdf2"])
@pytest.mark.parametrize("kind", ["sheet", "gel"])
def test_a_deformed_body_that_turns_rigidly_is_not_damped(kind, looking_back):
    """By any angle in a step: forces are those without damping, turned."""
    damped, plain = specimens(0.1)[kind], specimens(0.0)[kind]
    x = crumpled(damped, 1)
    start, end = (turn.apply(x) + [0.1, 0.0, 0.2] for turn in TURNS)
    begin(damped, start, x, looking_back)
    damped.x[:], plain.x[:] = end, end
    force = plain.exerted()
    np.testing.assert_allclose(damped.exerted(), force, atol=1e-9 * np.abs(force).max())


@pytest.mark.parametrize("kind", ["sheet", "gel"])
def test_the_rate_of_strain_exerts_neither_force_nor_moment_on_the_whole(kind):
    damped, plain = specimens(0.1)[kind], specimens(0.0)[kind]
    start, end = crumpled(damped, 1), TURNS[0].apply(crumpled(damped, 2))
    begin(damped, start, start, True)
    damped.x[:], plain.x[:] = end, end
    force = damped.exerted() - plain.exerted()
    moments = np.cross(end, force)
    assert np.abs(force.sum(axis=0)).max() < 1e-10 * np.abs(force).sum()
    assert np.abs(moments.sum(axis=0)).max() < 1e-10 * np.abs(moments).sum()
    assert np.abs(force).max() > 0.1 * np.abs(plain.exerted()).max()


@pytest.mark.parametrize("looking_back", [False, True], ids=["euler", "bdf2"])
@pytest.mark.parametrize("kind", ["sheet", "gel"])
def test_derivatives_match_differences(kind, looking_back):
    system = specimens(0.02, 3.0)[kind]
    system.system.inertia = False
    begin(system, crumpled(system, 1), crumpled(system, 3), looking_back)
    check_derivatives(system, crumpled(system, 2), tolerance=5e-6)
    values = np.linalg.eigvalsh(system.hessian())
    assert values[0] > -1e-9 * values[-1]


def test_a_free_strip_keeps_its_angular_momentum():
    start, plain = spun(0.0, 0.5)
    assert spun(0.05, 0.5)[1] == pytest.approx(plain, rel=1e-6)
    assert plain == pytest.approx(start, rel=0.05)


def test_momentum_in_free_flight_fades_exponentially():
    assert flown(3.0) == pytest.approx(np.exp(-1.0), rel=1e-3)


def test_what_a_mount_holds_feels_no_drag(small_rig):
    rig = with_parameters(small_rig(), {"gel.mass_damping_per_s": 100.0})
    scene = build_scene(rig)
    look, found = Look(scene.system), []
    for dt in (0.01, 1e12):  # of all that acts, drag alone depends on the time that the move takes
        look.begin(scene.rest, dt=dt)
        look.x[:] = scene.rest + [0.0, 0.0, 1e-3]
        scene.system.inertia = False
        found.append(look.exerted())
    force = found[0] - found[1]
    held = scene.holders["gel.bond"]
    assert not force[held].any()
    loose = np.setdiff1d(scene.bodies["gel"].nodes, held)
    drag = 100.0 * 0.1 * np.asarray(scene.system.mass.sum(axis=1)).ravel()
    assert 0.5 * drag[loose].sum() < force[loose, 2].sum() < drag[loose].sum()
    assert np.abs(force[:, :2]).max() < 1e-12 * force[:, 2].sum()


def test_both_are_parameters_of_sheets_and_gels(small_rig):
    rig = small_rig()
    known = {p.name: p for p in list_parameters(rig)}
    for body in ("card", "gel"):
        for name, unit in (("mass_damping_per_s", "1/s"), ("stiffness_damping_s", "s")):
            assert known[f"{body}.{name}"].value == 0.0 and known[f"{body}.{name}"].unit == unit
    changed = with_parameters(rig, {"sheet.stiffness_damping": 1e-3})
    assert changed.bodies["card"].material.stiffness_damping_s == 1e-3
    with pytest.raises(ConfigError, match="stiffness_damping_s"):
        with_parameters(rig, {"gel.stiffness_damping_s": -1e-3})
