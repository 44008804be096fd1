"""A recording with all nuisances gives back what is in it, and a clean one loses little."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from recordings_of_the_small_rig import BIAS, REST, START, TRUTH, record

from sim_core.rigs import Rig, with_parameters
from sysid.fit import FitOptions, FitResult, fit_runs
from sysid.fit import multistart as starts
from sysid.fit.options import Intervals
from sysid.observations.observations import Run
from sysid.report import write_fit_report
from sysid.settings.fit import FIT

HIDDEN = {"markers.latency_s": 0.02, "side.fx_px": 1407.0, "side.fy_px": 1407.0}

MOST_GROWTH = 1.25
"""How much wider the intervals of a clean recording may be for what is estimated with the parameters."""


@pytest.fixture(scope="module")
def dirty(small_rig: Callable[..., Rig], tmp_path_factory: pytest.TempPathFactory) -> Run:
    return record(small_rig(), HIDDEN, BIAS, tmp_path_factory.mktemp("dirty") / "bag")


@pytest.fixture(scope="module")
def clean(small_rig: Callable[..., Rig], tmp_path_factory: pytest.TempPathFactory) -> Run:
    return record(small_rig(), {}, 0.0 * BIAS, tmp_path_factory.mktemp("clean") / "bag")


def fitted(rig: Rig, run: Run, nuisance: tuple[str, ...], intervals: Intervals = "checked") -> tuple[FitResult, Rig]:
    options = FitOptions(nuisance=nuisance, intervals=intervals)
    return fit_runs(with_parameters(rig, START), [run], list(TRUTH), options)


@pytest.mark.slow
def test_what_nobody_measured_does_not_fool_a_fit(small_rig: Any, dirty: Run, tmp_path: Path) -> None:
    result, rig = fitted(small_rig(), dirty, ("time", "bias", "camera"))
    assert result.converged and result.reduced_chi2 < 1.1
    for e in result.estimates:
        assert e.ci95[0] <= TRUTH[e.name] <= e.ci95[1], e
        assert e.value == pytest.approx(TRUTH[e.name], rel=0.03)
    found = {n.name: n for n in result.nuisances}
    for name, value in {**HIDDEN, "wrench.latency_s": 0.0, "side.cx_px": 640.0}.items():
        if name in found:
            assert found[name].ci95[0] <= value <= found[name].ci95[1], found[name]
    for axis, value in zip("xyz", BIAS[:3], strict=True):
        assert abs(found[f"wrench force {axis} bias"].value - value) < 4.0 * found[f"wrench force {axis} bias"].sd
    assert rig.sensors["markers"].latency_s == found["markers.latency_s"].value
    assert rig.cameras["side"].fy_px == pytest.approx(rig.cameras["side"].fx_px)
    assert [s.split(":")[0].split(" is off")[0].split(" by")[0].split(" of force")[0] for s in result.remarks] == [
        "The stream markers lags", "The scale of the camera side", "In bag, wrench has a bias",
    ]  # fmt: skip
    assert all(e.after < 1.2 * e.noise + 0.05 * e.before for e in result.errors)
    assert [e["name"] for e in json.loads(json.dumps(result.to_json()))["nuisances"]] == list(found)
    assert "markers.latency_s" in result.table() and result.remarks[0] in result.table()
    page = write_fit_report(result, tmp_path / "report.html").read_text()
    assert "Estimated with them" in page and "wrench force x bias" in page


@pytest.mark.slow
def test_without_nuisances_it_would(small_rig: Any, dirty: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even from the truth."""
    monkeypatch.setattr(starts, "FIT", replace(FIT, most_restarts=0))
    result, _ = fit_runs(with_parameters(small_rig(), TRUTH), [dirty], list(TRUTH), FitOptions(nuisance=("none",)))
    assert result.nuisances == [] and result.remarks == []
    assert all(abs(e.value / TRUTH[e.name] - 1.0) > 0.03 for e in result.estimates)


def test_where_nothing_moves_clocks_stay_at_their_prior(small_rig: Any, tmp_path: Path) -> None:
    run = record(with_parameters(small_rig(), TRUTH), {}, 0.0 * BIAS, tmp_path / "bag", REST)
    result, _ = fit_runs(
        with_parameters(small_rig(), TRUTH), [run], ["card.E_pa"], FitOptions(nuisance=("time", "bias", "camera"))
    )
    (e,) = result.estimates
    assert e.ci95[0] <= TRUTH["card.E_pa"] <= e.ci95[1]
    clocks = [n for n in result.nuisances if n.name.endswith("latency_s")]
    assert len(clocks) == 3
    for n in clocks:
        assert not n.informed and n.sd >= 0.99 * n.prior_sd and abs(n.value) < 1e-3 * n.prior_sd
    assert result.remarks == [] and result.identifiability == []
    (line,) = [line for line in result.table().splitlines() if "latency" in line]
    assert line.endswith("known no better than before."), "they are named, and no values of them"


@pytest.mark.slow
def test_a_clean_recording_loses_little(small_rig: Any, clean: Run) -> None:
    """Intervals grow by a quarter at most where poses are known, and evaluations of the rig by half; apart from
    evaluations along profiles, which may lead to the other side of a kink."""
    asked, plain = (
        fitted(small_rig(), clean, kinds, "quadratic")[0] for kinds in (("time", "bias", "camera"), ("none",))
    )
    assert asked.evaluations < 1.5 * plain.evaluations
    for e, alone in zip(asked.estimates, plain.estimates, strict=True):
        assert e.ci95[0] <= TRUTH[e.name] <= e.ci95[1], e
        assert 0.95 * alone.sd < e.sd < MOST_GROWTH * alone.sd
    assert asked.remarks == []
