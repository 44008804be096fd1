"""The report of a diagnosis as a file: complete, and robust against results with gaps."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from report_examples import (
    PROVENANCE,
    RUNS,
    compliance,
    gel_relaxation,
    make_diagnosis,
    make_errors,
    make_series,
    plasticity,
)
from report_pages import Page, checked, diagnosis_page

from sysid.diagnosis.result import VERDICTS, Located, Misfit, NamedParameter
from sysid.report import write_diagnosis_report
from sysid.report.numbers import TIMES

NAN = float("nan")


@pytest.fixture(scope="module")
def verdicts(diagnosis_pages: dict[str, Path]) -> dict[str, Page]:
    """A page of each verdict."""
    return {verdict: checked(page) for verdict, page in diagnosis_pages.items()}


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_diagnosis_holds_every_number_of_its_parameters(verdicts: dict[str, Page], verdict: str) -> None:
    d = make_diagnosis(verdict)
    page = verdicts[verdict]
    for candidate in (*d.effects, *d.alternatives):
        assert candidate.probability in page.numbers
        assert candidate.title in page.words
        for p in candidate.parameters:
            assert {p.value, *p.ci95} <= page.numbers
            assert p.words in page.words
    for p in (*d.baseline_parameters, *d.amended_parameters):
        assert {p.value, *p.ci95} <= page.numbers
    found = {c.name for c in d.effects}
    assert {v for k, v in d.upper_limits.items() if k.split(".")[1] not in found} <= page.numbers
    assert d.sentence in page.words and d.next_experiment in page.words and d.not_explained in page.words
    assert json.loads(page.scripts[0])["schema"] == "thinshell.diagnosis/3"


def test_each_verdict_says_what_it_must(verdicts: dict[str, Page]) -> None:
    words = {v: page.words for v, page in verdicts.items()}
    assert "card.E_pa was fitted too high without it: 2.310 GPa instead of 2.030 GPa." in words["named"]
    falls = f"error of wrench_gel force falls from 14.2 to 2.06 mN, from 7.10{TIMES} to 1.03{TIMES} the noise"
    assert falls in words["named"]
    assert "wrench_gel force71 %" in words["named"]
    assert "Practically certain. Takes away 97 % of the misfit beyond noise" in words["named"]
    assert "thinshell plan amended_rig.yaml motion.yaml --params effects.gel_relaxation.share" in words["named"]
    assert "What would separate them" in words["one_of"]
    assert "do not tell them apart" in words["one_of"]
    assert "Upper limits" in words["nothing_missing"]
    assert "31 µm/N" in words["nothing_missing"] and "displacement per force" in words["nothing_missing"]
    assert "What it changed" not in words["nothing_missing"]
    assert "no effect of the library is as probable" in words["unknown"]
    assert "Next experiment" in words["unknown"]


def test_the_discretisation_error_stands_next_to_the_error_in_its_unit(verdicts: dict[str, Page]) -> None:
    words = verdicts["named"].words
    assert f"wrench_gel force [mN] 14.22.06 7.10{TIMES} to 1.03{TIMES} 2.000.400" in words
    assert "the error of the simulator's own mesh and time step" in words


def test_places_are_shown_where_no_law_is_known(verdicts: dict[str, Page]) -> None:
    assert "something is missing in the gel" in verdicts["unknown"].words and "81 %" in verdicts["unknown"].words
    assert "Places of the model" not in verdicts["named"].words


def test_what_was_found_has_no_upper_limit(verdicts: dict[str, Page]) -> None:
    limits = verdicts["named"].words.split("not larger than this")[1].split("Left open")[0]
    assert "end_effector_compliance" in limits and "gel_relaxation" not in limits


def test_a_diagnosis_without_anything(tmp_path: Path) -> None:
    page = diagnosis_page(
        tmp_path,
        make_diagnosis(
            "unknown", alternatives=(), located=Located((), {}, ""), baseline=Misfit(NAN, None, ()), noise_floor={},
            baseline_parameters=(), not_explained="", next_experiment="", provenance={}, series=[],
        ),
    )  # fmt: skip
    assert "None is proposed." in page.words
    assert "No recording was held out" in page.words


def test_no_held_out_data(tmp_path: Path) -> None:
    runs = RUNS[:1]
    bags = PROVENANCE["bags"][:1]  # type: ignore[index]
    page = diagnosis_page(
        tmp_path,
        make_diagnosis(
            "named", baseline=Misfit(48.0, None, tuple(make_errors(runs, before=9.0, after=7.0))),
            amended=Misfit(1.1, None, tuple(make_errors(runs, before=7.0, after=1.0))), series=make_series(runs),
            effects=(replace(gel_relaxation(0.99), held_out_gain=None),), provenance={**PROVENANCE, "bags": bags},
        ),
    )  # fmt: skip
    assert "No recording was held out" in page.words


def test_verdicts_and_rivals_may_share_a_name(tmp_path: Path) -> None:
    twin = replace(compliance(0.2), place="left finger")
    d = make_diagnosis("one_of", effects=(compliance(0.5), twin), alternatives=(plasticity(0.3), twin), series=[])
    page = diagnosis_page(tmp_path, d)
    assert page.words.count("left finger") >= 2


def test_windows_are_shaded_only_where_they_belong(tmp_path: Path) -> None:
    d = make_diagnosis("named", series=make_series(RUNS[:1]))
    text = write_diagnosis_report(d, tmp_path / "a.html").read_text()
    shaded = text.count('style="fill: var(--window)')
    d.located = Located(d.located.channels, {}, d.located.phase)
    plain = write_diagnosis_report(d, tmp_path / "b.html").read_text()
    assert shaded > 0 and plain.count('style="fill: var(--window)') == 0


def test_a_parameter_without_a_counterpart(tmp_path: Path) -> None:
    extra = NamedParameter("effects.gel_relaxation.tau_s", 0.49, (0.46, 0.53), "s", "time constant")
    d = make_diagnosis("named", series=[])
    d.amended_parameters = (*d.amended_parameters, extra)
    page = diagnosis_page(tmp_path, d)
    assert "not in this model" in page.words
