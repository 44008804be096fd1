"""Hinges, sliders and ball joints: closed forms, and that they hold exactly."""

import numpy as np
import pytest
from body_scenes import (
    DENSITY,
    G,
    affine,
    centre,
    kinetic,
    momenta,
    potential,
    rig_of,
    run,
    simulation,
    stretch,
    velocity,
)
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

from sim_core.errors import ConfigError
from sim_core.scene import build_scene
from sim_core.solve.step import NewtonSettings, advance
from sysid.validation.small_motions import natural_vibrations

L, W = 0.1, 0.02


def hinge(body, at, axis=(0.0, 1.0, 0.0), to="world"):
    return {"type": "hinge", "body": body, "to": to, "at_m": list(at), "axis": list(axis)}


def pendulum(amplitude, dt, integrator="bdf2"):
    at = 0.5 * L * np.array([np.sin(amplitude), 0.0, -np.cos(amplitude)])
    rod = affine((L, W, W), at, (0.0, 90.0 - np.rad2deg(amplitude), 0.0))
    return simulation({"rod": rod}, dt, integrator, joints=[hinge("rod", (-0.5 * L, 0.0, 0.0))])


@pytest.mark.parametrize("degrees", [5.0, 60.0, 120.0])
def test_period_of_a_compound_pendulum(degrees):
    """T = 4 sqrt(I / m g d) K(sin(amplitude / 2)), at any amplitude; bdf2 of 1 ms, within 0.1 %."""
    amplitude, dt = np.deg2rad(degrees), 0.001
    inertia = (L**2 + W**2) / 12.0 + L**2 / 4.0
    period = 4.0 * np.sqrt(inertia / (G * 0.5 * L)) * ellipk(np.sin(0.5 * amplitude) ** 2)
    sim = pendulum(amplitude, dt)
    places = run(sim, int(1.8 * period / dt), lambda s: centre(s, "rod"))
    angle = np.arctan2(places[:, 0], -places[:, 2])
    np.testing.assert_allclose(places[:, 1], 0.0, atol=1e-12)
    down = np.flatnonzero((angle[:-1] > 0.0) & (angle[1:] <= 0.0))
    times = dt * (down + 1 + angle[down] / (angle[down] - angle[down + 1]))
    assert np.diff(times)[0] == pytest.approx(period, rel=1e-3)
    assert stretch(sim) < 1e-6


def test_the_pivot_stays_where_it_is_and_bears_weight_and_centrifugal_force():
    """Let go at 90 degrees: at the lowest point the pivot bears m g + m w^2 d, w^2 = 2 g d / (I / m)."""
    dt = 0.0005
    sim = pendulum(np.pi / 2.0, dt)
    body = sim.scene.bodies["rod"]
    anchors = sim.scene.holders["joints[0]"]
    local = np.array([-0.5 * L, 0.3 * W, 0.0])
    loads = []
    for _ in range(400):
        sim.step({}, dt)
        origin, rotation = sim.scene.pose_of("rod", sim.state.x)
        np.testing.assert_allclose(origin + rotation.apply(local), [0.0, 0.3 * W, 0.0], atol=1e-8)
        loads.append(sim.reactions()[anchors].sum(axis=0))
        if sim.state.x[body.control].mean(axis=0)[0] < 0.0:
            break
    mass = DENSITY * L * W * W
    inertia = (L**2 + W**2) / 12.0 + L**2 / 4.0
    expected = -mass * (G + 2.0 * G * (0.5 * L) ** 2 / inertia)
    assert loads[-1][2] == pytest.approx(expected, rel=5e-3)


def double(dt):
    bodies = {"a": affine((0.01, 0.01, L), (0.0, 0.0, 0.5 * L)), "b": affine((0.01, 0.01, L), (0.0, 0.0, 1.5 * L))}
    foot = (0.0, 0.0, -0.5 * L)
    return simulation(bodies, dt, "bdf2", (G, 0.0, 0.0), joints=[hinge("a", foot), hinge("b", foot, to="a")])


def test_energy_of_a_double_pendulum():
    """Let go level: bdf2 loses little, less by far with half the step; the hinge between the rods holds exactly."""
    drift = {}
    for dt in (0.002, 0.001):
        sim = double(dt)
        start = potential(sim)
        energies = run(sim, round(0.4 / dt), lambda s: (kinetic(s) + potential(s), kinetic(s)))
        drift[dt] = np.abs(energies[:, 0] - start).max() / energies[:, 1].max()
        assert sim.scene.system.n_unknowns == 24 - 6 - 6
        (o, r), (p, q) = (sim.scene.pose_of(name, sim.state.x) for name in ("a", "b"))
        ends = o + r.apply([0.0, 0.004, 0.5 * L]), p + q.apply([0.0, 0.004, -0.5 * L])
        np.testing.assert_allclose(ends[0], ends[1], atol=1e-8)
    assert drift[0.001] < 2e-3
    assert drift[0.002] / drift[0.001] > 3.0


