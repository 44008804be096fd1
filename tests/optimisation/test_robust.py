"""Fits of recordings in which a tracker makes mistakes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from strip import PULL, START, TRUTH, pulled, strip_rig

from sim_core.rigs import with_parameters
from sim_core.rigs.motion import compile_experiment
from sysid.fit import FitOptions, FitResult, fit, fit_runs
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.observations.observations import Run
from sysid.report import write_fit_report

RIG = strip_rig()
PLAIN = FitOptions(nuisance=("none",), intervals="quadratic")
FRAMES = int(np.floor(max(p.times[-1] for p in compile_experiment(PULL, RIG).values()) * 30.0 + 1e-9)) + 1


def blurred() -> np.ndarray:
    """5 px away from the middle line of 5 % of the readings, while the strip moves ``(FRAMES, 33, 2)``."""
    rng = np.random.default_rng(8)
    jumps = np.zeros((FRAMES, 33, 2))
    moving = np.arange(FRAMES) > 0.3 * 30
    hit = (rng.uniform(size=(FRAMES, 33)) < 0.05 / np.mean(moving)) & moving[:, None]
    jumps[hit, 1] = np.broadcast_to(np.tile([-5.0, 0.0, 5.0], 11), (FRAMES, 33))[hit]
    return jumps


@pytest.fixture(scope="module")
def dirty(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return pulled(RIG, TRUTH, tmp_path_factory.mktemp("dirty") / "bag", jumps=blurred())


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return pulled(RIG, TRUTH, tmp_path_factory.mktemp("clean") / "bag")


def fitted(run: Run, robust: bool, workers: ParallelPredictor) -> FitResult:
    rig = with_parameters(RIG, START)
    return fit_runs(rig, [run], list(TRUTH), replace(PLAIN, robust=robust), engine=workers)[0]


@pytest.fixture(scope="module")
def careful(dirty: Run, workers: ParallelPredictor) -> FitResult:
    return fitted(dirty, True, workers)


@pytest.fixture(scope="module")
def plain(clean: Run, workers: ParallelPredictor) -> FitResult:
    return fitted(clean, True, workers)


def test_mistakes_of_the_tracker_do_not_fool_a_fit(careful: FitResult, plain: FitResult, tmp_path: Path) -> None:
    assert careful.converged and careful.reduced_chi2 < 1.1
    for e, alone in zip(careful.estimates, plain.estimates, strict=True):
        assert e.ci95[0] <= TRUTH[e.name] <= e.ci95[1]
        assert e.sd < 1.15 * alone.sd
    (excluded,) = careful.outliers
    number = np.sum(np.any(blurred() != 0.0, axis=2))
    assert excluded.share == pytest.approx(number / (FRAMES * 33), rel=0.05)
    assert excluded.sentence in careful.notes and "are treated as outliers: markers" in careful.table()
    assert json.loads(json.dumps(careful.to_json()))["outliers"][0]["channel"] == "above"
    assert any(s.outliers for s in careful.series)
    write_fit_report(careful, tmp_path / "report.html")
    assert "are treated as outliers" in (tmp_path / "report.html").read_text()


def test_without_care_they_would(careful: FitResult, dirty: Run, workers: ParallelPredictor) -> None:
    """Poisson's ratio leaves the interval that honest readings give by far, and nothing is known any more."""
    result = fitted(dirty, False, workers)
    known, fooled = careful.estimates[1], result.estimates[1]
    assert abs(fooled.value - TRUTH["strip.nu"]) > 4.0 * known.sd
    assert result.estimates[0].sd > 5.0 * careful.estimates[0].sd
    assert result.reduced_chi2 > 10.0 and result.outliers == []


def test_a_clean_recording_loses_nothing(plain: FitResult, clean: Run, workers: ParallelPredictor) -> None:
    without = fitted(clean, False, workers)
    assert plain.outliers == []
    for a, b in zip(plain.estimates, without.estimates, strict=True):
        assert (a.value, a.sd) == (b.value, b.sd)


def test_held_out_scores_count_every_reading(clean: Run, dirty: Run, workers: ParallelPredictor) -> None:
    """The mean square of the misses is that of the noise and that of the jumps together."""
    result = fit_runs(RIG, [clean], [], PLAIN, held_out=[dirty], engine=workers)[0]
    mine, score = ([e for e in result.errors if e.channel == "above" and e.held_out is kept] for kept in (False, True))
    jumps = blurred()
    assert score[0].after == pytest.approx(np.sqrt(mine[0].after ** 2 + np.mean(jumps**2)), rel=0.05)
    assert score[0].after > 4.0 * mine[0].after
    assert result.outliers == [] and not any(s.outliers for s in result.series)
    (note,) = (note for note in result.notes if "look like mistakes" in note)
    number = int(note.split(": ")[1].split()[0])
    assert number == pytest.approx(np.sum(np.any(jumps != 0.0, axis=2)), rel=0.05) and "count them all" in note


def test_mistakes_are_left_out_where_the_model_is_far_off(
    tmp_path: Path, workers: ParallelPredictor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clamped strip bends in the plane of the pictures, which the rig's cannot."""
    bent = np.zeros((FRAMES, 33, 2))
    bent[:, :, 1] = 20.0 * np.sin(np.linspace(0.0, np.pi, 33)) + 40.0 * np.linspace(0.0, 1.0, FRAMES)[:, None]
    fits = []
    once = fit.fit_with_discretisation_error

    def counted(*given: Any, **named: Any) -> Any:
        fits.append(given)
        return once(*given, **named)

    monkeypatch.setattr(fit, "fit_with_discretisation_error", counted)
    run = pulled(RIG, TRUTH, tmp_path / "bag", jumps=blurred() + bent)
    result = fit_runs(RIG, [run], ["strip.E"], replace(PLAIN, max_evaluations=3), engine=workers)[0]
    assert len(fits) == 1, "they are known before the first"
    (left_out,) = result.outliers
    assert left_out.channel == "above" and 0.01 < left_out.share < 0.05
