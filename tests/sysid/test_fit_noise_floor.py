"""What a rig declares as noise replaces what is estimated from recordings only when it is much larger."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.rigs import load_rig
from sysid.fit.noise import ChannelNoise, declared_noise, unless_larger


def test_declared_noise_has_the_units_of_the_channel() -> None:
    rig = load_rig("card_press")
    np.testing.assert_array_equal(declared_noise(rig, "wrench_gel"), [0.002] * 3 + [1e-5] * 3)
    np.testing.assert_array_equal(declared_noise(rig, "gel_markers"), [1e-5])
    np.testing.assert_array_equal(declared_noise(rig, "outside"), [0.1])


@pytest.mark.parametrize(
    ("declared", "sigma", "rho", "source"),
    [
        (0.0, 0.2, 0.6, "quiet stretches"),
        (0.1, 0.2, 0.6, "quiet stretches"),
        # Within what a data sheet is wrong by: the recording knows better.
        (0.3, 0.2, 0.6, "quiet stretches"),
        # The estimate is of something else: its colour goes too.
        (0.5, 0.5, 0.0, "declared by the rig"),
    ],
)
def test_declared_noise_counts_when_it_is_much_larger(declared: float, sigma: float, rho: float, source: str) -> None:
    noise = unless_larger(ChannelNoise(np.full(4, 0.2), 0.6, "quiet stretches"), np.array([declared]))
    np.testing.assert_array_equal(noise.sigma, np.full(4, sigma))
    assert (noise.rho, noise.source) == (rho, source)