def test_frequencies_of_small_swings_of_a_double_pendulum():
    """Two equal thin rods, textbook, their thickness 1e-4 of it: w^2 = (3 +- 6 / sqrt(7)) g / L."""
    thin = (2e-3, 2e-3, L)
    bodies = {"a": affine(thin, (0.0, 0.0, -0.5 * L)), "b": affine(thin, (0.0, 0.0, -1.5 * L))}
    top = (0.0, 0.0, 0.5 * L)
    joints = [hinge("a", top), hinge("b", top, to="a")]
    sim = simulation(bodies, joints=joints)
    scene = sim.scene
    scene.system.inertia = False  # the weight pulls at the rods
    hung, _ = advance(scene.system, sim.state, scene.targets(scene.start), 1.0, NewtonSettings(1e-12, 1e-11))
    frequencies, _ = natural_vibrations(scene.system, 2, hung.x)
    expected = np.sqrt((3.0 + np.array([-6.0, 6.0]) / np.sqrt(7.0)) * G / L)
    np.testing.assert_allclose(frequencies, expected, rtol=3e-4)


@pytest.mark.parametrize("heading", [0.0, 50.0])
def test_a_bead_on_an_incline(heading):
    """Slider to the world: g sin(slope) along the axis, nothing across, no turning."""
    slope = 30.0
    bead = affine((W, W, W), rpy=(0.0, slope, heading))
    sim = simulation({"bead": bead}, joints=[{"type": "slider", "body": "bead", "axis": [1.0, 0.0, 0.0]}])
    axis = Rotation.from_euler("xyz", [0.0, slope, heading], degrees=True).apply([1.0, 0.0, 0.0])
    run(sim, 100)
    along = velocity(sim, "bead") @ axis
    assert along / 0.5 == pytest.approx(G * np.sin(np.deg2rad(slope)), rel=1e-6)
    across = centre(sim, "bead") - (centre(sim, "bead") @ axis) * axis
    assert np.abs(across).max() < 1e-8
    np.testing.assert_allclose(
        sim.scene.pose_of("bead", sim.state.x)[1].as_matrix(), sim.scene.bodies["bead"].rotation, atol=1e-8
    )


def test_a_slider_between_two_bodies_that_fly():
    """A bead is flung out along a rod that spins: angular momentum and energy are kept, and r'' = w^2 r shows in
    r' at the end, by energy and angular momentum of the pair."""
    spin = 360.0
    w = np.deg2rad(spin)
    bodies = {
        "rod": affine((6.0 * W, W, W), angular_velocity_deg_s=[0.0, spin, 0.0]),
        "bead": affine((W, W, W), (2 * W, 0.0, 0.0), angular_velocity_deg_s=[0.0, spin, 0.0]),
    }
    bodies["bead"]["velocity_m_s"] = [0.0, 0.0, -w * 2 * W]
    joint = {"type": "slider", "body": "bead", "to": "rod", "axis": [1.0, 0.0, 0.0]}
    sim = simulation(bodies, 0.001, "bdf2", (0.0, 0.0, 0.0), joints=[joint])
    before, energy = momenta(sim), kinetic(sim)
    run(sim, 300)
    after = momenta(sim)
    np.testing.assert_allclose(after[0], before[0], atol=1e-6 * np.abs(before[0]).max())
    np.testing.assert_allclose(after[1], before[1], atol=2e-4 * np.abs(before[1]).max())
    assert kinetic(sim) == pytest.approx(energy, rel=1e-4)
    (o, r), (p, q) = sim.scene.pose_of("rod", sim.state.x), sim.scene.pose_of("bead", sim.state.x)
    apart = r.inv().apply(p - o)
    assert apart[0] > 2.5 * W and np.abs(apart[1:]).max() < 1e-8
    assert (r.inv() * q).magnitude() < 1e-8


