import numpy as np
import pytest
from potentials import check_derivatives
from scipy.spatial.transform import Rotation
from shell_terms import ORTHOTROPIC, PAPER, bending, rolled, strip

from sim_core.energies.dihedral import hinge_angles
from sim_core.geometry.sheets import SheetMesh

PATTERNS = ("regular", "crossed", "irregular")
RIGIDITY = PAPER["E_pa"] * PAPER["thickness_m"] ** 3 / 12.0 / (1.0 - PAPER["nu"] ** 2)


def crumpled(mesh, seed=2):
    """About 1 rad at the hinges."""
    x = mesh.nodes.copy()
    x[:, 2] += 2.5e-3 * np.random.default_rng(seed).standard_normal(len(x))
    return x


@pytest.mark.parametrize("parameters", [PAPER, ORTHOTROPIC], ids=["isotropic", "orthotropic"])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_derivatives_match_differences_at_sharp_folds(pattern, parameters):
    """The Hessian holds the change of the moments' directions too, at folds of about one radian."""
    mesh = strip(pattern)
    system, term = bending(mesh, parameters)
    check_derivatives(system, crumpled(mesh))
    assert np.abs(hinge_angles(crumpled(mesh), term.hinge_nodes)).max() > 1.0


def test_derivatives_match_differences_about_a_curved_rest_shape():
    flat = strip("irregular")
    mesh = SheetMesh(rolled(flat, 30.0, 0.4), flat.triangles)
    system, _ = bending(mesh)
    assert system.energy() < 1e-30  # the square of the round-off of angles
    check_derivatives(system, mesh.nodes + crumpled(flat) - flat.nodes)


def test_derivatives_match_differences_with_plastic_curvature():
    mesh = strip("crossed")
    system, _ = bending(mesh, {**PAPER, "yield_curvature_per_m": 5.0, "hardening_ratio": 0.1})
    plastic = 20.0 * np.random.default_rng(3).standard_normal((len(mesh.triangles), 3))
    internals = {"plastic_curvature": plastic, "accumulated_curvature": np.zeros(len(plastic))}
    system.begin(mesh.nodes, internals={"bending": internals})
    check_derivatives(system, crumpled(mesh))


@pytest.mark.parametrize("pattern", PATTERNS)
def test_hessian_without_curvature_of_the_angles_is_positive_semidefinite(pattern):
    mesh = strip(pattern)
    system, _ = bending(mesh)
    system.x[:] = crumpled(mesh)
    values = np.linalg.eigvalsh(system.hessian())
    assert values[0] > -1e-12 * values[-1]


@pytest.mark.parametrize("direction", [0.0, 0.5, np.pi / 2])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_patch_test_constant_curvature(pattern, direction):
    """A sheet rolled onto a cylinder has that curvature in every triangle of any mesh, and the energy of
    plate theory: the rigidity does not depend on the mesh."""
    curvature = 0.2
    mesh = strip(pattern)
    system, term = bending(mesh)
    system.x[:] = rolled(mesh, curvature, direction)
    c, s = np.cos(direction), np.sin(direction)
    expected = curvature * np.array([c * c, s * s, 2 * c * s])
    found = term.curvatures_at(system.x)
    found = found * np.sign((found @ expected).sum())
    np.testing.assert_allclose(found, np.tile(expected, (len(found), 1)), atol=2e-4 * curvature)
    area = mesh.areas.sum()
    assert system.energy() == pytest.approx(0.5 * RIGIDITY * curvature**2 * area, rel=1e-4)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_rigidity_converges_at_strong_curvature(pattern):
    """Half a turn over the sheet's length: the energy of the true arc within 2 % at 20 cells, on every mesh."""
    curvature = np.pi / 0.05
    mesh = strip(pattern, cells=(20, 8))
    system, _ = bending(mesh)
    system.x[:] = rolled(mesh, curvature)
    expected = 0.5 * RIGIDITY * curvature**2 * mesh.areas.sum()
    assert system.energy() == pytest.approx(expected, rel=0.02)


def test_orthotropic_sheet_bends_less_across_its_grain():
    mesh = strip("irregular")
    ratio, angle = ORTHOTROPIC["anisotropy_ratio"], ORTHOTROPIC["grain_angle_rad"]
    system, _ = bending(mesh, ORTHOTROPIC)
    system.x[:] = rolled(mesh, 0.2, angle)
    along = system.energy()
    system.x[:] = rolled(mesh, 0.2, angle + np.pi / 2)
    assert along / system.energy() == pytest.approx(ratio, rel=1e-3)


