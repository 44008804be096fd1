"""The report of a fit as a file: complete, and robust against results with gaps."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from report_examples import (
    PROVENANCE,
    RUNS,
    make_errors,
    make_fit,
    make_series,
)
from report_pages import fit_page

from sysid.fit.result import Estimate
from sysid.report import write_fit_report
from sysid.report.fit_page import overall_level
from sysid.report.tables import nuisance_rows, provenance_of
from sysid.uncertainty.nuisance_estimates import Nuisance

NAN = float("nan")


def test_the_noise_that_is_used_stands_next_to_the_declared_one_and_is_distinguished(tmp_path: Path) -> None:
    result = make_fit()
    words = fit_page(tmp_path, result).words.split("Provenance")[-2]
    assert "Standard deviation, usedDeclared by the rig" in words
    assert "wrench_gel force2.00 mN1.85 mNwhitequiet stretches" in words
    assert "what the rig declares stands in where it is more than 2 times that" in words
    table = result.table()
    assert re.search(r"press_1 +wrench_gel force .* 0\.002 +0\.00185  N\n", table)
    assert re.search(r"before +after +noise +declared  unit", table)
    assert "\nnoise: what the fit used, estimated from the recordings; declared: what the rig says" in table


def test_the_fit_report_holds_every_number_of_its_parameters(tmp_path: Path) -> None:
    result = make_fit()
    page = fit_page(tmp_path, result)
    for e in result.estimates:
        assert {e.value, *e.ci95, e.start} <= page.numbers
        assert e.name in page.words
    for c in result.errors:
        assert {c.before, c.after, c.noise} <= page.numbers
    for shown in ("2.031", "1.981 to 2.083", "GPa", "at its bound", "not determined", "0.985"):
        assert shown in page.words
    for sentence in (*result.identifiability, *result.notes):
        assert sentence in page.words
    for bag in PROVENANCE["bags"]:  # type: ignore[attr-defined]
        assert bag["sha256"][0] in page.words
    for text in ("4 parameters", "2 recordings", "1 recording was held out", "gravity_m_s2", "seed", "3.11.7"):
        assert text in page.words


def test_the_fit_report_carries_its_json(tmp_path: Path) -> None:
    result = make_fit()
    data = json.loads(fit_page(tmp_path, result).scripts[0])
    assert data == json.loads(json.dumps(result.to_json()))


def test_a_fit_without_anything(tmp_path: Path) -> None:
    page = fit_page(
        tmp_path,
        make_fit(
            estimates=[], correlation=[], identifiability=[], undetermined=set(), errors=[], noise={}, notes=[],
            provenance={}, series=[], reduced_chi2=NAN, seconds=NAN, message="",
        ),
    )  # fmt: skip
    assert "No parameter was fitted." in page.words
    assert "No time series were kept" in page.words


def test_missing_numbers_are_shown_as_missing(tmp_path: Path) -> None:
    bad = Estimate("card.E_pa", "Pa", NAN, NAN, (NAN, math.inf), NAN, True, False)
    errors = [replace(e, after=NAN, noise=0.0) for e in make_errors(RUNS, before=2.0, after=1.0)]
    series = make_series(RUNS)
    series[0] = replace(series[0], measured=[None] * len(series[0].t))
    series[1] = replace(series[1], after=[NAN] * len(series[1].t))
    series[2] = replace(series[2], t=[], measured=[], before=[], after=[])
    series[3] = replace(series[3], t=[1.0], measured=[0.1], before=[0.2], after=[0.1])
    flat = [0.0] * len(series[4].t)
    series[4] = replace(series[4], measured=list(flat), before=flat, after=flat)
    result = make_fit(
        estimates=[bad], correlation=[[NAN]], undetermined=set(), errors=errors, series=series,
        noise={"wrench_gel": {"sigma": NAN, "correlation": None}},
    )  # fmt: skip
    page = fit_page(tmp_path, result)
    assert json.loads(page.scripts[0])["estimates"][0]["value"] is None


def test_no_held_out_data(tmp_path: Path) -> None:
    runs = RUNS[:1]
    bags = PROVENANCE["bags"][:1]  # type: ignore[index]
    page = fit_page(
        tmp_path,
        make_fit(
            errors=make_errors(runs, before=9.0, after=1.0), series=make_series(runs),
            provenance={**PROVENANCE, "bags": bags},
        ),
    )  # fmt: skip
    assert "none was held out, so nothing here tests a prediction" in page.words


@pytest.mark.slow
def test_many_runs_stay_small_and_are_grouped(tmp_path: Path) -> None:
    runs = tuple((f"run_{k:02d}", k >= 30) for k in range(40))
    page = fit_page(
        tmp_path,
        make_fit(errors=make_errors(runs, before=9.0, after=1.0), series=make_series(runs, n=600)),
    )
    assert sum(t == "details" and k == "class" and v == "run" for t, k, v in page.attributes) == 40
    assert "30 recordings" in page.words and "run_39" in page.words
    assert "Columns that fit better than those shown are left out" in page.words


def test_long_names_and_markup_in_names(tmp_path: Path) -> None:
    name = "bodies.the_left_finger_of_the_gripper_with_the_soft_gel_pad<script>alert(1)</script>.E_pa"
    run = "</script><b>2026-11-21_" + "very_long_name_of_a_recording_" * 6
    runs = ((run, False),)
    page = fit_page(
        tmp_path,
        make_fit(
            rig="a & b <i>",
            estimates=[Estimate(name, "N m", 1e-7, 3.3e-7, (3.1e-7, 3.5e-7), 0.1, True, False)],
            correlation=[[1.0]],
            identifiability=[],
            undetermined=set(),
            errors=make_errors(runs, before=9.0, after=1.0),
            series=make_series(runs),
            notes=[run],
        ),
    )
    assert name in page.words and run in page.words
    assert "330" in page.words and "nN·m" in page.words
    assert not any(tag in ("b", "i") and value for tag, _, value in page.attributes)


def test_a_fit_that_failed_says_so_first(tmp_path: Path) -> None:
    page = fit_page(tmp_path, make_fit(converged=False, message="interrupted", series=[]))
    assert "did not converge" in page.words.split("Parameters")[0]
    page = fit_page(tmp_path, make_fit(reduced_chi2=50.0, series=[]))
    assert "does not explain the recordings" in page.words
    errors = make_errors(RUNS[:2], before=9.0, after=1.0) + make_errors(RUNS[2:], before=9.0, after=6.0)
    page = fit_page(tmp_path, make_fit(errors=errors, series=[]))
    assert "but not those held out" in page.words


def test_more_than_noise_in_one_quantity_is_said_first_however_good_the_rest(tmp_path: Path) -> None:
    good = fit_page(tmp_path, make_fit(series=[]))
    assert "explains the recordings" in good.words
    left = "The rig does not explain the recordings: what it leaves is 3 times the noise in the torque of load_cell."
    page = fit_page(tmp_path, make_fit(unexplained=[left], series=[]))
    first = page.words.split("95 % interval")[0]
    assert left in first and "leaves more than their noise" in first


def test_what_was_known_and_is_contradicted_is_said_first_however_good_the_rest(tmp_path: Path) -> None:
    said = "The recordings contradict what was known of card.E_pa before, 1e+09 +- 1e+07 Pa."
    fit = make_fit(contradicted=[said], series=[])
    first = fit_page(tmp_path, fit).words.split("95 % interval")[0]
    assert said in first and "contradict what was known before" in first and "explains the recordings" not in first
    assert fit.table().index(said) < fit.table().index("95 % interval")


def test_what_intervals_rest_on_is_said_first(tmp_path: Path) -> None:
    fit = make_fit(cautions=["The error of mesh and time step may be 28 times the noise."], series=[])
    assert fit.cautions[0] in fit_page(tmp_path, fit).words.split("95 % interval")[0]
    assert fit.table().index(fit.cautions[0]) < fit.table().index("95 % interval")


@pytest.mark.parametrize(("after", "said"), [(1.1, False), (2.4, True)])
def test_what_only_the_discretisation_error_explains_is_no_noise(tmp_path: Path, after: float, said: bool) -> None:
    errors = [replace(e, after=after * e.noise) for e in make_fit().errors if not e.held_out]
    page = fit_page(tmp_path, make_fit(errors=errors, unexplained=[], series=[]))
    assert "down to their noise" in page.words
    assert ("down to their noise and the error of its own mesh and time step." in page.words) == said


@pytest.mark.parametrize(
    "remarks", [[], ["The stream wrench lags by 20 +- 1 ms: write wrench.latency_s = 0.02 into the rig."]]
)
def test_what_to_write_into_a_rig_is_to_be_checked_first(tmp_path: Path, remarks: list[str]) -> None:
    late = Nuisance("wrench.latency_s", "", "s", 0.0, 0.02, (0.018, 0.022), 0.001, 0.03, False, ())
    fit = make_fit(remarks=remarks, nuisances=[late], series=[])
    page = fit_page(tmp_path, fit)
    for words in (page.words, fit.table()):
        assert ("check it on the robot before it goes into the rig" in words) == bool(remarks)


def test_a_rig_that_explains_nothing_determines_nothing(tmp_path: Path) -> None:
    inside = [replace(e, at_bound=False) for e in make_fit().estimates]
    page = fit_page(
        tmp_path, make_fit(identifiability=[], undetermined=set(), estimates=inside, reduced_chi2=400.0, series=[])
    )
    assert "does not explain the recordings" in page.words and "determined by these recordings" not in page.words
    assert "means little" in page.words and "is determined on its own" not in page.words


def test_what_is_determined_is_said_first(tmp_path: Path) -> None:
    pair = make_fit().identifiability[1]
    together = "The data do not determine gel.E_pa and gel.nu separately, only in combination: both up. Fix one."
    inside = [replace(e, at_bound=False) for e in make_fit().estimates]
    page = fit_page(tmp_path, make_fit(identifiability=[], undetermined=set(), estimates=inside, series=[]))
    assert "Every parameter is determined by these recordings." in page.words and "4 of 4" in page.words
    outside = [replace(e, at_bound=True) for e in inside]
    page = fit_page(tmp_path, make_fit(identifiability=[], undetermined=set(), estimates=outside, series=[]))
    assert "is determined by these recordings" not in page.words and "0 of 4" in page.words
    cases: list[tuple[list[str], set[str], str]] = [
        ([], set(), "Every other parameter is determined by these recordings."),
        ([pair], set(), "determined by these recordings, though some are traded off"),
        ([together], {"gel.E_pa", "gel.nu"}, "do not determine gel.E_pa and gel.nu on their own"),
    ]
    for sentences, names, words in cases:
        page = fit_page(tmp_path, make_fit(identifiability=sentences, undetermined=names, series=[]))
        assert words in page.words.split("95 % interval")[0]


@pytest.mark.parametrize(("after", "verb"), [(1.0, "fell from"), (3.0, "rose from"), (2.0, "stayed at 2.00")])
def test_the_verb_follows_the_error(tmp_path: Path, after: float, verb: str) -> None:
    errors = [replace(e, before=2.0 * e.noise, after=after * e.noise) for e in make_errors(RUNS, before=2.0, after=1.0)]
    words = fit_page(tmp_path, make_fit(errors=errors, series=[])).words
    assert f"The error {verb}" in words and f"on held-out recordings it {verb}" in words


def test_files_are_written_into_new_folders(tmp_path: Path) -> None:
    path = write_fit_report(make_fit(series=[]), tmp_path / "a" / "b" / "fit.html")
    assert path.is_file()


def test_reports_of_the_same_result_are_the_same(tmp_path: Path) -> None:
    values: dict[str, Any] = {"series": make_series(RUNS[:1])}
    one = write_fit_report(make_fit(**values), tmp_path / "one.html").read_bytes()
    two = write_fit_report(make_fit(**values), tmp_path / "two.html").read_bytes()
    assert one == two


def test_what_is_estimated_as_well_shares_the_prefix_of_its_unit() -> None:
    late = Nuisance("wrench.latency_s", "a", "s", 0.0, 0.02, (0.018, 0.022), 0.001, 0.03, False, ())
    found = [late, replace(late, run="b", value=4e-5, ci95=(-2e-4, 3e-4)), replace(late, run="c")]
    rows = nuisance_rows(found)
    assert [row.unit for row in rows] == ["ms"] * 3 and [row.value.text for row in rows] == ["20.0", "0.04", "20.0"]


@pytest.mark.parametrize(("own", "level", "says"), [(0.0, "bad", "but not those held out"), (8.0, "good", "as well")])
def test_what_is_held_out_is_judged_with_the_error_of_mesh_and_step(
    tmp_path: Path, own: float, level: str, says: str
) -> None:
    """Missed by five times the noise, where one refinement shows an error of none, or of eight times it."""
    errors = [replace(e, after=(5.0 if e.held_out else 1.0) * e.noise, own=own * e.noise) for e in make_fit().errors]
    fit = make_fit(errors=errors, unexplained=[], reduced_chi2=1.0, series=[])
    assert overall_level(fit) == level
    assert says in fit_page(tmp_path, fit).words


def test_options_and_marks_are_in_plain_words() -> None:
    facts = dict(provenance_of({"options": {"starts": 1, "robust": True, "priors": {}, "max_evaluations": None}}).facts)
    assert facts == {"options": "starts: 1; robust: yes"}
    rows = make_fit(undetermined={"gel.nu"}).table().splitlines()
    assert next(r for r in rows if r.startswith("gel.nu")).endswith("(not determined, at its bound)")