def test_a_ball_joint_leaves_all_turns_and_no_motion_of_the_point():
    bodies = {"a": affine((L, W, W), (0.5 * L, 0.0, 0.0)), "b": affine((L, W, W), (1.5 * L, 0.0, 0.0))}
    end = [-0.5 * L, 0.0, 0.0]
    joints = [{"type": "ball", "body": "a", "at_m": end}, {"type": "ball", "body": "b", "to": "a", "at_m": end}]
    bodies["b"]["angular_velocity_deg_s"] = [200.0, 0.0, 0.0]  # about the line through both points
    sim = simulation(bodies, 0.002, "bdf2", joints=joints)
    run(sim, 60)
    for name, local, expected in (("a", end, np.zeros(3)), ("b", end, None)):
        o, r = sim.scene.pose_of(name, sim.state.x)
        if expected is None:
            p, q = sim.scene.pose_of("a", sim.state.x)
            expected = p + q.apply([0.5 * L, 0.0, 0.0])
        np.testing.assert_allclose(o + r.apply(local), expected, atol=1e-8)
    assert sim.scene.system.n_unknowns == 24 - 6


def test_a_closed_chain_of_hinges_moves():
    """A parallelogram: the fourth hinge says partly again what the others say, and the coupler does not turn."""
    bodies = {
        "left": affine((W, W, L), (0.0, 0.0, 0.5 * L)),
        "right": affine((W, W, L), (L, 0.0, 0.5 * L)),
        "coupler": affine((L, W, W), (0.5 * L, 0.0, L)),
    }
    foot = (0.0, 0.0, -0.5 * L)
    joints = [hinge("left", foot), hinge("right", foot)]
    joints += [hinge("coupler", (s * 0.5 * L, 0.0, 0.0), to=n) for s, n in ((-1.0, "left"), (1.0, "right"))]
    sim = simulation(bodies, 0.002, "bdf2", (1.0, 0.0, -G), joints=joints)
    run(sim, 60)
    assert centre(sim, "coupler")[0] > 0.55 * L
    assert sim.scene.pose_of("coupler", sim.state.x)[1].magnitude() < 1e-6
    assert stretch(sim) < 1e-6


def test_a_hinge_on_a_moving_mount_follows_it():
    bodies = {"rod": affine((W, W, L), (0.0, 0.0, -0.5 * L))}
    sim = simulation(
        bodies, joints=[hinge("rod", (0.0, 0.0, 0.5 * L), to="arm")], end_effectors={"arm": {}},
        sensors={"load": {"type": "wrench", "on": "arm", "rate_hz": 100.0, "topic": "load"}},
    )  # fmt: skip
    place, turn = np.array([0.01, 0.0, 0.02]), Rotation.from_euler("z", 30.0, degrees=True)
    for k in range(1, 301):
        share = min(k / 40.0, 1.0)
        sim.step({"arm": (share * place, Rotation.from_rotvec(share * turn.as_rotvec()))}, 0.005)
    o, r = sim.scene.pose_of("rod", sim.state.x)
    np.testing.assert_allclose(o + r.apply([0.0, 0.0, 0.5 * L]), place, atol=1e-8)
    assert sim.read()["load"][2] == pytest.approx(-DENSITY * W * W * L * G, rel=0.05)
    sim.reset({"arm": (place, turn)})
    np.testing.assert_allclose(centre(sim, "rod"), place - [0.0, 0.0, 0.5 * L], atol=1e-12)


FAULTS = {
    "no axis": ({"type": "hinge", "body": "a"}, "no axis"),
    "axis of a ball": ({"type": "ball", "body": "a", "axis": [0.0, 0.0, 1.0]}, "has an axis"),
    "no direction": ({"type": "hinge", "body": "a", "axis": [0.0, 0.0, 0.0]}, "direction"),
    "to itself": ({"type": "ball", "body": "a", "to": "a"}, "with itself"),
    "unknown": ({"type": "ball", "body": "a", "to": "armm"}, "no such affine body or end effector"),
    "a rigid body": ({"type": "ball", "body": "table"}, "no such affine body"),
}


@pytest.mark.parametrize("joint, words", FAULTS.values(), ids=FAULTS)
def test_a_faulty_joint_is_refused(joint, words):
    bodies = {"a": affine((W, W, L)), "table": {"type": "rigid", "shape": {"type": "plane"}}}
    with pytest.raises(ConfigError, match=words):
        rig_of(bodies, joints=[joint], end_effectors={"arm": {}})


def test_mounts_that_joints_lock_to_each_other_are_refused():
    joint = {"type": "slider", "body": "a", "axis": [1.0, 0.0, 0.0]}
    rig = rig_of({"a": affine((W, W, L))}, joints=[{**joint, "to": "arm"}, joint], end_effectors={"arm": {}})
    with pytest.raises(ConfigError, match="cannot move against each other"):
        build_scene(rig)


def test_velocities_that_a_joint_does_not_allow_are_refused():
    body = affine((W, W, L), velocity_m_s=[1.0, 0.0, 0.0])
    with pytest.raises(ConfigError, match="do not agree with their joints"):
        simulation({"a": body}, joints=[{"type": "ball", "body": "a"}])
