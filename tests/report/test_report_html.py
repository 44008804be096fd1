"""The reports as files: complete, self-contained, and robust against results with gaps."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from report_examples import (
    PROVENANCE,
    REJECTED,
    RUNS,
    compliance,
    gel_relaxation,
    make_diagnosis,
    make_errors,
    make_fit,
    make_series,
    plasticity,
)

from sim_core.effects import all_effects
from sim_core.rigs import load_rig
from sim_core.simulate import Trace
from sysid.diagnosis.baseline import Baseline
from sysid.diagnosis.candidates import Amplitude, Hypothesis
from sysid.diagnosis.diagnose import _collect
from sysid.diagnosis.report_notes import Screened
from sysid.diagnosis.residual_analysis import structure
from sysid.diagnosis.result import VERDICTS, Diagnosis, Located, Misfit, NamedParameter
from sysid.diagnosis.screening import Block, Screen
from sysid.diagnosis.verdict import Case, Verdict
from sysid.fit.result import Estimate, FitResult
from sysid.model.predictor import Prediction, SerialPredictor
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.report import write_diagnosis_report, write_fit_report
from sysid.report.fit_page import overall_level
from sysid.report.numbers import TIMES
from sysid.report.tables import nuisance_rows, provenance_of
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem
from sysid.uncertainty.nuisance_estimates import Nuisance

NAN = float("nan")
VOID = {"meta", "link", "br", "img", "input", "hr", "rect", "path", "use", "source"}


class Page(HTMLParser):
    """What a page holds; raises on tags that do not match."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.ids: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.numbers: set[float] = set()
        self.text = ""
        self.scripts: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for key, value in attrs:
            self.attributes.append((tag, key, value or ""))
            if key == "id":
                self.ids.append(value or "")
            if (tag, key) == ("data", "value"):
                self.numbers.add(float(value or "nan"))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open and self.open[-1] == tag, (tag, self.open[-3:], self.getpos())
            self.open.pop()

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts.append(data)
        elif not self.open or self.open[-1] != "style":
            self.text += data

    @property
    def words(self) -> str:
        return " ".join(self.text.split())


def fit_page(tmp_path: Path, result: FitResult) -> Page:
    path = write_fit_report(result, tmp_path / "fit.html")
    assert path == tmp_path / "fit.html"
    return checked(path)


def diagnosis_page(tmp_path: Path, diagnosis: Diagnosis) -> Page:
    return checked(write_diagnosis_report(diagnosis, tmp_path / "diagnosis.html"))


def checked(path: Path) -> Page:
    """What holds for every report."""
    text = path.read_text(encoding="utf-8")
    assert len(text.encode()) < 5_000_000
    page = Page(text)
    assert len(page.ids) == len(set(page.ids)), "an id occurs twice"
    for tag, key, value in page.attributes:
        if key in ("src", "href", "srcset", "data", "poster", "action"):
            assert value.startswith(("#", "data:")), (tag, key, value)
    for pattern in (r"https?://", r"@import", r"url\((?!#)"):
        assert not re.search(pattern, text), pattern
    assert not re.search(r"\b(nan|NaN|None(?! (is|was|of) )|inf|Infinity|Undefined)\b", page.words), page.words
    targets = {v[1:] for _, k, v in page.attributes if k == "href" and v.startswith("#")}
    clips = set(re.findall(r"url\(#([^)]*)\)", text))
    assert targets | clips <= set(page.ids)
    assert "#0a0b" not in text, "a colour was not replaced"
    for tag, key, value in page.attributes:
        assert (tag, key) != ("svg", "aria-label") or value
    return page


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Page]:
    """A page of each verdict."""
    folder = tmp_path_factory.mktemp("verdicts")
    return {v: checked(write_diagnosis_report(make_diagnosis(v), folder / f"{v}.html")) for v in VERDICTS}


