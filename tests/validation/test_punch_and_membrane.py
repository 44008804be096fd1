"""A flat punch on a layer, and a membrane blown into a dome: the reference, by second methods, and the simulator."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from sim_core.errors import ConfigError
from sim_core.rigs import Rig, parse_rig
from sim_core.scene.assembly import rigid_shape
from sysid.validation.bonded_layer import ball, pressed, punch, rounded_punch, softness
from sysid.validation.gels import LAYER
from sysid.validation.hencky import dome, hencky
from sysid.validation.punch import RADIUS, SHARP, THICKNESS, punch_force, punch_rig


@pytest.mark.parametrize("nu", LAYER)
def test_a_ball_on_a_layer_has_the_tabulated_force(nu: float) -> None:
    assert ball(nu, 0.5) == pytest.approx(LAYER[nu], rel=1e-5)


def test_a_layer_that_is_deep_is_a_half_space_and_one_that_is_thin_is_confined() -> None:
    """Boussinesq and Hertz; and the modulus of a layer that cannot move sideways, 2 G (1 - nu) / (1 - 2 nu)."""
    assert punch(0.3, 1e-4) == pytest.approx(1.0, abs=2e-4)
    assert ball(0.3, 1e-4) == pytest.approx((1e-4, 1.0), rel=2e-4)
    nu, x = 0.3, 1e-5
    confined = 2.0 * 0.5 / (1.0 + nu) * (1.0 - nu) / (1.0 - 2.0 * nu)
    assert 2.0 * (1.0 - nu**2) * (1.0 + softness(np.array([x]), nu)[0]) / x == pytest.approx(1.0 / confined, rel=1e-4)


def test_stress_and_displacement_of_the_layer_solve_the_equations_of_elasticity() -> None:
    """A second method for the kernel: displacements cos(q x) and sin(q x) through the thickness by collocation."""
    nu, q = 0.4, 1.7
    lam, mu = nu / (1.0 + nu) / (1.0 - 2.0 * nu), 0.5 / (1.0 + nu)
    m = lam + 2.0 * mu

    def slopes(_: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, w, shear, normal = y  # u sin(q x), w cos(q x); stresses on planes of constant depth
        du, dw = shear / mu + q * w, (normal - lam * q * u) / m
        along = m * q * u + lam * dw
        return np.stack([du, dw, q * along, -q * shear])

    def ends(bottom: np.ndarray, top: np.ndarray) -> np.ndarray:
        return np.array([bottom[0], bottom[1], top[2], top[3] + 1.0])

    found = solve_bvp(slopes, ends, np.linspace(0.0, 1.0, 21), np.zeros((4, 21)), tol=1e-9)
    sunk = -found.sol(1.0)[1]
    assert sunk == pytest.approx(2.0 * (1.0 - nu**2) * (1.0 + softness(np.array([q]), nu)[0]) / q, rel=1e-6)


def test_a_rounded_rim_is_softer_and_tends_to_the_sharp_one() -> None:
    """With a vanishing rounding to a punch of its radius, with a vanishing depth to one as large as what is flat."""
    sharp = punch(0.45, 0.5) * 0.5
    shallow = rounded_punch(0.45, 0.5, 0.05, 1e-6) / 1e-6
    assert shallow == pytest.approx(pressed(0.45, 0.45, np.zeros_like)[1][0], rel=1e-2)
    assert shallow < rounded_punch(0.45, 0.5, 0.05, 5e-3) / 5e-3 < sharp
    assert rounded_punch(0.45, 0.5, 1e-3, 1e-4) / 1e-4 == pytest.approx(sharp, rel=5e-3)


@pytest.mark.slow
def test_a_flat_punch_on_a_mesh_that_is_fine_along_its_rim() -> None:
    found = punch_force(0.45, 3e-4, SHARP)
    assert found == pytest.approx(punch(0.45, RADIUS / THICKNESS), rel=0.04)
    assert found > 1.1 * punch(0.3, RADIUS / THICKNESS)


def test_the_rounding_of_a_rim_is_what_the_rig_says() -> None:
    assert [rigid_shape(punch_rig(0.45, 1e-3, rim).bodies["presser"])[3] for rim in (SHARP, None)] == [SHARP, 2e-4]


def boxed(**body: object) -> Rig:
    return parse_rig({"name": "box", "bodies": {"box": body}}, "box")


def test_a_rounding_that_does_not_fit_or_is_of_no_effect_is_refused() -> None:
    shape = {"type": "box", "size_m": [0.01, 0.02, 0.004]}
    assert rigid_shape(boxed(type="rigid", shape={**shape, "edge_radius_m": 1e-3}).bodies["box"])[4] == 1e-3
    with pytest.raises(ConfigError, match="half the smallest extent"):
        boxed(type="rigid", shape={**shape, "edge_radius_m": 2e-3})
    with pytest.raises(ConfigError, match="affine bodies"):
        boxed(type="affine", shape={**shape, "edge_radius_m": 1e-4}, material={"density_kg_m3": 1000.0})


@pytest.mark.parametrize(("nu", "first"), [(0.2, 1.6827), (0.3, 1.7244), (0.4, 1.7769)])
def test_the_series_is_that_of_the_literature(nu: float, first: float) -> None:
    """First coefficients of Hencky's series, four times s at the centre (Fichter, NASA TP-3658, 1997)."""
    assert 4.0 * hencky(nu).centre == pytest.approx(first, abs=1e-4)


def test_the_series_solves_the_equation_of_the_membrane() -> None:
    """By collocation, from close to the centre, where the slope of s is its regular one."""
    nu, near = 0.35, 1e-3

    def slopes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        s, ds, _ = y
        return np.stack([ds, -1.0 / (8.0 * s**2) - 3.0 * ds / x, 0.5 * x / s])

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([a[1] + near / (32.0 * a[0] ** 2), b[1] + (1.0 - nu) * b[0], a[2]])

    x = np.linspace(near, 1.0, 50)
    start = np.stack([0.45 - 0.1 * x**2, -0.2 * x, x])
    found = solve_bvp(slopes, ends, x, start, tol=1e-8)
    s, _, rise = found.sol(1.0)
    exact = hencky(nu)
    assert (exact.rim, exact.rise) == pytest.approx((s, rise), rel=1e-5)


def test_a_membrane_is_blown_into_the_dome() -> None:
    rise, rim = dome(0.3, 48)
    exact = hencky(0.3)
    assert rise == pytest.approx(exact.rise, rel=0.005)
    assert rim == pytest.approx(exact.rim, rel=0.02)
    assert rise != pytest.approx(hencky(0.2).rise, rel=0.005)
