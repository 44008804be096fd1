"""By what held-out recordings are predicted, and what they are compared with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from strip import START, TRUTH, pulled, strip_rig

from sim_core.rigs import with_parameters
from sysid.fit import FitOptions, fit_runs
from sysid.model.parallel_predictor import ParallelPredictor

RIG = strip_rig()


def test_they_are_predicted_as_recordings_usually_are_and_judged_with_the_discretisation_error(
    workers: ParallelPredictor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rig that predicts them, and is returned, has the usual clocks: here one that is a fifth of a second late."""
    (gauge,) = RIG.sensors
    late = {f"{gauge}.latency_s": 0.2}
    monkeypatch.setattr("sysid.fit.fit.with_mean_nuisances", lambda rig, found: with_parameters(rig, late))
    runs = [replace(pulled(RIG, TRUTH, tmp_path / name, seed=k), name=name) for k, name in enumerate(("one", "two"))]
    options = FitOptions(nuisance=("none",), intervals="quadratic")
    result, rig = fit_runs(
        with_parameters(RIG, START), runs[:1], list(TRUTH), options, held_out=runs[1:], engine=workers
    )
    assert rig.sensors[gauge].latency_s == 0.2
    used, kept = ([e for e in result.errors if e.channel == gauge and e.held_out == held] for held in (False, True))
    assert kept[0].after > 3.0 * used[0].after, "predicted a fifth of a second late"
    assert kept[0].own == used[0].own > 0.0
