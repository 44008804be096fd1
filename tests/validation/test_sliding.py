"""Friction: a sheet on a plane, and a strip that is pressed on one."""

import numpy as np
import pytest

from sysid.validation.friction import (
    MU,
    TURNS,
    acceleration,
    elastic_slip,
    sawtooth,
    slip_onset,
    stopping_distance,
)
from sysid.validation.planar_elastica import pressed
from sysid.validation.rough_plane import ONSET, STICKING, onset, sticking

ANY_TURN = pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)


@ANY_TURN
def test_a_sheet_slips_at_the_angle_of_friction_and_accelerates_as_in_a_textbook(turn):
    """Whatever the orientation of the scene and the direction of the slope."""
    for heading in (0.3, 2.5):
        assert slip_onset(turn, heading) == pytest.approx(1.0, abs=0.005)
    assert acceleration(turn, 1.2 * MU, 0.9) == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("ratio", [0.25, 0.75, 0.99])
def test_a_sheet_below_its_limit_gives_way_and_rests(ratio):
    """The elastic slip of the law, and no creep."""
    given, drift = elastic_slip(ratio, TURNS["turned at random (1)"])
    assert given == pytest.approx(1.0 - np.sqrt(1.0 - ratio), rel=1e-3)
    assert abs(drift) < 1e-6


def test_the_stopping_distance_converges_with_the_order_of_the_integrator():
    for second_order, order in ((False, 1.0), (True, 1.5)):
        coarse, fine = (
            abs(stopping_distance(TURNS["upright"], 0.5, 0.4, second_order, dt) - 1.0) for dt in (4e-3, 2e-3)
        )
        assert np.log2(coarse / fine) > 0.9 * order
        assert fine < 0.02


def test_stick_slip_has_twice_the_excess_of_static_friction():
    assert sawtooth(0.5) == pytest.approx(1.0, rel=0.02)
    assert sawtooth(0.0) < 0.005


@pytest.mark.parametrize("pattern", ["regular", "irregular"])
def test_forces_on_a_tip_that_sticks(pattern):
    np.testing.assert_allclose(sticking(pattern, (40, 4)), [pressed(eps) for eps in STICKING], rtol=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("mu", ONSET)
def test_a_tip_slips_where_geometry_reaches_the_friction(mu):
    assert onset(mu, "irregular", (40, 4)) == pytest.approx(ONSET[mu], rel=0.02)
