"""Two models on readings that neither was fitted to, of which one may hide some."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.simulate import Trace
from sysid.diagnosis import validation as heldout
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 1.0, 400)
SIGMA = 0.01
CLEAN = np.column_stack([T, np.cos(2.0 * T)])
OWN = 0.05 * np.column_stack([np.sin(9.0 * T), np.cos(7.0 * T)])
BAD = slice(180, 216)


@pytest.fixture
def check(monkeypatch: pytest.MonkeyPatch) -> Problem:
    """Readings of which some are off by 15 standard deviations, with a discretisation error that may take part of that
    up."""
    monkeypatch.setattr("sysid.solve.residuals.rig_at", lambda rig, *_: rig)
    values = CLEAN + SIGMA * np.random.default_rng(1).standard_normal(CLEAN.shape)
    values[BAD] += 15.0 * SIGMA
    run = Run("run", "", (), {}, (Measured("gauge", "markers", T, values, ("u", "v")),), 1.0)
    noise = {"gauge": ChannelNoise(np.full(2, SIGMA), 0.3, "test")}
    return Problem([run], noise, cast(ParallelPredictor, None), [ErrorShape("mesh", ({"gauge": OWN},))])


def model(check: Problem, values: np.ndarray) -> Fitted:
    prediction = Prediction({"gauge": values}, {}, cast(Trace, None))
    return check.compare([prediction], cast(Any, SimpleNamespace()), [], np.zeros(0))


def test_hiding_readings_is_no_gain_and_seeing_them_no_loss(check: Problem) -> None:
    hidden = CLEAN.copy()
    hidden[BAD] = np.nan
    plain, hiding = model(check, CLEAN), model(check, hidden)
    assert hiding.misfit < 0.7 * plain.misfit
    assert heldout.gain_of(heldout.seen_by_both(check, plain, hiding)) == pytest.approx(0.0, abs=1e-9)
    assert heldout.gain_of(heldout.seen_by_both(check, hiding, plain)) == pytest.approx(0.0, abs=1e-9)
    both = heldout.seen_by_both(check, plain, hiding)
    assert both is not None and both[0].misfit == pytest.approx(hiding.misfit)


def test_a_model_that_is_better_where_both_see_gains(check: Problem) -> None:
    right, wrong = CLEAN.copy(), CLEAN + 5.0 * SIGMA * T[:, None] ** 3
    right[BAD] += 15.0 * SIGMA
    found = heldout.gain_of(heldout.seen_by_both(check, model(check, wrong), model(check, right)))
    assert found is not None and found > 0.3
    assert heldout.seen_by_both(check, model(check, CLEAN * np.nan), model(check, right)) is None
    assert heldout.gain_of(None) is None


def test_the_share_beyond_noise_that_is_gone() -> None:
    """Of a mean square of 5, where noise is 1, all is gone at 1 and below, half at 3, nothing at 5 and above."""

    def missed(square: float) -> Fitted:
        return cast(Fitted, SimpleNamespace(residual=np.full(50, np.sqrt(square)), pulls=0, samples=50))

    shares = [heldout.beyond_noise(missed(5.0), missed(square)) for square in (0.8, 1.0, 3.0, 5.0, 7.0)]
    assert shares == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0])
