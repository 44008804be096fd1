"""Glitches of a force sensor are found and left out; contact, however short, is not."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from sim_core.simulate import Trace
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.solve.outliers import without_outliers
from sysid.solve.wrench_spikes import spikes

N, RATE = 400, 100.0
T = np.arange(N) / RATE
SIGMA = np.repeat([0.01, 1e-3], 3)
LABELS = tuple(f"{q} {a}" for q in ("force", "torque") for a in "xyz")
SMOOTH = np.outer(1.0 - np.cos(3.0 * T), [0.5, 0.1, 3.0, 0.02, 0.05, 0.001])
NOISE = SIGMA * np.random.default_rng(1).standard_normal((N, 6))
PUSH = np.array([0.2, 0.0, 1.0, 0.0, 0.03, 0.0])


def found(miss: np.ndarray, predicted: np.ndarray | None = None) -> np.ndarray:
    predicted = SMOOTH if predicted is None else predicted
    return spikes(Measured("gauge", "wrench", T, SMOOTH + NOISE + miss, LABELS), predicted, SIGMA)


def test_clean_readings_lose_nothing() -> None:
    assert not found(np.zeros((N, 6))).any()
    exact = Measured("gauge", "wrench", T, SMOOTH, LABELS)
    assert not spikes(exact, SMOOTH, SIGMA).any()


@pytest.mark.parametrize("size", [40.0, 100.0, 1e4])
@pytest.mark.parametrize("astray", [0.0, 0.3], ids=["a good model", "a model that is off"])
def test_glitches_are_found_in_their_component(size: float, astray: float) -> None:
    miss = astray * SMOOTH
    true = np.zeros((N, 6), dtype=bool)
    for k, c, sign in ((40, 0, 1), (170, 4, -1), (250, 2, 1), (333, 2, -1)):
        true[k, c] = True
        miss[k, c] += sign * size * SIGMA[c]
    np.testing.assert_array_equal(found(miss), true)


def test_a_packet_that_is_wrong_in_all_components_is_found() -> None:
    miss = np.zeros((N, 6))
    miss[100] = 300.0 * SIGMA * [1, -1, 1, 1, -1, 1]
    mask = found(miss)
    assert mask[100].all() and mask.sum() == 6


def ring_down(hertz: float, tau: float, at: float = 2.0) -> np.ndarray:
    since = np.maximum(T - at, 0.0)
    return np.outer((at <= T) * np.exp(-since / tau) * np.cos(2.0 * np.pi * hertz * since), 2.0 * PUSH)


def impact(samples: int, after: float) -> np.ndarray:
    """A half sine over so many samples of 3 N, and ``after`` [N] for good."""
    shape = np.zeros(N)
    shape[200 : 200 + samples] = 3.0 * np.sin(np.pi * (np.arange(samples) + 0.5) / samples)
    shape[200 + samples :] = after
    return np.outer(shape, PUSH)


def bounces() -> np.ndarray:
    """Impacts within single samples, each 0.8 times as strong and as long in flight as the one before."""
    shape, flight, at = np.zeros(N), 0.8, 0.3
    strength = 3.0
    while at < 3.9 and flight > 0.15:
        shape[int(at * RATE)] = strength
        at, flight, strength = at + flight, 0.8 * flight, 0.8 * strength
    return np.outer(shape, PUSH)


STICK_SLIP = np.outer(0.5 * ((4.0 * T) % 1.0), PUSH)

CONTACT = {
    "ring-down of 10 Hz": ring_down(10.0, 0.1),
    "ring-down of 49 Hz": ring_down(49.0, 0.05),
    "ring-down of 25 Hz in 10 ms": ring_down(25.0, 0.01),
    "decay in 10 ms": ring_down(0.0, 0.01),
    "decay in 5 ms": ring_down(0.0, 0.005),
    "impact of 2 samples": impact(2, 0.0),
    "impact of 5 samples": impact(5, 0.0),
    "impact within a sample that ends at rest": impact(1, 0.1),
    "step": impact(0, 1.0),
    "bounces": bounces(),
    "stick-slip": STICK_SLIP,
}


@pytest.mark.parametrize("name", list(CONTACT))
def test_contact_stays(name: str) -> None:
    assert not found(CONTACT[name]).any()


def test_an_impact_that_is_predicted_stays() -> None:
    """Though it is only half as strong, and so short that it is sampled once."""
    assert not found(impact(1, 0.0), SMOOTH + 0.5 * impact(1, 0.0)).any()
    assert found(impact(1, 0.0)).any()


def test_what_is_missing_is_no_spike() -> None:
    miss = np.zeros((N, 6))
    miss[100:110] = np.nan
    miss[0] = miss[-1] = 1.0
    assert not found(miss).any()
    miss[:, 3:] = np.nan
    miss[200, 2] = 1.0
    assert found(miss).sum() == 1


def test_what_was_left_out_is_reported() -> None:
    miss = np.zeros((N, 6))
    miss[120, 2], miss[250, 2], miss[250, 4] = 1.0, -1.0, 0.1
    values = SMOOTH + NOISE + miss
    run = Run("press", "", (), {}, (Measured("gauge", "wrench", T, values, LABELS),), T[-1])
    prediction = Prediction({"gauge": SMOOTH}, {}, cast(Trace, None))
    noise = {"gauge": ChannelNoise(SIGMA, 0.0, "known")}
    (clean,), (excluded,) = without_outliers([run], [prediction], noise)
    assert excluded.markers == {"force z": [1.2, 2.5], "torque y": [2.5]} and not excluded.kept
    assert excluded.sentence == (
        "press: 0.12 % of the readings of gauge are single spikes, treated as outliers: force z (2 from 1.20 s), "
        "torque y (at 2.50 s)."
    )
    assert "mistakes of the sensor" in excluded.sentence_of_score
    gone = np.isnan(clean.measured[0].values)
    np.testing.assert_array_equal(gone, miss != 0.0)
    tracks = replace(run, measured=(replace(run.measured[0], values=SMOOTH + NOISE),))
    assert without_outliers([tracks], [prediction], noise) == ([tracks], [])
