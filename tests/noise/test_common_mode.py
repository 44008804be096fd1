"""A shaking camera moves all markers together: it is separated from their own noise, and does not count for each of
them."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.common_mode import CommonMode, CommonWhitening, modes
from sysid.noise.common_mode_estimate import common_mode
from sysid.noise.whitening import whiten
from sysid.observations.observations import Measured, Run
from sysid.solve.residuals import Problem

MARKERS, OWN_PX, SHAKE_PX, RHO = 40, 0.08, 0.15, 0.8
PLACES = np.random.default_rng(5).uniform(0.0, 600.0, 2 * MARKERS)
RATE_HZ = 30.0


def shaken(rng: np.random.Generator, frames: int, shake_px: float = SHAKE_PX) -> np.ndarray:
    """Noise of pictures ``(n, 2 N)``: white for each marker, first-order autoregressive for the whole picture."""
    shift = np.zeros((frames, 2))
    shift[0] = shake_px * rng.standard_normal(2)
    for k in range(1, frames):
        shift[k] = RHO * shift[k - 1] + shake_px * np.sqrt(1.0 - RHO**2) * rng.standard_normal(2)
    return OWN_PX * rng.standard_normal((frames, 2 * MARKERS)) + np.tile(shift, MARKERS)


def stretches(shake_px: float, seed: int = 0, mistakes: float = 0.0) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(6):
        values = PLACES + shaken(rng, 120, shake_px)
        values += 6.0 * rng.standard_normal(values.shape) * (rng.random(values.shape) < mistakes)
        values[rng.random(values.shape) < mistakes] = np.nan
        found.append((values, np.arange(120) / RATE_HZ))
    return found


@pytest.mark.parametrize("mistakes", [0.0, 0.02])
def test_a_shake_is_separated_from_the_noise_of_the_markers(mistakes: float) -> None:
    found = common_mode(stretches(SHAKE_PX, mistakes=mistakes))
    assert found is not None
    assert found.sigma == pytest.approx(OWN_PX, rel=0.03)
    assert (found.rho == 0.0).all()
    of_shift = (MARKERS * SHAKE_PX**2) * (1.0 + RHO) / (1.0 - RHO) + OWN_PX**2
    assert found.shares[:2] == pytest.approx(OWN_PX / np.sqrt(of_shift), rel=0.25)
    # It neither turns nor zooms: what chance shows of that is less than the markers' own noise.
    assert (found.shares[2:] ** -2 - 1.0 < 1.0).all()


def test_a_short_rest_shows_how_much_a_picture_turns() -> None:
    """Two rests of 20 pictures, too short to show the colour of the noise: over 40 recordings the variance of the turn
    is as often too large as too small within a factor of four, and it is hardly ever missed."""
    turn_rad = 4e-4
    about = PLACES.reshape(-1, 2) - PLACES.reshape(-1, 2).mean(axis=0)
    moved = np.stack([-about[:, 1], about[:, 0]], axis=1).ravel()
    true = turn_rad**2 * np.sum(moved**2) / OWN_PX**2 * (1.0 + RHO) / (1.0 - RHO)
    found = []
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        rests = []
        for _ in range(2):
            turn = turn_rad * rng.standard_normal(20)
            for k in range(1, 20):
                turn[k] = RHO * turn[k - 1] + np.sqrt(1.0 - RHO**2) * turn[k]
            values = PLACES + OWN_PX * rng.standard_normal((20, 2 * MARKERS)) + turn[:, None] * moved
            rests.append((values, np.arange(20) / RATE_HZ))
        common = common_mode(rests)
        found.append(0.0 if common is None else common.shares[2] ** -2 - 1.0)
    assert 0.25 < np.median(found) / true < 4.0
    assert np.mean(np.array(found) < 0.1 * true) <= 0.1


def test_markers_with_noise_of_their_own_have_nothing_in_common() -> None:
    assert common_mode(stretches(0.0)) is None


def test_modes_are_orthonormal_whatever_is_seen() -> None:
    seen = np.random.default_rng(1).random((20, 2 * MARKERS)) < 0.8
    seen = np.repeat(seen[:, ::2], 2, axis=1)
    seen[0] = False
    seen[0, :6] = True
    h = modes(PLACES, seen)
    assert (h[0] == 0.0).all(), "three markers are too few"
    np.testing.assert_allclose(np.einsum("nkm,njm->nkj", h, h)[1:], np.broadcast_to(np.eye(4), (19, 4, 4)), atol=1e-12)
    assert (h[:, :, :][~np.broadcast_to(seen[:, None], h.shape)] == 0.0).all()


def test_a_motion_of_the_whole_picture_is_known_as_well_as_the_shake_allows() -> None:
    """The amplitude of a drift of all markers, estimated from many recordings: its standard deviation is what least
    squares say. With markers as independent witnesses they say a seventh of it."""
    rng = np.random.default_rng(2)
    frames = 300
    t = np.arange(frames) / RATE_HZ
    drift = np.tile(np.stack([t / t[-1], 0.0 * t], axis=1), MARKERS)
    common = common_mode(stretches(SHAKE_PX))
    assert common is not None
    seen = np.ones(drift.shape, dtype=bool)
    own = ChannelNoise(common.sigma, common.rho, "")
    total = ChannelNoise(np.full(2 * MARKERS, np.hypot(OWN_PX, SHAKE_PX)), np.full(2 * MARKERS, 0.62), "")

    def deviations(noise: ChannelNoise, shake: CommonMode | None) -> float:
        known = CommonWhitening(shake.deviations(PLACES, seen) if shake else np.zeros((frames, 0, 2 * MARKERS)))
        column = known(whiten(drift, noise, t))
        scores = []
        for _ in range(150):
            miss = known(whiten(shaken(rng, frames), noise, t))
            scores.append(np.sum(column * miss) / np.sqrt(np.sum(column**2)))
        return float(np.std(scores))

    assert deviations(own, common) == pytest.approx(1.0, abs=0.25)
    assert deviations(total, None) > 4.0


def test_fits_and_verdicts_weigh_what_markers_have_in_common() -> None:
    """A shift of the whole picture counts as the shake lets it, in residuals and where misfit is judged; what moves one
    marker alone counts in full."""
    common = common_mode(stretches(SHAKE_PX))
    assert common is not None
    t = np.arange(50) / RATE_HZ
    sigma = np.full(2 * MARKERS, np.hypot(OWN_PX, SHAKE_PX))
    noise = {"below": ChannelNoise(sigma, np.full(2 * MARKERS, 0.6), "", common=common)}
    shift, alone = np.zeros((50, 2 * MARKERS)), np.zeros((50, 2 * MARKERS))
    shift[:, ::2], alone[:, 7] = OWN_PX, OWN_PX
    places = np.tile(PLACES, (50, 1))
    for away, count in ((shift, MARKERS * common.shares[0] ** 2), (alone, 1.0)):
        measured = Measured("below", "tracks", t, places + away, tuple(f"c{k}" for k in range(2 * MARKERS)))
        problem = Problem([Run("run", "", (), {}, (measured,), float(t[-1]))], noise, cast(Any, None))
        residual = problem.assemble([Prediction({"below": places}, {}, cast(Any, None))], []).residual
        assert np.sum(residual**2) == pytest.approx(50 * count, rel=0.1)
        assert np.nansum(problem.judged(0, measured, away) ** 2) == pytest.approx(50 * count, rel=0.1)