def test_the_noise_that_is_used_stands_beside_the_declared_one_and_is_told_from_it(tmp_path: Path) -> None:
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


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_diagnosis_holds_every_number_of_its_parameters(verdicts: dict[str, Page], verdict: str) -> None:
    d = make_diagnosis(verdict)
    page = verdicts[verdict]
    for candidate in (*d.effects, *d.alternatives):
        assert candidate.probability in page.numbers
        assert candidate.title in page.words
        assert candidate.rejected in page.words
        for p in candidate.parameters:
            assert {p.value, *p.ci95} <= page.numbers
            assert p.words in page.words
    for p in (*d.baseline_parameters, *d.amended_parameters):
        assert {p.value, *p.ci95} <= page.numbers
    found = {c.name for c in d.effects}
    assert {v for k, v in d.upper_limits.items() if k.split(".")[1] not in found} <= page.numbers
    assert d.sentence in page.words and d.next_experiment in page.words and d.not_explained in page.words
    assert json.loads(page.scripts[0])["schema"] == "thinshell.diagnosis/2"


def test_each_verdict_says_what_it_must(verdicts: dict[str, Page]) -> None:
    words = {v: page.words for v, page in verdicts.items()}
    assert "card.E_pa was fitted too high without it: 2.310 GPa instead of 2.030 GPa." in words["named"]
    falls = f"error of wrench_gel force falls from 14.2 to 2.06 mN, from 7.10{TIMES} to 1.03{TIMES} the noise"
    assert falls in words["named"]
    assert "wrench_gel force71 %" in words["named"]
    assert f"Not an answer: {REJECTED}" in words["named"]
    assert "Practically certain. Takes away 97 % of the misfit beyond noise" in words["named"]
    assert "thinshell plan amended_rig.yaml motion.yaml --params effects.gel_relaxation.share" in words["named"]
    assert "What would separate them" in words["one_of"]
    assert "do not tell them apart" in words["one_of"]
    assert "Upper limits" in words["nothing_missing"]
    assert "31 µm/N" in words["nothing_missing"] and "displacement per force" in words["nothing_missing"]
    assert "What it changed" not in words["nothing_missing"]
    assert "none of the effects that were tried accounts for it" in words["unknown"]
    assert "Next experiment" in words["unknown"]


def test_the_discretisation_error_stands_beside_the_error_in_its_unit(verdicts: dict[str, Page]) -> None:
    words = verdicts["named"].words
    assert f"wrench_gel force [mN] 14.22.06 7.10{TIMES} to 1.03{TIMES} 2.000.400" in words
    assert "the error of the simulator's own mesh and time step" in words


def test_places_are_shown_where_no_law_is_known(verdicts: dict[str, Page]) -> None:
    assert "the stiffness of gel changes" in verdicts["unknown"].words and "81 %" in verdicts["unknown"].words
    assert "without any law" not in verdicts["named"].words


def test_what_was_found_has_no_upper_limit(verdicts: dict[str, Page]) -> None:
    limits = verdicts["named"].words.split("not larger than this")[1].split("Left open")[0]
    assert "end_effector_compliance" in limits and "gel_relaxation" not in limits


def empty_diagnosis() -> Diagnosis:
    """What the diagnosis collects of one recording that the baseline explains, and one effect that was tried."""
    t = np.linspace(0.0, 1.0, 60)
    white = np.random.default_rng(0).standard_normal((60, 6))
    gauge = Measured("wrench_gel", "wrench", t, white, tuple("abcdef"))
    noise = {"wrench_gel": ChannelNoise(np.ones(6), 0.0, "test")}
    problem = Problem([Run("pull", "", (), {}, (gauge,), 1.0)], noise, cast(SerialPredictor, None))
    prediction = Prediction({"wrench_gel": np.zeros((60, 6))}, {}, cast(Trace, None))
    rig = load_rig("card_press")
    base = Fitted(
        [], np.zeros(0), rig, white.ravel(), np.zeros((360, 0)), [(0, "wrench_gel", np.repeat(t, 6))], [prediction],
        rig, 1, True, "",
    )  # fmt: skip
    relaxation = all_effects()["gel_relaxation"]
    size = next(p for p in relaxation.parameters if p.name == "share")
    law = Hypothesis("gel_relaxation", relaxation, {"tau_s": 0.2}, (Amplitude(size, 0.0, 0.25),))
    gram = np.array([[90.0, 3.0], [3.0, 360.0]])
    screen = Screen(base, [law], [Block("pull", gram, np.zeros(2))])
    whole = Baseline(problem, base, Problem([], noise, cast(SerialPredictor, None)), None, noise, [], (), None)
    case = Case(structure(problem, base), None, 3.0)
    return _collect(rig, whole, case, Verdict("nothing_missing", ()), [], Screened(screen, screen.singles(), {}))[0]


