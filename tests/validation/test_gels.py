"""Gels: the law, elements that do not lock, a sphere on a layer, relaxation."""

import numpy as np
import pytest
from axisymmetric import bonded_disc as exact_disc

from sysid.validation.gels import LAYER, MARKERS, sphere_on_layer
from sysid.validation.solids import DISC, bonded_disc, relaxation, sheared, sheared_layer, stretched


@pytest.mark.parametrize("nu", LAYER)
def test_a_sphere_on_a_bonded_layer(nu):
    """Force within 3 % of the exact contact solution, and markers within 1.5 % of the depth."""
    pressed = sphere_on_layer(nu, (9, 4))
    assert pressed.force == pytest.approx(LAYER[nu][1], rel=0.03)
    for r, (outward, _) in MARKERS[nu].items():
        assert pressed.at(r)[0] == pytest.approx(outward, abs=0.015)


def test_the_answer_for_another_poisson_ratio_is_missed():
    """The tolerances tell the layers apart."""
    pressed = sphere_on_layer(0.3, (6, 3))
    assert pressed.force != pytest.approx(LAYER[0.45][1], rel=0.03)
    assert pressed.at(2.0)[0] != pytest.approx(MARKERS[0.45][2.0][0], abs=0.015)


@pytest.mark.parametrize("nu", [0.1, 0.3, 0.49])
def test_stress_of_a_stretched_block_follows_the_law(nu):
    """Closed forms of the compressible law, on a distorted mesh, to round-off."""
    for stretch in (0.7, 1.5):
        exact = stretch - (1.0 + (1.0 - 2.0 * nu) * (1.0 - 1.0 / stretch)) / stretch**2
        assert stretched(nu, (stretch, None, None))[0, 0] == pytest.approx(exact, rel=1e-6)


def test_simple_shear_has_a_normal_stress_difference():
    stress = sheared(0.4, 0.3)
    assert stress[0, 2] == pytest.approx(0.3, rel=1e-9)
    assert stress[0, 0] - stress[2, 2] == pytest.approx(0.09, rel=1e-9)


def test_a_layer_shears_in_proportion_to_the_height():
    force, stray = sheared_layer(0.49, (6, 2))
    assert force == pytest.approx(1.0, rel=1e-3)
    assert stray < 1e-3


@pytest.mark.parametrize(("nu", "shape"), DISC)
def test_reference_values_of_a_bonded_disc_are_those_of_another_method(nu, shape):
    assert exact_disc(nu, shape, degree=6, layers=6) == pytest.approx(DISC[nu, shape], rel=1e-5)


def test_a_bonded_disc_does_not_lock():
    """Linear tetrahedra are off by a factor of two."""
    assert bonded_disc(0.49, 1.0, (4, 2, 4)) == pytest.approx(DISC[0.49, 1.0], rel=0.05)


def test_a_held_layer_relaxes_as_its_prony_branch():
    """To round-off whatever the step: the branch is integrated exactly while nothing moves."""
    for dt in (0.05, 0.25):
        found = relaxation(0.4, 0.5, [0.5, 1.0], dt)
        np.testing.assert_allclose(found, 1.0 - 0.4 * (1.0 - np.exp([-1.0, -2.0])), rtol=1e-5)