def test_rotation_costs_nothing_and_turns_the_forces():
    mesh = strip("irregular")
    rotation = Rotation.from_rotvec([-0.3, 1.9, 0.8])
    system, _ = bending(mesh)
    x = crumpled(mesh)
    system.x[:] = x
    energy, force = system.energy(), system.gradient()
    system.x[:] = rotation.apply(x) + [0.1, 0.2, -0.3]
    assert system.energy() == pytest.approx(energy, rel=1e-10)
    np.testing.assert_allclose(system.gradient(), rotation.apply(force), atol=1e-9 * np.abs(force).max())


def plastic_sheet(pattern, cells=(10, 4), yield_curvature=20.0, hardening=0.25):
    mesh = strip(pattern, cells)
    values = {**PAPER, "nu": 0.0, "yield_curvature_per_m": yield_curvature, "hardening_ratio": hardening}
    system, term = bending(mesh, values)
    return mesh, system, term


def bend_to(mesh, system, term, curvatures):
    """Internal variables after the sheet has been rolled to each curvature in turn."""
    internals = term.initial_internals()
    for curvature in curvatures:
        system.begin(system.x, internals={"bending": internals})
        system.x[:] = rolled(mesh, curvature)
        internals = system.end().internals["bending"]
    return internals


@pytest.mark.parametrize(("pattern", "cells"), [("regular", (10, 4)), ("crossed", (20, 8)), ("irregular", (14, 5))])
def test_springback_of_linear_hardening(pattern, cells):
    """Bent to k > k_Y and let go, a sheet keeps (k - k_Y) / (1 + H); the mesh does not decide."""
    k_yield, hardening, k = 20.0, 0.25, 60.0
    mesh, system, term = plastic_sheet(pattern, cells, k_yield, hardening)
    internals = bend_to(mesh, system, term, [k])
    kept = np.abs(internals["plastic_curvature"][:, 0])
    inner = np.abs(mesh.nodes[mesh.triangles].mean(axis=1)[:, 0]) < 0.02
    np.testing.assert_allclose(kept[inner], (k - k_yield) / (1.0 + hardening), rtol=0.02)
    left = term.curvatures_at(rolled(mesh, (k - k_yield) / (1.0 + hardening)))
    moments = np.abs(left - internals["plastic_curvature"])[inner]
    assert moments.max() < 0.02 * k


def test_below_yield_the_sheet_is_elastic_bit_for_bit():
    mesh, system, term = plastic_sheet("crossed")
    internals = bend_to(mesh, system, term, [15.0, 5.0])
    assert not internals["plastic_curvature"].any()
    system.begin(system.x, internals={"bending": internals})
    energy = system.energy()
    elastic, _ = bending(mesh, {**PAPER, "nu": 0.0})
    elastic.x[:] = system.x
    assert energy == elastic.energy()


def test_monotone_bending_does_not_depend_on_the_number_of_steps_and_reloading_does_not_flow():
    mesh, system, term = plastic_sheet("regular")
    once = bend_to(mesh, system, term, [60.0])
    often = bend_to(mesh, system, term, np.linspace(2.0, 60.0, 25))
    np.testing.assert_allclose(often["plastic_curvature"], once["plastic_curvature"], atol=1e-6)
    again = bend_to(mesh, system, term, [60.0, 40.0, 60.0])
    np.testing.assert_allclose(again["plastic_curvature"], once["plastic_curvature"], atol=1e-9)


def test_plastic_flow_dissipates():
    """Work of bending out and back exceeds what is stored, and the accumulated curvature never falls."""
    mesh, system, term = plastic_sheet("crossed")
    internals = term.initial_internals()
    accumulated, lowest = 0.0, 0.0
    for curvature in [10.0, 30.0, 60.0, 20.0, 1e-3, -30.0, -60.0]:
        system.begin(system.x, internals={"bending": internals})
        system.x[:] = rolled(mesh, curvature)
        elastic = term.curvatures_at(system.x) - internals["plastic_curvature"]
        after = system.end().internals["bending"]
        flow = after["plastic_curvature"] - internals["plastic_curvature"]
        lowest = min(lowest, float(np.einsum("mi,mij,mj->m", elastic, term.stiffness, flow).min()))
        assert after["accumulated_curvature"].sum() >= accumulated
        accumulated, internals = after["accumulated_curvature"].sum(), after
    assert lowest >= 0.0
    assert accumulated > 0.0
