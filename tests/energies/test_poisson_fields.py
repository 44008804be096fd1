"""Poisson's ratio that differs from element to element: closed forms, and energies that are true energies."""

import numpy as np
import pytest
from potentials import check_derivatives
from scipy.optimize import brentq
from shell_terms import ORTHOTROPIC, PAPER, bending, membrane, strip
from test_neo_hookean import Body, difference, dofs, irregular_block, lame, loaded, others

from sim_core.energies.neo_hookean_moduli import BULK, MU, OWN, moduli, moduli_by_nu
from sim_core.errors import ConfigError
from sim_core.geometry import solids
from sim_core.materials.elastic import plane_stress, plane_stress_by_nu

RNG = np.random.default_rng


def mixed(count, seed=5):
    """Differences from 0.3 that leave -0.3 to 0.45."""
    return RNG(seed).uniform(-0.6, 0.15, count)


# ------------------------------------------------------------------------------------- closed forms


@pytest.mark.parametrize("stretch", [0.8, 0.95, 1.1])
def test_two_layers_of_gel_between_walls(stretch):
    """With lateral strain kept from it a layer of F = diag(1, 1, s) has the stress (lambda + 2 mu) (s - 1), at any s:
    a soft layer of nu = 0.1 on one of nu = 0.45 takes most of the way."""
    mesh = solids.block((0.01, 0.01, 0.01), (2, 2, 2))
    body, sets, rest = Body(mesh, {"E_pa": 1e5, "nu": 0.3}), mesh.node_sets, mesh.nodes
    upper = rest[mesh.tets[:, :4], 2].mean(axis=1) > 0.5 * (rest[:, 2].min() + rest[:, 2].max())
    body.term.shift_nu(np.where(upper, -0.2, 0.15))
    soft, stiff = (lam + 2.0 * mu for mu, lam in (lame({"E_pa": 1e5, "nu": nu}) for nu in (0.1, 0.45)))
    stress = 2.0 * (stretch - 1.0) / (1.0 / soft + 1.0 / stiff)
    walls = [dofs(sets[f"{axis}_{side}"], k) for k, axis in enumerate("xy") for side in ("min", "max")]
    fixed = np.concatenate([*walls, dofs(sets["bottom"], 2), dofs(sets["top"], 2)])
    height = rest[:, 2] - rest[:, 2].min()
    expected = rest.copy()
    expected[:, 2] += height * stress / stiff + np.maximum(height - 0.005, 0.0) * stress * (1.0 / soft - 1.0 / stiff)
    x = rest.copy()
    x.ravel()[fixed] = expected.ravel()[fixed]
    x = body.solve(x, others(body, fixed))
    assert np.abs(x - expected).max() < 1e-14
    assert body.gradient(x)[sets["top"], 2].sum() == pytest.approx(stress * 1e-4, rel=1e-10)
    assert abs(stress / (stretch - 1.0)) < 0.75 * 0.5 * (soft + stiff)  # one ratio for both would not do


@pytest.mark.parametrize("pattern", ["regular", "crossed"])
def test_two_parts_of_a_sheet_that_cannot_narrow(pattern):
    """In series, each with the stress s C_11 (s^2 - 1) / 2, C_11 = E / (1 - nu^2), and nu times as much across."""
    mesh = strip(pattern)
    system, term = membrane(mesh, {**PAPER, "nu": 0.2})
    right = mesh.nodes[mesh.triangles, 0].mean(axis=1) > 0.0
    term.shift_nu(np.where(right, 0.25, -0.2))
    compliant, stiff = (PAPER["E_pa"] / (1.0 - nu**2) for nu in (0.0, 0.45))

    def stress(modulus, s):
        return modulus * s * (s**2 - 1.0) / 2.0

    left = 1.05
    other = brentq(lambda s: stress(stiff, s) - stress(compliant, left), 1.0, left, xtol=1e-15)
    x = mesh.nodes.copy()
    x[:, 0] *= np.where(x[:, 0] < 0.0, left, other)
    system.x[:] = x
    force, half = system.gradient(), 0.5 * np.ptp(mesh.nodes, axis=0)
    expected = PAPER["thickness_m"] * 0.02 * stress(compliant, left)
    assert force[mesh.nodes[:, 0] > half[0] - 1e-9, 0].sum() == pytest.approx(expected, rel=1e-12)
    sides = (np.abs(mesh.nodes[:, :2]) > half[:2] - 1e-9).any(axis=1)
    assert (~sides).sum() >= 9 and np.abs(force[~sides]).max() < 1e-11 * expected
    assert np.abs(force[np.abs(mesh.nodes[:, 0]) < half[0] - 1e-9, 0]).max() < 1e-11 * expected
    edge = (mesh.nodes[:, 1] > half[1] - 1e-9) & (np.abs(mesh.nodes[:, 0] - 0.5 * half[0]) < 0.4 * half[0])
    across = 0.45 * PAPER["thickness_m"] * 0.005 * stress(stiff, other) / other
    assert edge.any() and force[edge, 1] == pytest.approx(across, rel=1e-9)


@pytest.mark.parametrize("pattern", ["regular", "crossed", "irregular"])
def test_a_saddle_of_two_parts(pattern):
    """D / 2 (a^2 + b^2 + 2 nu a b) an area: curvatures of opposite sign cost less where nu is larger."""
    mesh, (a, b) = strip(pattern), (0.2, -0.15)
    system, term = bending(mesh, {**PAPER, "nu": 0.2})
    right = mesh.nodes[mesh.triangles, 0].mean(axis=1) > 0.0
    nu = np.where(right, 0.45, -0.3)
    term.shift_nu(nu - 0.2)
    system.x[:] = mesh.nodes
    system.x[:, 2] = 0.5 * (a * mesh.nodes[:, 0] ** 2 + b * mesh.nodes[:, 1] ** 2)
    density = PAPER["E_pa"] * PAPER["thickness_m"] ** 3 / 24.0 / (1.0 - nu**2) * (a**2 + b**2 + 2.0 * nu * a * b)
    assert system.energy() == pytest.approx(mesh.areas @ density, rel=1e-4)
    term.shift_nu(np.zeros(len(nu)))
    assert system.energy() != pytest.approx(mesh.areas @ density, rel=0.05)


