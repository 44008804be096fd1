"""A search on a coarse model with what a fine one adds ends where the fine one's does."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sysid.model.predictor import Prediction
from sysid.model.space_mapping import SpaceMappedPredictor, additions, mapped
from sysid.observations.observations import Run

T = np.linspace(0.0, 1.0, 40)
RUN = Run("press", "press", (), {}, (), 1.0)


def fine(theta: float) -> np.ndarray:
    return cast(np.ndarray, (theta * T**1.5 + 0.1 * theta**2 * T)[:, None])


def coarse(theta: float) -> np.ndarray:
    """Five to eight percent off, by another share at another place."""
    return cast(np.ndarray, fine(theta) * (1.05 + 0.03 * T[:, None]))


class Coarse:
    """Predicts by the coarse model; nothing where the parameter is negative."""

    def _made(self, theta: float) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        if theta < 0.0:
            future.set_exception(ConvergenceError("It does not converge.", "Shorten the step."))
        else:
            slope = (coarse(theta + 1e-6) - coarse(theta - 1e-6)) / 2e-6
            future.set_result(Prediction({"gauge": coarse(theta)}, {"gauge": slope[..., None]}, cast(Any, None)))
        return future

    def submit(self, rig: Any, run: Any, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        return self._made(rig)

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        return [self._made(float(scaled[0])).result() for _ in runs]


def engine_at(theta: float) -> SpaceMappedPredictor:
    pair = [Prediction({"gauge": model(theta)}, {}, cast(Any, None)) for model in (coarse, fine)]
    return SpaceMappedPredictor(cast(Any, Coarse()), additions([RUN], [pair[0]], [pair[1]]))


def test_where_it_was_measured_it_is_the_fine_model() -> None:
    engine = engine_at(1.3)
    np.testing.assert_allclose(engine.submit(cast(Any, 1.3), RUN).result().values["gauge"], fine(1.3), rtol=1e-14)
    (found,) = engine.predict_all(cast(Any, None), [RUN], [], np.array([1.3]))
    np.testing.assert_allclose(found.values["gauge"], fine(1.3), rtol=1e-14)
    assert found.derivatives["gauge"].shape == (40, 1, 1)


def test_a_search_on_it_ends_at_the_truth_after_it_is_measured_again() -> None:
    """The coarse model alone ends 6 % off."""
    truth, theta, ends = fine(1.2), 1.0, []
    for _ in range(3):
        engine = engine_at(theta)
        for _ in range(10):
            (found,) = engine.predict_all(cast(Any, None), [RUN], [], np.array([theta]))
            slope = found.derivatives["gauge"][:, 0, 0]
            theta += float(slope @ (truth - found.values["gauge"])[:, 0] / (slope @ slope))
        ends.append(abs(theta - 1.2))
    assert ends[0] < 0.015 and ends[1] < 0.002 and ends[2] < 2e-4


def test_what_is_out_of_sight_stays_so_and_other_runs_have_nothing_added() -> None:
    values = coarse(1.0)
    values[3] = np.nan
    here = Prediction({"gauge": fine(1.0)}, {}, cast(Any, None))
    there = Prediction({"gauge": values}, {}, cast(Any, None))
    added = additions([RUN], [there], [here])
    assert added["press"]["gauge"][3] == 0.0
    assert np.isnan(mapped(there, RUN, added).values["gauge"][3]).all()
    other = Run("slide", "slide", (), {}, (), 1.0)
    np.testing.assert_array_equal(mapped(there, other, added).values["gauge"], values)


def test_a_simulation_that_fails_is_reported() -> None:
    with pytest.raises(ConvergenceError, match="does not converge"):
        engine_at(1.0).submit(cast(Any, -1.0), RUN).result()
