"""A hand that is not quite where its poses say: a fit that allows for it finds the truth, another is fooled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recordings_of_the_small_rig import BIAS, REST, START, TRUTH, record

from sim_core.rigs import Rig, with_parameters
from sysid.fit import FitOptions, FitResult, fit_runs
from sysid.fit import multistart as starts
from sysid.model.nuisance_parameters import KINDS
from sysid.observations.observations import Run
from sysid.settings.fit import FIT

OFFSET = {
    "finger.offset_x_m": 2e-4,
    "finger.offset_y_m": -2e-4,
    "finger.offset_z_m": 2.8e-4,
    "finger.offset_rx_deg": 0.2,
    "finger.offset_ry_deg": 0.3,
    "finger.offset_rz_deg": -0.17,
}
"""0.4 mm and 0.4 deg in all."""


@pytest.fixture(scope="module")
def askew(small_rig: Callable[..., Rig], tmp_path_factory: pytest.TempPathFactory) -> Run:
    return record(small_rig(), OFFSET, 0.0 * BIAS, tmp_path_factory.mktemp("askew") / "bag")


def fitted(rig: Rig, run: Run, nuisance: tuple[str, ...], names: list[str]) -> FitResult:
    return fit_runs(rig, [run], names, FitOptions(nuisance=nuisance, intervals="quadratic", robust=False))[0]


def test_a_recording_has_the_poses_that_are_commanded(small_rig: Any, askew: Run) -> None:
    start = small_rig().end_effectors["finger"].start.position()
    np.testing.assert_allclose(askew.poses["finger"].positions[0], start, atol=1e-12)


@pytest.mark.slow
def test_an_offset_that_nobody_measured_does_not_fool_a_fit(small_rig: Any, askew: Run) -> None:
    result = fitted(with_parameters(small_rig(), START), askew, KINDS, list(TRUTH))
    assert result.converged and result.reduced_chi2 < 1.1
    for e in result.estimates:
        assert e.ci95[0] <= TRUTH[e.name] <= e.ci95[1], e
    found = {n.name: n for n in result.nuisances}
    for name, value in OFFSET.items():
        assert abs(found[name].value - value) < 3.0 * found[name].sd, name
    deep = found["finger.offset_z_m"]
    assert deep.far and deep.sd < 0.05 * deep.prior_sd
    assert any("finger is shifted by 0.2" in said and "along z" in said for said in result.remarks)


@pytest.mark.slow
def test_without_the_nuisance_it_would(small_rig: Any, askew: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even from the truth."""
    monkeypatch.setattr(starts, "FIT", replace(FIT, most_restarts=0))
    result = fitted(with_parameters(small_rig(), TRUTH), askew, ("time", "bias", "camera"), list(TRUTH))
    rubbing = next(e for e in result.estimates if e.name.endswith("friction"))
    assert not rubbing.ci95[0] <= TRUTH[rubbing.name] <= rubbing.ci95[1]


def test_what_tells_nothing_leaves_an_offset_at_its_prior(small_rig: Any, tmp_path: Any) -> None:
    """At rest in the air the gel moves as a whole with the finger, and only its weight tells how it is turned."""
    rig = with_parameters(small_rig(), TRUTH)
    run = record(rig, {}, 0.0 * BIAS, tmp_path / "bag", REST)
    result = fitted(rig, run, ("pose",), ["card.E_pa"])
    shifts = [n for n in result.nuisances if n.name.startswith("finger.offset") and n.unit == "m"]
    assert len(shifts) == 3
    for n in shifts:
        assert not n.informed and n.sd >= 0.99 * n.prior_sd and abs(n.value) < 1e-3 * n.prior_sd
        assert n.name in result.table().partition("The data do not tell")[2]