def test_the_examples_have_the_keys_of_real_diagnoses(tmp_path: Path) -> None:
    real, example = empty_diagnosis(), make_diagnosis("nothing_missing")
    assert list(real.discretisation) == list(example.discretisation)
    assert set(real.upper_limits) <= set(example.upper_limits) and real.upper_limits
    words = diagnosis_page(tmp_path, real).words
    assert "What became of each effect" in words and "promised no better fit" in words


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


def test_a_diagnosis_without_anything(tmp_path: Path) -> None:
    page = diagnosis_page(
        tmp_path,
        make_diagnosis(
            "unknown", alternatives=(), located=Located((), {}, ""), baseline=Misfit(NAN, None, ()), noise_floor={},
            discretisation={}, baseline_parameters=(), not_explained="", next_experiment="", provenance={}, series=[],
        ),
    )  # fmt: skip
    assert "None is proposed." in page.words
    assert "No recording was held out" in page.words


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
    page = diagnosis_page(
        tmp_path,
        make_diagnosis(
            "named", baseline=Misfit(48.0, None, tuple(make_errors(runs, before=9.0, after=7.0))),
            amended=Misfit(1.1, None, tuple(make_errors(runs, before=7.0, after=1.0))), series=make_series(runs),
            effects=(replace(gel_relaxation(0.99), held_out_gain=None),), provenance={**PROVENANCE, "bags": bags},
        ),
    )  # fmt: skip
    assert "No recording was held out" in page.words


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


def test_both_answers_and_rivals_may_share_a_name(tmp_path: Path) -> None:
    twin = replace(compliance(0.2, ""), place="left finger")
    d = make_diagnosis(
        "one_of", effects=(compliance(0.5, ""), twin), alternatives=(plasticity(0.3, "worse"), twin), series=[]
    )
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


def test_files_are_written_into_new_folders(tmp_path: Path) -> None:
    path = write_fit_report(make_fit(series=[]), tmp_path / "a" / "b" / "fit.html")
    assert path.is_file()


def test_reports_of_the_same_result_are_the_same(tmp_path: Path) -> None:
    values: dict[str, Any] = {"series": make_series(RUNS[:1])}
    one = write_fit_report(make_fit(**values), tmp_path / "one.html").read_bytes()
    two = write_fit_report(make_fit(**values), tmp_path / "two.html").read_bytes()
    assert one == two


def test_what_is_estimated_beside_shares_the_prefix_of_its_unit() -> None:
    late = Nuisance("wrench.latency_s", "a", "s", 0.0, 0.02, (0.018, 0.022), 0.001, 0.03, False, ())
    found = [late, replace(late, run="b", value=4e-5, ci95=(-2e-4, 3e-4)), replace(late, run="c")]
    rows = nuisance_rows(found)
    assert [row.unit for row in rows] == ["ms"] * 3 and [row.value.text for row in rows] == ["20.0", "0.04", "20.0"]


@pytest.mark.parametrize(("own", "level", "says"), [(0.0, "bad", "but not those held out"), (8.0, "good", "as well")])
def test_what_is_held_out_is_judged_beside_the_error_of_mesh_and_step(
    tmp_path: Path, own: float, level: str, says: str
) -> None:
    """Missed by five times the noise, where one refinement shows an error of none, or of eight times it."""
    errors = [replace(e, after=(5.0 if e.held_out else 1.0) * e.noise, own=own * e.noise) for e in make_fit().errors]
    fit = make_fit(errors=errors, unexplained=[], reduced_chi2=1.0, series=[])
    assert overall_level(fit) == level
    assert says in fit_page(tmp_path, fit).words


def test_options_and_marks_are_in_plain_words() -> None:
    told = dict(provenance_of({"options": {"starts": 1, "robust": True, "priors": {}, "max_evaluations": None}}).facts)
    assert told == {"options": "starts: 1; robust: yes"}
    rows = make_fit(undetermined={"gel.nu"}).table().splitlines()
    assert next(r for r in rows if r.startswith("gel.nu")).endswith("(not determined, at its bound)")
