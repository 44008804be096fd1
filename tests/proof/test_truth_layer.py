"""The independent layer and ball against closed forms: wave numbers, pressed and thin layers, Mindlin, relaxation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sysid.proof.truths.ball import Ball, BallLaws
from sysid.proof.truths.layer import Layer, Surface, along_and_normal

SHEAR, POISSON = 7e4, 0.45


def ball_on_layer(
    laws: BallLaws, *, share: float = 0.2, poisson: float = POISSON, slope: float = 0.1, points: int = 24
) -> tuple[Ball, float]:
    """A ball and a depth for which the radius of contact sqrt(R d) is ``share`` of the thickness and ``slope`` of R."""
    radius = 0.02
    contact = slope * radius
    pitch = 2.6 * contact / points
    period = 2 * math.ceil(3.2 * contact / share / pitch + points / 2)
    return Ball(Surface(Layer(contact / share, SHEAR, poisson), points, pitch, period), radius, laws), slope * contact


def force(ball: Ball, traction: np.ndarray) -> np.ndarray:
    return traction.sum(axis=(1, 2)) * ball.surface.pitch**2


@pytest.mark.parametrize("poisson", [0.2, 0.48])
def test_response_of_a_bonded_layer(poisson: float) -> None:
    """Normal and tangential compliance of a bonded layer (Johnson, Contact Mechanics, 1985, sec. 5.7), symmetric
    coupling, and the coupling (1 - 2 nu) / (2 G k) of a half-space."""
    layer = Layer(9e-3, SHEAR, poisson)
    k = np.array([3.0, 60.0, 300.0, 1500.0, 9000.0])
    found = along_and_normal(layer, k)
    a, kappa = k * layer.thickness, 3 - 4 * poisson
    below = 2 * kappa * np.cosh(2 * a) + 1 + kappa**2 + 4 * a**2
    scale = (1 - poisson) / (SHEAR * k) / below
    assert found[:, 1, 1] == pytest.approx(scale * (2 * kappa * np.sinh(2 * a) - 4 * a), rel=1e-9)
    assert found[:, 0, 0] == pytest.approx(scale * (2 * kappa * np.sinh(2 * a) + 4 * a), rel=1e-9)
    assert found[:, 0, 1] == pytest.approx(found[:, 1, 0], rel=1e-9)
    assert found[-1, 0, 1] == pytest.approx(-(1 - 2 * poisson) / (2 * SHEAR * k[-1]), rel=1e-9)


def test_patch_and_period_answer_alike() -> None:
    surface = Surface(Layer(5e-3, SHEAR, POISSON), 12, 5e-4, 64)
    traction = np.random.default_rng(0).standard_normal((3, 12, 12))
    whole = surface.everywhere(traction)[:, 26:38, 26:38]
    assert surface.displacement(traction) == pytest.approx(whole, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("poisson", [0.3, 0.499])
def test_pressed_layer_follows_dimitriadis(poisson: float) -> None:
    """Hertz with the terms for a bonded layer in powers of sqrt(R d) / h (Dimitriadis et al., Biophys. J. 82, 2002)."""
    share = 0.2
    ball, depth = ball_on_layer(BallLaws(0.0), share=share, poisson=poisson, slope=1e-3)
    pressed = force(ball, ball.step(np.array([0.0, 0.0, -depth]), 1.0))
    a0 = -(1.2876 - 1.4678 * poisson + 1.3442 * poisson**2) / (1 - poisson)
    b0 = (0.6387 - 1.0277 * poisson + 1.5164 * poisson**2) / (1 - poisson)
    x = share / math.pi
    terms = 1 - 2 * a0 * x + 4 * a0**2 * x**2 - 8 * (a0**3 + 4 * math.pi**2 / 15 * b0) * x**3
    terms += 16 * a0 * (a0**3 + 3 * math.pi**2 / 5 * b0) * x**4
    hertz = 4 / 3 * 2 * SHEAR / (1 - poisson) * math.sqrt(ball.radius) * depth**1.5
    assert pressed[2] == pytest.approx(-hertz * terms, rel=0.02)
    assert abs(pressed[:2]).max() < 1e-6 * abs(pressed[2])


def test_thin_layer_is_a_bed_of_columns() -> None:
    """Confined compressible columns: F = pi (lambda + 2 G) R d^2 / h (Johnson 1985, sec. 5.8)."""
    poisson, h, depth, radius = 0.2, 4e-5, 2e-7, 0.5
    contact = math.sqrt(2 * radius * depth)
    ball = Ball(Surface(Layer(h, SHEAR, poisson), 36, 2.4 * contact / 36, 128), radius, BallLaws(0.0))
    pressed = force(ball, ball.step(np.array([0.0, 0.0, -depth]), 1.0))
    modulus = 2 * SHEAR * (1 - poisson) / (1 - 2 * poisson)
    assert pressed[2] == pytest.approx(-math.pi * modulus * radius * depth**2 / h, rel=0.05)


def test_partial_slip_follows_cattaneo_and_mindlin() -> None:
    """Sticking, Q = 8 G a / (2 - nu) d; with friction d = d_s (1 - (1 - Q / mu P)^(2/3)), and mu P from d_s on
    (Johnson, Contact Mechanics, 1985, sec. 7.2), for a flat contact on a thick incompressible layer, whose press has no
    friction."""
    mu, share, nu = 0.3, 0.06, 0.499
    held, depth = ball_on_layer(BallLaws(1e3), share=share, poisson=nu, slope=1e-3, points=18)
    at, contact = np.array([0.0, 0.0, -depth]), 1e-3 * held.radius
    normal = -force(held, held.step(at, 1.0))[2]
    move = 0.01 * contact * 1e-3
    stiffness = force(held, held.step(at + [move, 0.0, 0.0], 1.0))[0] / move
    assert stiffness == pytest.approx(8 * SHEAR * contact / (2 - nu), rel=0.08)
    full = 1.5 * mu * normal / stiffness
    ball, _ = ball_on_layer(BallLaws(mu), share=share, poisson=nu, slope=1e-3, points=18)
    ball.step(at, 1.0)
    for part in (0.25, 0.5, 0.75):
        pulled = force(ball, ball.step(at + [part * full, 0.0, 0.0], 1.0))
        assert pulled[0] == pytest.approx(mu * normal * (1 - (1 - part) ** 1.5), rel=0.05)
    slid = force(ball, ball.step(at + [2 * full, 0.0, 0.0], 1.0))
    assert slid[0] / -slid[2] == pytest.approx(mu, rel=1e-3)


def test_held_force_relaxes_by_two_branches() -> None:
    branches = ((0.2, 0.3), (0.1, 3.0))
    ball, depth = ball_on_layer(BallLaws(0.3, branches=branches), points=16)
    at = np.array([0.0, 0.0, -depth])
    first = force(ball, ball.step(at, 1e-4))[2]
    t = 0.0
    for _ in range(40):
        t += 0.02
        now = force(ball, ball.step(at, 0.02))[2]
    assert now / first == pytest.approx(1 - sum(g * (1 - math.exp(-t / tau)) for g, tau in branches), rel=0.005)


@pytest.mark.slow
def test_adhesion_pulls_between_jkr_and_dmt() -> None:
    """Between 3/2 and 2 pi w R (Maugis, J. Colloid Interface Sci. 150, 1992)."""
    work = 0.02
    ball, _ = ball_on_layer(BallLaws(0.0, work_j_m2=work, range_m=6e-5), share=0.1, points=32)
    pull = []
    for z in np.linspace(-5e-5, 8e-5, 40):
        pull.append(force(ball, ball.step(np.array([0.0, 0.0, z]), 1.0))[2])
    assert 1.4 < max(pull) / (math.pi * work * ball.radius) < 2.1
    assert abs(pull[-1]) < 1e-6
