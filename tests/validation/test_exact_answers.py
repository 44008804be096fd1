"""The reference solutions: against what is printed, and by a second method."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from sysid.validation import planar_elastica
from sysid.validation.obstacles import exact_cylinder, exact_hemisphere
from sysid.validation.shells_of_revolution import cylinder, sphere, strains

SHARED = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).parents[3] / "shared"))
ANSWERS = SHARED / "validation" / "answers.json"


@pytest.mark.parametrize(("alpha", "deflection", "shortening"), [(1.0, 0.30172, 0.05643), (10.0, 0.81061, 0.55500)])
def test_a_tip_load_bends_as_mattiasson_prints(alpha, deflection, shortening):
    """Mattiasson, Int. J. Numer. Meth. Eng. 17, 1981, table 1."""
    np.testing.assert_allclose(planar_elastica.tip_loaded(alpha), (deflection, shortening), atol=6e-6)


@pytest.mark.parametrize(
    ("approach", "load", "slope", "middle"),
    [(0.0675678, 1.03512, 30.0, 0.16195), (0.87684, 1.8848, 120.0, 0.401585)],
)
def test_a_buckled_column_is_that_of_timoshenko(approach, load, slope, middle):
    force, angle, rise = planar_elastica.hinged(approach)
    assert force == pytest.approx(load, abs=2e-5)
    assert np.degrees(angle) == pytest.approx(slope, abs=1e-3)
    assert rise == pytest.approx(middle, abs=2e-6)


def test_a_light_strip_sags_as_a_beam():
    """Drop Gamma / 8; what the reach loses is 1/2 int y'^2 = Gamma^2 / 112."""
    drop, reach = planar_elastica.heavy(1e-3)
    assert drop == pytest.approx(1e-3 / 8.0, rel=1e-6)
    assert 1.0 - reach == pytest.approx(1e-6 / 112.0, rel=1e-5)


def test_a_pressed_strip_buckles_as_sano_says():
    """N = w^2 with tan(w) = w at first; the second row is of an integration by others."""
    assert planar_elastica.pressed(1e-5)[0] == pytest.approx(20.190729, rel=1e-4)
    np.testing.assert_allclose(planar_elastica.pressed(0.01), (20.2668, 0.909041), rtol=1e-5)


@pytest.mark.skipif(
    not ANSWERS.is_file(), reason=f"no file {ANSWERS}: set THINSHELL_SHARED to the folder that holds it"
)
def test_elasticas_are_those_of_the_tables():
    tables = json.loads(ANSWERS.read_text(encoding="utf-8"))["elastica"]
    for gamma, drop, reach, *_ in tables["heavy_elastica"]["rows"]:
        if gamma <= 1e4:
            np.testing.assert_allclose(planar_elastica.heavy(gamma), (drop, reach), rtol=1e-6)
    for alpha, deflection, shortening, *_ in tables["tip_load_elastica"]["rows"]:
        np.testing.assert_allclose(planar_elastica.tip_loaded(alpha), (deflection, shortening), rtol=1e-6)


def moved(meridian, shift, turn, at):
    """Fields u, v, w with two derivatives ``(3, 3, k)`` of a rigid motion, harmonic 1: a shift along x and a turn
    about y, at arcs ``at``; by central differences."""
    step = 1e-4 * meridian.length

    def fields(s):
        r, dr = meridian.shape(s)[:2]
        rise = np.sqrt(1.0 - dr**2)
        height = np.array(
            [np.trapezoid(np.sqrt(1.0 - meridian.shape(t)[1] ** 2), t) for t in np.linspace(0, s, 4001).T]
        )
        along, up = shift + turn * height, -turn * r
        return np.stack([along * dr + up * rise, -along, along * rise - up * dr])

    low, mid, high = fields(at - step), fields(at), fields(at + step)
    return np.stack([mid, (high - low) / (2 * step), (high - 2 * mid + low) / step**2], axis=1)


@pytest.mark.parametrize("meridian", [cylinder(2.0, 3.0), sphere(2.0, 1.2)], ids=["cylinder", "sphere"])
@pytest.mark.parametrize(("shift", "turn"), [(1.0, 0.0), (0.0, 1.0)])
def test_a_rigid_motion_does_not_strain_a_shell(meridian, shift, turn):
    at = meridian.length * np.array([0.2, 0.5, 0.8])
    fields = moved(meridian, shift, turn, at)
    assert np.abs(fields).max() > 0.5
    np.testing.assert_allclose(strains(meridian.shape(at), 1, fields), 0.0, atol=2e-5)


def navier(radius, length, thickness, modulus, nu, most):
    """Way under one of two opposite radial loads of 1 at the middle of a cylinder between diaphragms: double sine
    series of the same theory, m along and n round."""
    m, n = np.arange(1, most, 2)[:, None], np.arange(0, most, 2)[None, :]
    along, zero = m * np.pi / length + 0.0 * n, np.zeros((m + n).shape)
    around = n / radius + 0.0 * m
    rows = np.array(
        [
            [-along, zero, zero],
            [zero, around, zero + 1.0 / radius],
            [-around, along, zero],
            [zero, zero, along**2],
            [zero, around / radius, around**2],
            [around / (2.0 * radius), 1.5 * along / radius, 2.0 * along * around],
        ]
    )
    plane = np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - nu)]]) * modulus * thickness / (1 - nu**2)
    law = np.block([[plane, np.zeros((3, 3))], [np.zeros((3, 3)), plane * thickness**2 / 12.0]])
    stiffness = np.einsum("aimn,ab,bjmn->mnij", rows, law, rows, optimize=True)
    stiffness[:, 0, 1, 1] = 1.0
    ways = np.linalg.solve(stiffness, np.broadcast_to([[0.0], [0.0], [1.0]], (*zero.shape, 3, 1)))[..., 2, 0]
    return float(2.0 * (ways / (0.5 * length * radius * np.where(n == 0, 2.0 * np.pi, np.pi))).sum())


@pytest.mark.slow
def test_the_pinched_cylinder_is_its_double_series():
    """Both are cut off; their tails shrink with the square of the highest harmonic."""
    coarse, fine = (navier(300.0, 600.0, 3.0, 3e6, 0.3, most) for most in (200, 400))
    assert exact_cylinder() == pytest.approx(fine + (fine - coarse) / 3.0, rel=2e-4)


@pytest.mark.slow
def test_the_pinched_hemisphere_is_what_others_find():
    """0.0935: Simo, Fox & Rifai, Comput. Methods Appl. Mech. Eng. 73, 1989, for a fine mesh 0.0934 to 0.0935."""
    assert exact_hemisphere() == pytest.approx(0.0935, rel=1e-3)
