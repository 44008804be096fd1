"""Round-off of differences to one side, where a number cannot be below zero."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.gradients.beyond import EDGE, MIDDLE, _amplified
from sysid.gradients.differences import slope_of


@pytest.mark.parametrize("ends", [MIDDLE, EDGE])
def test_round_off_of_slopes_is_recognised_by_what_is_left_of_a_straight_line(ends: tuple[float, float]) -> None:
    """Values that are zero but for round-off: the slope of the parabola through them, over their distance from a line,
    as of many draws; 1 for a step to both sides."""
    values = np.random.default_rng(0).standard_normal((3, 100_000))

    def drawn(a: float, b: float) -> float:
        bent = (values[1] - values[0]) - (values[2] - values[0]) * a / b
        return float(np.std(slope_of(*values, a, b)) / np.std(bent))

    assert _amplified(*ends) == pytest.approx(drawn(*ends) / drawn(*MIDDLE), rel=0.02)
    assert (_amplified(*ends) > 5.0) == (ends == EDGE)
