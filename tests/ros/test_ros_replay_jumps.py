"""A measured pose that jumped within what is allowed, and leaves it later: the jump is what is wrong. Needs no ROS."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from thinshell_ros.replay.tracking import Placed, Track, TrackingLimits

SPEED_M_S, STOPS_S = 0.01, 0.6


def placed(z: float) -> Placed:
    return Placed((0.0, 0.0, z), (0.0, 0.0, 0.0, 1.0))


def said(measured: Callable[[float], float]) -> str:
    """The first thing that is wrong with a hand that goes up and stops, by what is measured of its height [m] when."""
    track = Track("hand", TrackingLimits(0.002, 0.005, 0.1, SPEED_M_S, 0.0))
    track.begin(0.0, placed(0.0))
    for k in range(1, 100):
        t = 0.01 * k
        track.command(t, placed(SPEED_M_S * min(t, STOPS_S)))
        if wrong := track.judge(t, t, placed(measured(t))):
            return wrong
    return ""


def planned(t: float) -> float:
    return SPEED_M_S * min(t, STOPS_S)


def test_a_jump_that_shows_when_the_hand_stops_is_named() -> None:
    wrong = said(lambda t: planned(t) - (0.0025 if t > 0.5 else 0.0))
    assert wrong.startswith("The measured pose of hand jumped by 0.0024 m within 0.01 s")
    assert wrong.endswith("away from where its commands were since.")


@pytest.mark.parametrize(("off_m", "begin_s", "end_s"), [(0.0015, 0.3, 0.35), (0.001, 0.05, 9.0)], ids=["back", "past"])
def test_a_jump_that_was_taken_back_or_is_long_past_is_no_cause(off_m: float, begin_s: float, end_s: float) -> None:
    """The hand stands still from 0.2 s on, which is too far behind from 0.4 s on, or a little later."""
    wrong = said(lambda t: planned(min(t, 0.2)) - (off_m if begin_s < t <= end_s else 0.0))
    assert wrong.startswith("hand has stood still for "), wrong
