"""Rows that repeat the one before: of a driver that publishes too often, not of a hand that stands still."""

from __future__ import annotations

import numpy as np

from sysid.observations.checks.repeated import repeats


def test_a_hand_that_stands_still_is_not_left_out_where_its_motion_repeats_itself() -> None:
    """Each pose three times while it moves, and 110 times the same one then: that is no gap."""
    moving = np.repeat(np.random.default_rng(0).standard_normal((60, 7)), 3, axis=0)
    again = repeats(np.vstack([moving, np.repeat(moving[-1:], 110, axis=0), moving[::-1]]))
    assert again[:177].sum() == 2 * 59
    assert not again[180:288].any()
    assert again[-177:].sum() == 2 * 59
