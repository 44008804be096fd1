"""Free bodies in flight: closed forms of rigid bodies."""

import numpy as np
import pytest
from body_scenes import DENSITY, G, affine, centre, kinetic, momenta, potential, run, simulation, stretch, velocity

from sim_core.scene.assembly import affine_mesh, affine_moments

SIZE = np.array([0.02, 0.03, 0.04])


def spinning(dt, integrator, spin, size=SIZE, gravity=(0.0, 0.0, 0.0), seconds=0.5):
    sim = simulation({"top": affine(size, angular_velocity_deg_s=spin)}, dt, integrator, gravity)
    return sim, round(seconds / dt)


@pytest.mark.parametrize("shape", [0.01, (0.01, 0.03), (0.02, 0.03, 0.04)], ids=["ball", "cylinder", "box"])
def test_mass_centre_and_moments_of_inertia_are_those_of_the_solid(shape):
    """Textbook values, in a turned pose; and the surface encloses the volume from inside."""
    sim = simulation({"b": affine(shape, (0.1, 0.2, 0.3), (20.0, 30.0, 40.0))})
    body = sim.scene.bodies["b"]
    x, m = sim.state.x, sim.scene.system.mass.toarray()
    mass = m.sum()
    if np.ndim(shape) == 0:
        expected, inertia = DENSITY * 4 / 3 * np.pi * shape**3, np.full(3, 2 / 5 * shape**2)
    elif len(shape) == 2:
        r, length = shape
        side = (3 * r**2 + length**2) / 12
        expected, inertia = DENSITY * np.pi * r**2 * length, np.array([side, side, r**2 / 2])
    else:
        a, b, c = np.square(shape)
        expected, inertia = DENSITY * np.prod(shape), np.array([b + c, a + c, a + b]) / 12
    assert mass == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose((m @ x).sum(axis=0) / mass, [0.1, 0.2, 0.3], atol=1e-12)
    local = (x - [0.1, 0.2, 0.3]) @ body.rotation
    second = local.T @ m @ local
    found = np.trace(second) * np.eye(3) - second
    np.testing.assert_allclose(found, expected * np.diag(inertia), atol=1e-9 * found.max())
    mesh = affine_mesh(body.spec, 1)
    p, q, r = (mesh.nodes[mesh.triangles[:, k]] for k in range(3))
    volume = np.einsum("ni,ni->n", np.cross(p, q), r).sum() / 6.0
    assert 0.97 * affine_moments(body.spec)[0] < volume <= affine_moments(body.spec)[0] * (1.0 + 1e-12)


def test_free_fall():
    """Implicit Euler falls by g dt^2 n (n + 1) / 2, and does not turn."""
    dt = 0.01
    sim = simulation({"b": affine(SIZE, rpy=(10.0, 20.0, 30.0), velocity_m_s=[0.1, 0.0, 0.5])}, dt)
    run(sim, 20)
    expected = np.array([0.1, 0.0, 0.5]) * 0.2 - np.array([0.0, 0.0, G]) * dt**2 * 20 * 21 / 2
    np.testing.assert_allclose(centre(sim, "b"), expected, atol=1e-10)
    start = sim.scene.bodies["b"].rotation
    np.testing.assert_allclose(sim.scene.pose_of("b", sim.state.x)[1].as_matrix(), start, atol=1e-9)


def test_momentum_is_kept_and_angular_momentum_to_the_order_of_the_integrator():
    """A box that tumbles about its middle axis. Momentum is kept to the tolerance of the solver."""
    losses = {}
    for integrator in ("implicit_euler", "bdf2"):
        for dt in (0.004, 0.002):
            sim, steps = spinning(dt, integrator, [30.0, 400.0, 20.0])
            before = momenta(sim)
            energy = kinetic(sim)
            energies = run(sim, steps, kinetic)
            if integrator == "implicit_euler":
                assert np.all(np.diff(energies, prepend=energy) < 0.0)
            after = momenta(sim)
            np.testing.assert_allclose(after[0], 0.0, atol=1e-9 * np.linalg.norm(before[1]) / SIZE.max())
            losses[integrator, dt] = np.linalg.norm(after[1] - before[1]) / np.linalg.norm(before[1])
    assert losses["implicit_euler", 0.002] < 0.07
    assert losses["implicit_euler", 0.004] / losses["implicit_euler", 0.002] == pytest.approx(2.0, rel=0.15)
    assert losses["bdf2", 0.002] < 1e-3
    assert losses["bdf2", 0.004] / losses["bdf2", 0.002] > 3.0


def test_a_symmetric_top_precesses():
    """Torque-free: the axis goes round the angular momentum with |L| / I_1; bdf2 of 1 ms, within 0.1 %."""
    dt, size = 0.001, (0.03, 0.03, 0.01)
    sim, _ = spinning(dt, "bdf2", [100.0, 0.0, 500.0], size)
    _, moments = affine_moments(sim.scene.bodies["top"].spec)
    inertia = DENSITY * (moments.sum() - moments)
    momentum = momenta(sim)[1]
    np.testing.assert_allclose(momentum, inertia * np.deg2rad([100.0, 0.0, 500.0]), atol=1e-14)
    rate = np.linalg.norm(momentum) / inertia[0]
    steps = round(2.0 * np.pi / rate / dt)
    along = momentum / np.linalg.norm(momentum)
    axes = run(sim, steps, lambda s: s.scene.pose_of("top", s.state.x)[1].as_matrix()[:, 2])
    across = axes - np.outer(axes @ along, along)
    first, second = np.cross(along, [0.0, 1.0, 0.0]), np.cross(along, np.cross(along, [0.0, 1.0, 0.0]))
    angle = np.unwrap(np.arctan2(across @ second, across @ first))
    time = dt * np.arange(1, steps + 1)
    assert abs(np.polyfit(time, angle, 1)[0]) == pytest.approx(rate, rel=1e-3)
    np.testing.assert_allclose(axes @ along, axes[0] @ along, atol=1e-3)


def test_implicit_euler_takes_energy_out_and_bodies_keep_their_shape():
    """The stretch is that of centrifugal stress, rho w^2 L^2 / 12 at its mean along the longest side, over 8 kappa."""
    sim, steps = spinning(0.005, "implicit_euler", [0.0, 1000.0, 0.0], gravity=(0.0, 0.0, -G))
    energies = run(sim, steps, lambda s: kinetic(s) + potential(s))
    assert np.all(np.diff(energies) < 0.0)
    sim, steps = spinning(0.001, "bdf2", [0.0, 1000.0, 0.0], seconds=0.02)
    run(sim, steps)
    expected = DENSITY * np.deg2rad(1000.0) ** 2 * SIZE[2] ** 2 / 12.0 / 8e9
    assert stretch(sim) == pytest.approx(expected, rel=0.05)


def test_velocity_at_the_start_is_that_of_the_rig():
    spin = np.array([90.0, 0.0, 180.0])
    start = {"velocity_m_s": [0.1, 0.2, 0.3], "angular_velocity_deg_s": list(spin)}
    sim = simulation({"b": affine(SIZE, (0.1, 0.0, 0.0), **start)})
    np.testing.assert_allclose(velocity(sim, "b"), [0.1, 0.2, 0.3], atol=1e-15)
    nodes = sim.scene.bodies["b"].nodes
    arms = sim.state.x[nodes] - [0.1, 0.0, 0.0]
    np.testing.assert_allclose(sim.state.v[nodes], [0.1, 0.2, 0.3] + np.cross(np.deg2rad(spin), arms), atol=1e-12)
