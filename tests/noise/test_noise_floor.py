"""What a rig declares as noise replaces what is estimated from recordings only when it is much larger."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.rigs import load_rig
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import FROM_DIFFERENCES, channel_noise, declared_noise, overruled, unless_larger
from sysid.observations.observations import Measured, Run


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
    np.testing.assert_array_equal(noise.rho, np.full(4, rho))
    assert noise.source == source


def test_what_recordings_show_against_a_declared_noise_is_said() -> None:
    """The force is declared a hundred times too noisy, the torque as it is."""
    values = np.random.default_rng(0).standard_normal((300, 6)) * np.repeat([0.02, 0.01], 3)
    run = Run("run", "", (), {}, (Measured("cell", "wrench", np.arange(300) / 50.0, values, ("",) * 6),), 6.0)
    shown = ChannelNoise(np.repeat([0.02, 0.01], 3), 0.0, "quiet stretches")
    (said,) = overruled([run], {"cell": unless_larger(shown, np.repeat([2.0, 0.01], 3))})
    assert said.startswith("The noise of the force of cell is 2 N, as the rig declares; recordings show 0.02 N.")
    assert overruled([run], {"cell": unless_larger(shown, np.repeat([0.02, 0.01], 3))}) == []


@pytest.mark.parametrize(("pause", "source"), [(1.0 / 30.0, FROM_DIFFERENCES), (7.0, "declared by the rig")])
def test_readings_far_apart_do_not_tell_their_noise(pause: float, source: str) -> None:
    # Single states, as of presses that have nothing to do with each other: they differ by 5 px, the noise is 0.1 px.
    values = np.random.default_rng(0).normal(0.0, 5.0, (8, 54))
    tracks = Measured("outside", "tracks", pause * np.arange(8), values, ("",) * 54)
    run = Run("presses", "", (), {}, (tracks,), float(tracks.t[-1]))
    noise = channel_noise(load_rig("card_press"), [run])["outside"]
    assert noise.source == source
    assert noise.sigma.shape == (54,)
    expected = 0.1 if source == "declared by the rig" else 5.0
    np.testing.assert_allclose(noise.sigma, expected, rtol=0.3)


def test_held_out_recordings_tell_the_noise_only_of_channels_that_they_alone_have() -> None:
    """The held-out recording is ten times noisier, and has a camera in addition."""
    rig, rng = load_rig("card_press"), np.random.default_rng(1)
    t = np.arange(300) / 30.0
    quiet_one, noisy = (
        Measured("gel_markers", "markers", t, sigma * rng.standard_normal((300, 12)), ("",) * 12)
        for sigma in (1e-3, 1e-2)
    )
    tracks = Measured("outside", "tracks", t, rng.standard_normal((300, 54)), ("",) * 54)
    fitted = Run("fitted", "", (), {}, (quiet_one,), float(t[-1]))
    held_out = Run("held out", "", (), {}, (noisy, tracks), float(t[-1]))
    alone, both = channel_noise(rig, [fitted]), channel_noise(rig, [fitted], [held_out])
    np.testing.assert_array_equal(both["gel_markers"].sigma, alone["gel_markers"].sigma)
    np.testing.assert_allclose(alone["gel_markers"].sigma, 1e-3, rtol=0.1)
    assert set(both) == {"gel_markers", "outside"}
    np.testing.assert_allclose(both["outside"].sigma, 1.0, rtol=0.1)
