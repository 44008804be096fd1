"""Effects are screened beside a discretisation error that changes with the baseline's parameters."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any, cast

import numpy as np
import pytest

from sim_core.effects import effect_by_name
from sim_core.simulate import Trace
from sysid.diagnosis import hypotheses as candidates
from sysid.diagnosis.hypotheses import screen
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import Prediction
from sysid.noise.estimate import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 1.0, 200)
SIGMA, AMOUNT = 0.01, 0.05
MATERIAL, LAW, OWN = np.sin(6.0 * T)[:, None], np.cos(6.0 * T)[:, None], 0.01 * np.sin(20.0 * T)[:, None]


class Linear:
    """Reads log(E) sin without the effect; with it also ``AMOUNT`` times cos, all of what is missing."""

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        return [Prediction({"gauge": scaled[0] * MATERIAL}, {"gauge": MATERIAL[:, :, None]}, cast(Trace, None))]

    def submit_with_derivatives(self, rig: Any, run: Run, own: Any, scaled: np.ndarray) -> Future[Prediction]:
        found: Future[Prediction] = Future()
        values = np.log(rig.bodies["gel"].material.E_pa) * MATERIAL + AMOUNT * LAW
        slopes = np.zeros((len(T), 1, len(own)))
        found.set_result(Prediction({"gauge": values}, {"gauge": slopes}, cast(Trace, None)))
        return found


def test_the_discretisation_error_is_that_of_the_baseline(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The discretisation error has slopes and was measured a little beside: what an effect promises is the chi-square
    of what is missing, no more."""
    rig = small_rig()
    monkeypatch.setattr(candidates, "all_effects", lambda: {"gel_relaxation": effect_by_name("gel_relaxation")})
    parameters = fit_parameters(rig, ["gel.E"])
    at = start_of(rig, parameters)
    slopes = np.full((len(T), 1, 1), 0.3)
    known = ErrorShape("mesh", ({"gauge": OWN},), slopes=({"gauge": slopes},), at=at + 0.2)
    error = known.mean * (OWN + slopes[:, :, 0] * (at - known.at))
    noise = SIGMA * np.random.default_rng(1).standard_normal(OWN.shape)
    data = at[0] * MATERIAL + AMOUNT * LAW + error + noise
    run = Run("press", "press", (), {}, (Measured("gauge", "markers", T, data, ("u",)),), 1.0)
    engine = cast(Any, Linear())
    beside = Problem([run], {"gauge": ChannelNoise(np.array([SIGMA]), 0.0, "test")}, engine, [known], prior=True)
    base = beside.evaluate(rig, parameters, at)
    starts, failed = screen(engine, beside, base)
    assert not failed and len(starts) > 1
    missing = base.chi2 - float(np.sum((noise / SIGMA) ** 2))
    for start in starts:
        assert start.scaled[0] == pytest.approx(at[0], abs=0.01)
        assert start.gain == pytest.approx(missing, rel=0.1)
