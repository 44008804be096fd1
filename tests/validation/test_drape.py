"""A disc of fabric over a round table: the reference, by another method, and the simulator."""

import numpy as np
import pytest
from draped_disc import Disc, energy_slopes

from sysid.validation.drape import AREAL, BENDING, DISC, DRAPED, NU, TABLE, THICKNESS, draped

LAW, RADII, OVERHANG = (BENDING, THICKNESS, NU), (TABLE, DISC), DISC - TABLE


def test_the_other_method_has_the_slopes_of_its_energy():
    rng = np.random.default_rng(3)
    q = np.repeat(np.array([1.0, 0, 0, 0, 1.0, 0, *[0.0] * 9])[:, None], 4, axis=1) + 0.1 * rng.normal(size=(15, 4))
    _, slopes = energy_slopes(q, LAW)
    for k in range(15):
        step = np.zeros((15, 1))
        step[k] = 1e-6
        ends = [energy_slopes(q + sign * step, LAW)[0] for sign in (1.0, -1.0)]
        np.testing.assert_allclose(slopes[k], (ends[0] - ends[1]) / 2e-6, rtol=1e-4, atol=1e-6 * np.abs(slopes).max())


def test_a_stiff_disc_hangs_as_a_plate_does_by_the_other_method():
    """A plate that is clamped at its inner rim and free at the outer one, axisymmetric (Timoshenko &
    Woinowsky-Krieger, ch. 3): w = q r^4 / 64 D + A r^2 + B r^2 log r + C log r + const."""
    stiffness, weight = 1.0, 4.0
    b, a = RADII

    def rows(r):  # slope; bending moment; shear force over D, of r^4 / 64, r^2, r^2 log r, log r
        log, nu = np.log(r), NU
        slope = [r**3 / 16, 2 * r, 2 * r * log + r, 1 / r]
        bend = [3 * r**2 / 16, 2, 2 * log + 3, -1 / r**2]
        moment = [k + nu * s / r for k, s in zip(bend, slope, strict=True)]
        return np.array(slope), np.array(moment), np.array([r / 2, 0.0, 4 / r, 0.0])

    system = np.array([rows(b)[0], rows(a)[1], rows(a)[2]])
    rest = np.linalg.solve(system[:, 1:], -system[:, 0])

    def shape(r):
        return np.array([r**4 / 64, r**2, r**2 * np.log(r), np.log(r)]) @ np.array([1.0, *rest])

    exact = -weight / stiffness * (shape(a) - shape(b))
    found = Disc((stiffness, THICKNESS, NU), weight, RADII, folds=5, elements=4, waves=1).drape(seed=1e-6)
    np.testing.assert_allclose(found.rim[1], exact, rtol=1e-3)


@pytest.mark.parametrize("folds", DRAPED)
def test_reference_values_are_those_of_the_other_method(folds):
    found = Disc(LAW, 9.81 * AREAL, RADII, folds, elements=6, waves=8).drape()
    assert found.stable
    heights = found.rim[1, [0, -1]] / OVERHANG
    np.testing.assert_allclose([found.coefficient, *heights], DRAPED[folds], atol=0.005)


def test_a_fabric_disc_drapes_with_the_coefficient_and_the_folds_of_the_other_method():
    """800 nodes."""
    found = draped(5, 80, 8)
    np.testing.assert_allclose(found, DRAPED[5], atol=0.015)
    assert np.abs(np.subtract(found, DRAPED[4])).max() > 0.05
