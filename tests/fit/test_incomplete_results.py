"""Results of which a part is missing: a held-out recording that fails, points that are predicted out of sight."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from readings import TRUTH, Readings, T, result_of, run_of

from sysid.fit import fit
from sysid.noise.estimate import channel_noise
from sysid.report import write_fit_report

pytestmark = pytest.mark.usefixtures("declared")


def test_a_held_out_recording_that_fails_does_not_take_the_fit_with_it(small_rig: Any) -> None:
    kept = [run_of("deep", "markers"), run_of("shallow", "markers")]
    result = result_of(Readings(broken="deep"), small_rig(), [run_of("press", "markers")], kept)
    assert result.estimates[0].value == pytest.approx(TRUTH, rel=0.05)
    assert [(e.run, e.held_out) for e in result.errors] == [("press", False), ("shallow", True)]
    assert result.notes == ["deep: could not be simulated: The step does not converge. Shorten solver.dt_s."]


def test_a_held_out_recording_does_not_change_the_fit(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is a hundred times noisier."""
    monkeypatch.setattr(fit, "channel_noise", channel_noise)
    there, other = run_of("press", "side"), run_of("noisy", "side")
    (m,) = other.measured
    noisy = m.values + np.random.default_rng(4).standard_normal(m.values.shape)
    other = replace(other, measured=(replace(m, values=noisy),))
    alone, with_more = (result_of(Readings(), small_rig(), [there], kept) for kept in ([], [other]))
    assert with_more.estimates == alone.estimates and with_more.noise == alone.noise


def test_a_channel_that_is_predicted_out_of_sight_is_noted(small_rig: Any, tmp_path: Path) -> None:
    result = result_of(Readings(hidden="side"), small_rig(), [run_of("press", "markers", "side")], [])
    assert [e.channel for e in result.errors] == ["markers"]
    assert len(result.notes) == 1 and result.notes[0].startswith("press: side: the simulated points are out of sight")
    result.write(tmp_path / "fit.json")
    assert json.loads((tmp_path / "fit.json").read_text())["errors"][0]["after"] < 0.02
    assert "press" in result.table()
    assert write_fit_report(result, tmp_path / "report.html").stat().st_size > 0


def test_readings_that_are_predicted_out_of_sight_are_not_counted_but_reported(small_rig: Any) -> None:
    """As if they had not been recorded."""
    run = run_of("press", "side")
    (m,) = run.measured
    half = len(T) // 2
    blind = result_of(Readings(hidden="side", begins=half), small_rig(), [run], [])
    short = replace(run, measured=(replace(m, values=np.where(np.arange(len(T))[:, None] < half, m.values, np.nan)),))
    alone = result_of(Readings(), small_rig(), [short], [])
    assert blind.misfit == pytest.approx(alone.misfit) and blind.reduced_chi2 == pytest.approx(alone.reduced_chi2)
    assert blind.estimates[0].sd == pytest.approx(alone.estimates[0].sd)
    (note,) = blind.notes
    assert note.startswith("press: side: 50 % of the readings are of points that the fitted rig has out of sight")
    pressed = run_of("press", "markers")
    (late,) = result_of(Readings(hidden="markers", begins=half), small_rig(), [pressed], []).notes
    assert late.startswith("press: markers: 50 % of the readings are of instants before or after the poses")


def test_what_did_not_converge_says_so_before_its_values(small_rig: Any) -> None:
    good = result_of(Readings(), small_rig(), [run_of("press", "markers")], [])
    assert good.converged and good.table().startswith("parameter")
    result = replace(good, converged=False, message="the evaluations allowed, 1, are used up")
    first = result.table().splitlines()[0]
    assert first.startswith("The fit did not converge: the evaluations allowed, 1, are used up."), first
    assert first.endswith("Take its values as a start, not as a result.")
    assert result.table().count("did not converge") == 1
