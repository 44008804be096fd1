"""Instants of the steps of a rollout."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.simulate import step_times


@pytest.mark.parametrize(
    ("end", "lengths"),
    [
        (0.4, [0.1, 0.1, 0.1, 0.1]),
        (0.35, [0.1, 0.1, 0.075, 0.075]),
        (0.301, [0.1, 0.1, 0.0505, 0.0505]),  # no sliver, which would make rates of its own
        (0.15, [0.075, 0.075]),
        (0.04, [0.04]),
    ],
)
def test_steps_are_those_of_the_rig_but_for_the_last_two(end, lengths):
    """A recording that was simulated with these steps is followed step by step, wherever it is cut."""
    times = step_times(1.0, 1.0 + end, 0.1)
    assert times[0] == 1.0 and times[-1] == 1.0 + end
    np.testing.assert_allclose(np.diff(times), lengths, atol=1e-12)