# ------------------------------------------------------------------------------------ true energies


@pytest.mark.parametrize("damping", [0.0, 0.03])
def test_gel_of_many_ratios_has_one_energy(damping):
    """Force and Hessian are its derivatives; what is made positive is."""
    rng, mesh = RNG(1), irregular_block(cells=(1, 1, 1), jitter=0.0)
    body = loaded({"E_pa": 1e5, "nu": 0.3, "stiffness_damping_s": damping}, mesh, rng)
    body.term.shift_nu(mixed(len(mesh.tets)))
    start = mesh.nodes + 2e-4 * rng.normal(size=mesh.nodes.shape)
    body.look.begin(start, dt=0.02)
    x, d = (mesh.nodes + 2e-4 * rng.normal(size=start.shape) for _ in range(2))
    d -= mesh.nodes
    d /= 2e-4
    gradient, hessian = body.gradient(x), body.hessian(x)
    assert difference(lambda t: body.energy(x + t * d), 1e-7) == pytest.approx(np.sum(gradient * d), rel=1e-7)
    curve = difference(lambda t: body.gradient(x + t * d), 1e-7).ravel()
    assert np.linalg.norm(curve - hessian @ d.ravel()) < 1e-8 * np.linalg.norm(curve)
    values = np.linalg.eigvalsh(body.hessian(x, exact=False).toarray())
    assert values[0] > -1e-13 * values[-1]


def test_gel_is_the_sum_of_its_elements():
    """Each element alone, with its ratio as the number of all: nothing is averaged over two of them."""
    mesh = irregular_block(cells=(1, 1, 1), jitter=0.0)
    whole = Body(mesh, {"E_pa": 1e5, "nu": 0.3})
    shift = mixed(len(mesh.tets))
    whole.term.shift_nu(shift)
    x, force = mesh.nodes + 3e-4 * RNG(2).normal(size=mesh.nodes.shape), np.zeros_like(mesh.nodes)
    for tet, change in zip(mesh.tets, shift, strict=True):
        one = solids.TetMesh(mesh.nodes, tet[None], mesh.surface, mesh.face_sets)
        force += Body(one, {"E_pa": 1e5, "nu": 0.3 + change}).gradient(x)
    assert np.abs(whole.gradient(x) - force).max() < 1e-12 * np.abs(force).max()


@pytest.mark.parametrize("parameters", [PAPER, ORTHOTROPIC], ids=["isotropic", "orthotropic"])
def test_sheets_of_many_ratios_have_one_energy(parameters):
    mesh = strip("irregular")
    for build, amplitude in ((membrane, 5e-4), (bending, 1e-3)):
        values = {**parameters, "yield_curvature_per_m": 40.0, "hardening_ratio": 0.3, "stiffness_damping_s": 0.01}
        system, term = build(mesh, values)
        term.shift_nu(mixed(len(mesh.triangles)))
        system.begin(mesh.nodes, dt=0.02)
        x = mesh.nodes + amplitude * RNG(1).standard_normal(mesh.nodes.shape)
        check_derivatives(system, x)
        if build is bending:
            system.x[:] = x
            flows = system.end().internals["bending"]["accumulated_curvature"] > 0.0
            assert flows.any() and not flows.all()


# -------------------------------------------------------------------------------------- derivatives


def test_moduli_and_their_derivatives():
    """K_own and K - K_own, in which the forces are linear, by differences of fourth order."""
    nu, young = np.array([-0.5, 0.0, 0.3, 0.45, 0.49]), 3e5
    found, slopes = moduli(young, nu), moduli_by_nu(young, nu)
    mu, lam = np.transpose([lame({"E_pa": young, "nu": n}) for n in nu])
    np.testing.assert_allclose(found[:, MU], mu)
    np.testing.assert_allclose(found[:, BULK], lam + 2.0 / 3.0 * mu)
    np.testing.assert_allclose(1.0 / found[:, OWN] / found[:, BULK], 1.0 / found[:, BULK] + 1.0 / (6.0 * mu))

    def linear(values):
        return np.stack([values[:, MU], values[:, BULK] * values[:, OWN], values[:, BULK] * (1.0 - values[:, OWN])])

    expected = difference(lambda t: linear(moduli(young, nu + t)), 1e-5)
    np.testing.assert_allclose(linear(slopes), expected, rtol=1e-7)


def test_plane_stress_and_its_derivative():
    nu = np.array([[-0.5, 0.0], [0.3, 0.49]])
    found, slopes = plane_stress(ORTHOTROPIC, nu), plane_stress_by_nu(ORTHOTROPIC, nu)
    for place in np.ndindex(nu.shape):
        np.testing.assert_allclose(found[place], plane_stress({**ORTHOTROPIC, "nu": nu[place]}), rtol=1e-14)
        expected = difference(lambda t, n=nu[place]: plane_stress({**ORTHOTROPIC, "nu": n + t}), 1e-4)
        np.testing.assert_allclose(slopes[place], expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


def test_ratios_that_cannot_be():
    mesh = strip("regular", (2, 1))
    for build in (membrane, bending):
        term = build(mesh)[1]
        with pytest.raises(ConfigError, match=r"nu = 0\.51 is not between -1 and 0\.5"):
            term.shift_nu(np.full(len(mesh.triangles), 0.21))
