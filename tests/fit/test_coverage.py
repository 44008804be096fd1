"""Counting how often intervals hold the truth."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from sysid.fit.coverage import Coverage, Outcome, draw, wilson
from sysid.fit.parameters import fit_parameters


def test_interval_of_a_share():
    """No hit in n: 0 .. z^2 / (n + z^2); half of 100: 0.5 -+ 0.0962 (Brown, Cai & DasGupta 2001)."""
    z2 = 1.959964**2
    assert wilson(0, 10) == pytest.approx((0.0, z2 / (10 + z2)))
    assert wilson(10, 10) == pytest.approx((10 / (10 + z2), 1.0))
    assert wilson(50, 100) == pytest.approx((0.4038, 0.5962), abs=1e-4)


def test_values_are_drawn_by_factors_and_stay_in_bounds(small_rig):
    rig = small_rig()
    parameters = fit_parameters(rig, ["card.E_pa", "gel.nu"])
    drawn = np.array([draw(rig, parameters, 2.0, np.random.default_rng([1, k])) for k in range(400)])
    factors = np.exp(drawn[:, 0]) / rig.bodies["card"].material.E_pa
    assert 0.5 <= factors.min() < 0.52 and 1.92 < factors.max() <= 2.0
    assert np.median(factors) == pytest.approx(1.0, abs=0.08)
    nu, lower, upper = rig.bodies["gel"].material.nu, 0.5 * rig.bodies["gel"].material.nu, parameters[1].upper
    assert upper < 2.0 * nu
    assert lower <= drawn[:, 1].min() and drawn[:, 1].max() < upper
    assert np.median(drawn[:, 1]) == pytest.approx(np.sqrt(lower * upper), rel=0.05)
    np.testing.assert_array_equal(drawn[7], draw(rig, parameters, 2.0, np.random.default_rng([1, 7])))


def test_the_table_counts_and_names_what_failed():
    outcomes = tuple(Outcome(k, "gel.E_pa", 1.0, 1.0 + 0.01 * k, k < 3, 0.01 * k, 0.5 * k) for k in range(4))
    text = Coverage("rig", 5, 2, 0, outcomes, {4: "no equilibrium"}).table()
    assert "3 of 4" in text and "75 %" in text and "1.50 %" in text
    assert "Case 4 failed: no equilibrium" in text


@pytest.mark.slow
def test_the_command_runs_cases():
    command = [sys.executable, "-m", "sysid", "coverage", "strip_pull", "pull_strip"]
    command += ["--params", "strip.E", "--cases", "2", "--first", "3", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr
    outcomes = json.loads(done.stdout)["outcomes"]
    assert [o["case"] for o in outcomes] == [3, 4]
    assert all(abs(o["error"]) < 0.05 for o in outcomes)
