"""The independent rod against closed forms: elastica, cantilever, damping, yield, dry friction."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from sysid.proof.truths.paths import Path
from sysid.proof.truths.rod import Rod, RodShape, cantilever_frequency
from sysid.proof.truths.rod_laws import Bending, Table

STIFFNESS, MASS, LENGTH = 8e-5, 9e-3, 0.12


def rod(hand, *, mass=lambda u: np.full_like(u, MASS), elements: int = 40, damping_s: float = 0.0, **more) -> Rod:
    shape = RodShape(LENGTH, 0.03, mass, lambda u: np.full_like(u, STIFFNESS), elements)
    return Rod(shape, lambda b: Bending(b, damping_s), hand, **more)


def test_end_load_gives_the_elastica() -> None:
    """Bisshopp & Drucker, Q. Appl. Math. 3, 1945: end load P across a cantilever, by the slope of its end.
    The load is the weight of the last element alone, so it acts at its middle."""
    n, slope = 80, 0.9
    arm = LENGTH * (1.0 - 0.5 / n)
    p = math.sqrt((1.0 + math.sin(slope)) / 2.0)
    start = math.asin(1.0 / (p * math.sqrt(2.0)))
    root = ellipk(p * p) - ellipkinc(start, p * p)
    drop = arm * (1.0 - 2.0 * (ellipe(p * p) - ellipeinc(start, p * p)) / root)
    reach = arm * math.sqrt(2.0 * math.sin(slope)) / root
    load = STIFFNESS * root**2 / arm**2
    weight = load / 9.81 / (LENGTH / n)
    state = rod(lambda t: (0.0, 0.0, 0.0), mass=lambda u: np.where(u > 1 - 1 / n, weight, 0.0), elements=n).settle()
    found = 0.5 * (state.position[-1] + state.position[-2])
    assert found == pytest.approx([reach, -drop], rel=5e-4)
    assert state.force == pytest.approx([0.0, -load])
    assert state.moment == pytest.approx(-load * reach, rel=5e-4)


def ring(damping_s: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Motion of the end after a small turn of the hand, without gravity."""
    dt = 5e-4
    free = rod(lambda t: (0.0, 0.0, 1e-3 * min(t / 0.05, 1.0)), damping_s=damping_s, gravity=(0.0, 0.0), elements=24)
    free.settle()
    t = dt * np.arange(1, round(seconds / dt))
    z = np.array([free.step(float(at), dt).position[-1, 1] for at in t]) - 1e-3 * LENGTH
    return t[t > 0.1], z[t > 0.1]


def crossings(t: np.ndarray, z: np.ndarray) -> np.ndarray:
    k = np.flatnonzero(z[:-1] * z[1:] < 0.0)
    return t[k] - z[k] * (t[k + 1] - t[k]) / (z[k + 1] - z[k])


def test_frequency_and_damping_of_a_cantilever() -> None:
    wanted, ratio = cantilever_frequency(STIFFNESS, MASS, LENGTH), 0.02
    t, z = ring(2 * ratio / (2 * math.pi * wanted), 1.2)
    zeros = crossings(t, z)
    frequency = (len(zeros) - 1) / 2 / (zeros[-1] - zeros[0])
    assert frequency == pytest.approx(wanted, rel=3e-3)
    peaks = [np.abs(z[(t > a) & (t < b)]).max() for a, b in pairwise(zeros)]
    decay = -np.polyfit(np.arange(len(peaks)), np.log(peaks), 1)[0] / math.pi
    assert decay == pytest.approx(ratio, rel=0.03)


def test_yield_hardening_and_what_stays() -> None:
    law = Bending(np.array([2.0]), yield_per_m=5.0, hardening=0.25)
    moments = []
    for curvature in (4.0, 10.0, 4.0):
        moments.append(float(law.moment(np.array([curvature]), np.zeros(1), 0.1, rate_slope=0.0)[0][0]))
        law.advance(np.array([curvature]), 0.1)
    flow = (10.0 - 5.0) / 1.25
    assert moments == pytest.approx([2.0 * 4.0, 2.0 * (10.0 - flow), 2.0 * (4.0 - flow)])
    assert float(law.plastic[0]) == pytest.approx(flow)


def test_maxwell_branch_fades() -> None:
    law = Bending(np.array([3.0]), branches=((0.4, 0.5),))
    dt, kappa = 1e-3, np.array([2.0])
    first = float(law.moment(kappa, np.zeros(1), dt, rate_slope=0.0)[0][0])
    assert first == pytest.approx(3.0 * 2.0 * 1.4, rel=2e-3)
    for _ in range(500):
        law.advance(kappa, dt)
    later = float(law.moment(kappa, np.zeros(1), dt, rate_slope=0.0)[0][0])
    assert later == pytest.approx(3.0 * 2.0 * (1.0 + 0.4 * math.exp(-1.0)), rel=2e-3)


@pytest.mark.parametrize("curvature", [3.0, 9.0, -12.0])
def test_tangent_of_the_moment(curvature: float) -> None:
    law = Bending(np.array([2.0]), 0.01, 0.3, 5.0, 0.25, ((0.2, 0.3),), softening_per_m=8.0)
    law.plastic = np.array([0.5])

    def moment(k: float) -> float:
        return float(law.moment(np.array([k]), np.array([150.0 * k]), 0.01, rate_slope=150.0)[0][0])

    slope = float(law.moment(np.array([curvature]), np.array([150.0 * curvature]), 0.01, rate_slope=150.0)[1][0])
    assert slope == pytest.approx((moment(curvature + 1e-5) - moment(curvature - 1e-5)) / 2e-5, rel=1e-6)


def test_contact_sticks_slides_and_lets_go() -> None:
    table = Table(0.3, excess=0.5, stiffness=1e4)
    table.start(np.zeros(1))
    depth = np.array([-1e-3])
    normal = 1e4 * 1e-3
    held, _ = table.force(np.array([4e-4]), depth)
    assert held[0] == pytest.approx([-4.0, normal])
    breaking, _ = table.force(np.array([2e-3]), depth)
    assert breaking[0, 0] == pytest.approx(-0.45 * normal)
    table.advance(np.array([2e-3]), depth)
    sliding, _ = table.force(np.array([3e-3]), depth)
    assert sliding[0, 0] == pytest.approx(-0.3 * normal)
    assert table.force(np.array([3e-3]), -depth)[0][0] == pytest.approx([0.0, 0.0])


def test_a_dragged_strip_feels_friction_times_load() -> None:
    """Hand above, strip sloping down: in steady sliding the table's pull is mu times its push, by balance of forces."""
    path = Path((0.0, 0.06, -0.5)).wait(0.05).move((0.0, -0.012, 0.0), 0.6).wait(0.1).move((-0.03, 0.0, 0.0), 1.5)
    dragged = rod(path, damping_s=2e-3, table=Table(0.25), elements=24)
    state = dragged.settle()
    for k in range(round(1.6 / 2e-3)):
        state = dragged.step(2e-3 * (k + 1), 2e-3)
    pull, push = state.force - [0.0, -9.81 * MASS * LENGTH]
    assert state.contact > 0.0
    assert pull / push == pytest.approx(0.25, rel=0.03)
