"""Where a search ends is reported, and it is gone on from where intervals show a better fit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from readings import TRUTH, Readings, T, result_of, run_of

from sim_core.rigs import with_parameters
from sim_core.simulate import Trace
from sysid.fit import FitOptions, fit
from sysid.fit import multistart as starts
from sysid.fit.options import Intervals
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.predictor import Prediction
from sysid.observations.observations import Run
from sysid.settings.uncertainty import UNCERTAINTY
from sysid.solve.residuals import Problem
from sysid.uncertainty.profiler import Profiler

pytestmark = pytest.mark.usefixtures("declared")


class Bent(Readings):
    """It reads the more, the further log(E) is from that of the truth on either side."""

    def _predict(self, run: Run, young: float, p: int) -> Prediction:
        away = float(np.log(young / TRUTH))
        values = (np.log(TRUTH) + 1.0 + abs(away)) * np.sin(6.0 * T)[:, None]
        slopes = np.repeat(np.copysign(1.0, away) * np.sin(6.0 * T)[:, None, None], p, axis=2)
        return Prediction(
            {m.channel: values for m in run.measured}, {m.channel: slopes for m in run.measured}, cast(Trace, None)
        )


def test_a_search_that_ends_at_a_kink_is_noted(small_rig: Any) -> None:
    """Readings are lower than any value of E explains, so the best is where the derivative jumps."""
    result = result_of(Bent(), small_rig(), [run_of("press", "markers")], [])
    assert result.estimates[0].value == pytest.approx(TRUTH, rel=0.01)
    assert any("stands at a kink" in note for note in result.notes) and "stands at a kink" in result.table()
    smooth = result_of(Readings(), small_rig(), [run_of("press", "markers")], [])
    assert not any("kink" in note for note in smooth.notes)


@pytest.mark.parametrize("intervals", ["checked", "profiled"])
def test_a_search_that_ended_too_early_goes_on_from_the_better_fit_that_intervals_show(
    intervals: Intervals, small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first search calls its start, which is 1 % off, the best."""
    plain, calls = Problem.fit, 0

    def early(problem: Problem, rig: Any, parameters: Any, start: Any, *given: Any, **more: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == 1:
            return problem.evaluate(rig, parameters, start)
        return plain(problem, rig, parameters, start, *given, **more)

    monkeypatch.setattr(Problem, "fit", early)
    monkeypatch.setattr(starts, "UNCERTAINTY", replace(UNCERTAINTY, good_misfit=1e9))
    options = FitOptions(nuisance=("none",), intervals=intervals, robust=False)
    rig = with_parameters(small_rig(), {"gel.E_pa": 1.01 * TRUTH})
    shares: list[float] = []
    result, _ = fit.fit_runs(
        rig, [run_of("press", "markers")], ["gel.E"], options, engine=cast(ParallelPredictor, Readings()),
        on_progress=lambda share, text: shares.append(share),
    )  # fmt: skip
    assert shares == sorted(shares)
    assert result.estimates[0].value == pytest.approx(TRUTH, rel=0.004) and result.converged
    assert not any("too early" in sentence for sentence in result.identifiability)


def test_a_search_that_ends_too_early_each_time_has_not_converged(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        Problem, "fit", lambda problem, rig, parameters, start, *_, **__: problem.evaluate(rig, parameters, start)
    )
    monkeypatch.setattr(Profiler, "better", property(lambda profiler: profiler._best.scaled + 1e-4))
    rig = with_parameters(small_rig(), {"gel.E_pa": 1.01 * TRUTH})
    options = FitOptions(nuisance=("none",), robust=False)
    runs, engine = [run_of("press", "markers")], cast(ParallelPredictor, Readings())
    result, _ = fit.fit_runs(rig, runs, ["gel.E"], options, engine=engine)
    assert not result.converged and "a better fit is known" in result.message
    assert "did not converge" in result.table()
