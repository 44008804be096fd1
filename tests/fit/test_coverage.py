"""Counting how often intervals hold the truth."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from inspect import signature
from types import SimpleNamespace

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sysid.cli import coverage as command_line
from sysid.fit import coverage
from sysid.fit.coverage import Coverage, Outcome, autocorrelated_noise, draw, measure_coverage, wilson
from sysid.fit.result import Estimate
from sysid.model.parameters import fit_parameters
from sysid.settings.fit import FIT


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


def test_values_that_are_zero_are_drawn_about_it(small_rig):
    """Uniform in the plausible width: of a component of gravity 0.5 m/s^2 either way, of friction 0.5 above its bound
    0; standard deviations width / sqrt(12)."""
    rig = small_rig(contacts=[{"between": ["gel", "card"], "friction": 0.0}])
    parameters = fit_parameters(rig, ["gravity.x", "gravity.z", "gel-card.friction"])
    drawn = np.array([draw(rig, parameters, 1.5, np.random.default_rng([2, k])) for k in range(400)])
    assert -0.5 <= drawn[:, 0].min() < -0.48 and 0.48 < drawn[:, 0].max() <= 0.5
    assert np.std(drawn[:, 0]) == pytest.approx(1.0 / np.sqrt(12.0), rel=0.05)
    assert -9.81 * 1.5 <= drawn[:, 1].min() and drawn[:, 1].max() <= -9.81 / 1.5
    assert 0.0 <= drawn[:, 2].min() < 0.02 and 0.48 < drawn[:, 2].max() <= 0.5


def test_coloured_noise_has_the_same_size_and_forgets_by_rho_a_sample():
    """Autocorrelation rho^k after k samples; from the first sample on as large as later."""
    white = np.random.default_rng(0).standard_normal((400, 2000))
    noise = autocorrelated_noise(white, 0.8)
    assert np.std(noise, axis=1) == pytest.approx(1.0, abs=0.1)
    for k in (1, 3):
        assert np.mean(noise[k:] * noise[:-k]) == pytest.approx(0.8**k, abs=0.01)
    np.testing.assert_array_equal(autocorrelated_noise(white, 0.0), white)


def test_only_forces_are_coloured():
    white = np.random.default_rng(0).standard_normal((4000, 6))
    noise = coverage._Biased(lambda *_: white, 1, 0.8)
    drawn = {kind: noise("sensor", kind, np.zeros(4000), white) for kind in ("wrench", "markers")}
    correlated = {k: np.corrcoef(n[1:, 0], n[:-1, 0])[0, 1] for k, n in drawn.items()}
    assert correlated["wrench"] == pytest.approx(0.8, abs=0.05) and abs(correlated["markers"]) < 0.1


def outcome(case: int, score: float, name: str = "gel.E_pa", **given: object) -> Outcome:
    """An outcome with a relative error of a hundredth of its score."""
    usual = {"unit": "Pa", "truth": 1.0, "value": 1.0, "relative": True, "error": 0.01 * score, "converged": True}
    usual["determined"] = True
    own = {"case": case, "name": name, "inside": abs(score) < 2.0, "score": score}
    return Outcome(**usual | own | given)  # type: ignore[arg-type]


def test_the_error_of_what_is_zero_is_not_over_it(small_rig, monkeypatch):
    """A truth of 0.1 m/s^2 found as 0.14 -+ 0.02 is off by 0.04 m/s^2, two standard deviations; one of 0 by all."""
    rig = small_rig()
    parameters = fit_parameters(rig, ["gravity.x"])
    found = Estimate("gravity.x_m_s2", "m/s^2", 0.0, 0.14, (0.1, 0.18), 0.02, False, False)
    monkeypatch.setattr(coverage, "load_runs", lambda *_: ([], []))
    result = SimpleNamespace(estimates=[found], converged=False, undetermined={found.name})
    monkeypatch.setattr(coverage, "fit_runs", lambda *_, **__: (result, rig))
    for truth in (0.1, 0.0):
        (case,) = coverage._case(rig, [], parameters, 3, np.array([truth]), np.zeros(1), 3, 1, 0.0)
        assert (case.relative, case.converged, case.inside) == (False, False, truth == 0.1)
        assert not case.determined
        assert case.error == pytest.approx(0.14 - truth) and case.score == pytest.approx((0.14 - truth) / 0.02)


def test_a_case_is_recorded_with_coloured_noise_and_the_table_says_so(small_rig, monkeypatch):
    rig, noises = small_rig(), []
    parameters = fit_parameters(rig, ["gravity.x"])
    monkeypatch.setattr(coverage, "simulate_to_bag", lambda *_, noise, **__: noises.append(noise))
    monkeypatch.setattr(coverage, "load_runs", lambda *_: ([], []))
    monkeypatch.setattr(
        coverage, "fit_runs", lambda *_, **__: (SimpleNamespace(estimates=[], converged=True, undetermined=set()), rig)
    )
    with pytest.raises(ValueError, match="shorter"):  # nothing was estimated
        coverage._case(rig, [None], parameters, 3, np.zeros(1), np.zeros(1), 3, 1, 0.7)
    assert [noise.colour for noise in noises] == [0.7]
    said = "correlated by 0.7 from sample to sample"
    tables = [Coverage("rig", 1, 3, 0, (outcome(0, 1.0),), {}, colour=c).table() for c in (0.7, 0.0)]
    assert [said in text for text in tables] == [True, False]


def row(table: str, name: str) -> str:
    return next(line for line in table.splitlines() if line.startswith(name))


def test_the_table_counts_and_tells_the_spread_of_scores():
    """0, 1, 2, 3: mean 1.5, standard deviation sqrt(5 / 3)."""
    text = Coverage("rig", 4, 3, 0, tuple(outcome(k, float(k)) for k in range(4)), {}).table()
    assert row(text, "gel.E_pa").split()[1:] == "2 of 4 50 % 15 .. 85 % 1.50 % 1.50 1.29".split()
    assert len(text.splitlines()) == 2, text


def test_what_no_data_determine_is_no_hit_that_counts():
    outcomes = tuple(outcome(k, 0.5, determined=k > 2) for k in range(4)) + (outcome(0, 0.5, "gel.nu"),)
    (said,) = Coverage("rig", 4, 3, 0, outcomes, {}).table().splitlines()[4:]
    assert said.startswith("gel.E_pa is not determined in 3 of 4 cases")


def test_parameters_of_one_case_are_not_counted_as_independent():
    """Ten cases of two parameters that are right or wrong together are ten trials, not twenty."""
    names = ("gel.E_pa", "gel.nu")
    text = Coverage("rig", 10, 3, 0, tuple(outcome(k, 3.0 * (k < 2), n) for k in range(10) for n in names), {}).table()
    assert "8 of 10" in row(text, "gel.nu") and "49 .. 94 %" in row(text, "gel.nu")
    assert "16 of 20" in row(text, "all") and ".." not in row(text, "all")


def test_the_table_names_what_failed_and_what_did_not_converge():
    """A failed case is no hit; one that did not converge is counted, and marked."""
    outcomes = tuple(outcome(k, 0.5, converged=k != 3) for k in range(4))
    text = Coverage("rig", 5, 3, 0, outcomes, {4: "no equilibrium"}).table()
    assert "4 of 4" in row(text, "gel.E_pa")
    assert "1 of 5 fits did not converge, and are counted: cases 3. Without them: gel.E_pa 3 of 3." in text
    assert "1 of 5 cases failed, and are in no row. Counted as outside: gel.E_pa 4 of 5." in text
    assert "Case 4 failed: no equilibrium" in text


@pytest.mark.parametrize("ended", [0, 2])
def test_an_interruption_keeps_the_cases_that_have_ended(small_rig, monkeypatch, ended):
    def some(pending, meanwhile):
        yield from list(pending)[:ended]
        raise KeyboardInterrupt

    monkeypatch.setattr(coverage, "as_they_end", some)
    monkeypatch.setattr(coverage, "worker_pool", ThreadPoolExecutor)
    monkeypatch.setattr(coverage, "_case", lambda rig, experiments, parameters, case, *drawn: [outcome(case, 0.5)])

    def measured() -> Coverage:
        return measure_coverage(small_rig(), [], ["gel.E_pa"], cases=range(4, 8))

    if not ended:
        with pytest.raises(KeyboardInterrupt):
            measured()
        return
    found = measured()
    assert [o.case for o in found.outcomes] == [4, 5] and (found.cases, found.stopped) == (2, (6, 7))
    assert "Interrupted: cases 6, 7 had not ended, and are in no row." in found.table()


@pytest.fixture
def threads(monkeypatch):
    """Cases end one after the other, in threads; those of ``ends`` with an error."""
    ends = {}

    def case(rig, experiments, parameters, number, *drawn):
        if number in ends:
            raise ends[number]
        return [outcome(number, 0.5)]

    monkeypatch.setattr(coverage, "as_they_end", lambda pending, meanwhile: list(pending))
    monkeypatch.setattr(coverage, "worker_pool", ThreadPoolExecutor)
    monkeypatch.setattr(coverage, "_case", case)
    return ends


def test_a_process_that_ends_leaves_the_cases_that_have_ended(small_rig, threads):
    """Whichever are reported first: all that had not ended fail at once, and none of them is counted as outside."""
    threads |= dict.fromkeys((4, 6), BrokenProcessPool("abruptly"))
    found = measure_coverage(small_rig(), [], ["gel.E_pa"], cases=range(4, 8))
    assert [o.case for o in found.outcomes] == [5, 7]
    assert (found.cases, found.failed, found.stopped) == (2, {}, (4, 6))
    assert "Stopped: cases 4, 6 had not ended, and are in no row. A process that simulates" in found.table()
    threads |= dict.fromkeys(range(4, 8), BrokenProcessPool("abruptly"))
    with pytest.raises(BrokenProcessPool):
        measure_coverage(small_rig(), [], ["gel.E_pa"], cases=range(4, 8))


def test_a_case_that_fails_leaves_the_others(small_rig, threads):
    threads |= {4: ValueError("no shape"), 5: ConvergenceError("no equilibrium")}
    found = measure_coverage(small_rig(), [], ["gel.E_pa"], cases=range(4, 7))
    assert [o.case for o in found.outcomes] == [6] and found.stopped == ()
    assert found.failed == {4: "ValueError: no shape", 5: "no equilibrium"}
    with pytest.raises(ValueError, match="no shape"):
        measure_coverage(small_rig(), [], ["gel.E_pa"], cases=[4, 5])
    assert measure_coverage(small_rig(), [], ["gel.E_pa"], cases=[5]).failed == {5: "no equilibrium"}


def test_a_long_case_is_not_waited_for_in_silence(small_rig, monkeypatch):
    """It ends when the third word of progress has come, none of which knows of a case that has ended."""
    reported, heard = [], threading.Event()

    def case(rig, experiments, parameters, number, *drawn):
        assert heard.wait(300.0)
        return [outcome(number, 0.5)]

    def report(share, text):
        reported.append((share, text))
        if len(reported) == 3:
            heard.set()

    monkeypatch.setattr(coverage, "FIT", replace(FIT, coverage_progress_s=0.01))
    monkeypatch.setattr(coverage, "worker_pool", ThreadPoolExecutor)
    monkeypatch.setattr(coverage, "_case", case)
    measure_coverage(small_rig(), [], ["gel.E_pa"], cases=range(2), on_progress=report)
    assert reported[:3] == [(0.0, "no case of 2 has ended yet")] * 3
    assert reported[-1] == (1.0, "2 of 2 cases have ended, 2 of 2 inside")


def test_a_table_in_which_all_failed():
    text = Coverage("rig", 1, 3, 0, (), {0: "no equilibrium"}).table()
    assert "1 of 1 cases failed" in text and "Case 0 failed: no equilibrium" in text


def test_errors_of_what_is_zero_are_in_its_unit():
    zero = outcome(0, 0.5, "gravity.x_m_s2", relative=False, unit="m/s^2", error=0.02)
    text = Coverage("rig", 1, 3, 0, (zero,), {}).table()
    assert "0.02 m/s^2" in row(text, "gravity.x_m_s2")
    assert "0 in the rig: gravity.x_m_s2" in text


def test_the_usual_truth_is_no_refinement_that_a_fit_measures_its_error_with():
    """A fit halves mesh and step; the command and the library draw the same truths."""
    defaults = [signature(of).parameters["refine"].default for of in (measure_coverage, command_line.coverage)]
    assert defaults[0] == defaults[1] > 2


@pytest.mark.slow
def test_the_command_runs_cases():
    command = [sys.executable, "-m", "sysid", "coverage", "strip_coarse", "pull_taut"]
    command += ["--params", "strip.E", "--cases", "2", "--first", "3", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr
    outcomes = json.loads(done.stdout)["outcomes"]
    assert [o["case"] for o in outcomes] == [3, 4]
    assert all(abs(o["error"]) < 0.05 for o in outcomes)
