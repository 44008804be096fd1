"""What a rig declares as noise is a lower bound of what is estimated from recordings."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.rigs import load_rig
from sysid.fit.noise import ChannelNoise, at_least, declared_noise


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
        # Within what an estimate scatters: only the size is raised.
        (0.3, 0.3, 0.6, "quiet stretches, at least as declared"),
        # The estimate is of something else: its colour goes too.
        (0.5, 0.5, 0.0, "declared by the rig"),
    ],
)
def test_declared_noise_is_a_lower_bound(declared: float, sigma: float, rho: float, source: str) -> None:
    noise = at_least(ChannelNoise(np.full(4, 0.2), 0.6, "quiet stretches"), np.array([declared]))
    np.testing.assert_array_equal(noise.sigma, np.full(4, sigma))
    assert (noise.rho, noise.source) == (rho, source)
