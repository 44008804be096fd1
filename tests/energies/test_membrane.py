import numpy as np
import pytest
from potentials import check_derivatives
from scipy.spatial.transform import Rotation
from shell_terms import ORTHOTROPIC, PAPER, membrane, strip

PATTERNS = ("regular", "crossed", "irregular")


def rough(mesh, amplitude, seed=1):
    return mesh.nodes + amplitude * np.random.default_rng(seed).standard_normal(mesh.nodes.shape)


@pytest.mark.parametrize("parameters", [PAPER, ORTHOTROPIC], ids=["isotropic", "orthotropic"])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_derivatives_match_differences(pattern, parameters):
    mesh = strip(pattern)
    system, _ = membrane(mesh, parameters)
    check_derivatives(system, rough(mesh, 5e-4))


def test_projected_hessian_is_positive_semidefinite_where_the_true_one_is_not():
    mesh = strip("crossed")
    system, _ = membrane(mesh)
    system.x[:] = mesh.nodes * [0.97, 0.98, 1.0]
    true = np.linalg.eigvalsh(system.hessian(exact=True))
    projected = np.linalg.eigvalsh(system.hessian())
    assert true[0] < -1e-3 * true[-1]
    assert projected[0] > -1e-12 * projected[-1]


def test_projection_changes_nothing_under_tension():
    mesh = strip("irregular")
    system, _ = membrane(mesh)
    system.x[:] = mesh.nodes * [1.01, 1.02, 1.0]
    np.testing.assert_allclose(system.hessian(), system.hessian(exact=True), rtol=1e-12, atol=1e-6)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_patch_test_uniaxial_tension(pattern):
    """A homogeneous stretch leaves no force inside, and at the end the force E h w e of a tensile test."""
    mesh = strip(pattern)
    strain, p = 1e-6, PAPER
    system, _ = membrane(mesh)
    system.x[:] = mesh.nodes * [1.0 + strain, 1.0 - p["nu"] * strain, 1.0]
    force = system.gradient()
    right = np.isclose(mesh.nodes[:, 0], 0.025)
    sides = np.isclose(np.abs(mesh.nodes[:, 1]), 0.01) | np.isclose(np.abs(mesh.nodes[:, 0]), 0.025)
    expected = p["E_pa"] * p["thickness_m"] * 0.02 * strain
    assert force[right, 0].sum() == pytest.approx(expected, rel=1e-5)
    assert np.abs(force[~sides]).max() < 1e-8 * expected


def test_orthotropic_sheet_is_stiffer_along_its_grain():
    """E_1 / E_2 of two tensile tests is the ratio that was put in, along and across a turned grain."""
    ratio, angle = ORTHOTROPIC["anisotropy_ratio"], ORTHOTROPIC["grain_angle_rad"]
    mesh = strip("irregular")
    system, term = membrane(mesh, ORTHOTROPIC)
    area, h = mesh.areas.sum(), ORTHOTROPIC["thickness_m"]
    compliance, stress = np.linalg.inv(term.stiffness[0] / h), 1e3

    def modulus(direction):
        c, s = np.cos(direction), np.sin(direction)
        voigt = np.array([c * c, s * s, c * s])
        strain = stress * compliance @ voigt
        tensor = np.array([[strain[0], strain[2] / 2], [strain[2] / 2, strain[1]]])
        system.x[:] = mesh.nodes
        system.x[:, :2] += mesh.nodes[:, :2] @ tensor
        return 0.5 * stress**2 * area * h / system.energy()

    assert modulus(angle) / modulus(angle + np.pi / 2) == pytest.approx(ratio, rel=1e-3)


def test_rotation_costs_nothing_and_turns_the_forces():
    mesh = strip("irregular")
    x = rough(mesh, 2e-4)
    rotation = Rotation.from_rotvec([0.7, -1.1, 0.4])
    system, _ = membrane(mesh)
    system.x[:] = rotation.apply(mesh.nodes)
    assert system.energy() < 1e-20
    system.x[:] = x
    energy, force = system.energy(), system.gradient()
    system.x[:] = rotation.apply(x) + [0.3, -0.2, 0.1]
    assert system.energy() == pytest.approx(energy, rel=1e-9)
    scale = np.abs(force).max()
    np.testing.assert_allclose(system.gradient(), rotation.apply(force), atol=1e-8 * scale)
