"""Clocks are set anew between recordings: each stream has an offset in time in each of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from strip import START, TRUTH, pulled, strip_rig

from sim_core.rigs import with_parameters
from sysid.fit import FitOptions, fit_runs
from sysid.fit.result import FitResult
from sysid.model.nuisance_parameters import nuisance_parameters
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import acting_in
from sysid.observations.observations import Measured, Run
from sysid.uncertainty.nuisance_estimates import Nuisance, remarks, with_mean_nuisances

RIG = strip_rig()
CHANNELS = [*RIG.sensors, *RIG.cameras]
LATE = {"early": -0.02, "late": 0.02}


def run_of(name: str, path: str, channels: list[str]) -> Run:
    kinds = {**dict.fromkeys(RIG.cameras, "tracks"), **{n: s.type for n, s in RIG.sensors.items()}}
    measured = (Measured(c, kinds[c], np.zeros(3), np.zeros((3, 6)), ()) for c in channels)
    return Run(name, path, (), {}, tuple(measured), 1.0)


def test_a_stream_has_an_offset_in_each_recording_that_has_it() -> None:
    runs = [run_of("a", "a", CHANNELS), run_of("b", "b", CHANNELS), run_of("c", "c", CHANNELS[:1])]
    found = nuisance_parameters(RIG, runs, [], ("time",))
    first, second = (f"{c}.latency_s" for c in CHANNELS)
    assert [p.name for p in found] == [*(f"{first}[{b}]" for b in "abc"), *(f"{second}[{b}]" for b in "ab")]
    assert {p.target for p in found} == {first, second} and {p.prior_sd for p in found} == {0.03}


def test_windows_of_one_recording_share_their_clock() -> None:
    runs = [run_of(f"a@{k}:{k + 1}", "a", CHANNELS) for k in range(3)]
    assert [p.name for p in nuisance_parameters(RIG, runs, [], ("time",))] == [f"{c}.latency_s" for c in CHANNELS]
    runs = [run_of(name, name, CHANNELS[:1]) for name in ("a@0:9", "a@40:52.5", "b")]
    found = nuisance_parameters(RIG, runs, [], ("time",))
    first = f"{CHANNELS[0]}.latency_s"
    assert [p.name for p in found] == [f"{first}[a]", f"{first}[b]"]
    assert [acting_in(found, run.name) for run in runs] == [[0], [0], [1]]


@pytest.fixture(scope="module")
def fitted(workers: ParallelPredictor, tmp_path_factory: pytest.TempPathFactory) -> FitResult:
    """A fit of two recordings whose clocks are off to either side."""
    folder = tmp_path_factory.mktemp("clocks")
    runs = [
        replace(pulled(RIG, {**TRUTH, **{f"{c}.latency_s": late for c in CHANNELS}}, folder / name, seed=k), name=name)
        for k, (name, late) in enumerate(LATE.items())
    ]
    runs[0] = replace(runs[0], doubts=("/wrench: a fault",))
    options = FitOptions(nuisance=("time",), intervals="quadratic")
    return fit_runs(with_parameters(RIG, START), runs, list(TRUTH), options, engine=workers)[0]


def test_clocks_that_are_off_to_either_side_are_found(fitted: FitResult) -> None:
    assert {(n.name, n.run) for n in fitted.nuisances} == {(f"{c}.latency_s", name) for c in CHANNELS for name in LATE}
    for n in fitted.nuisances:
        assert n.informed and abs(n.value - LATE[n.run]) < 4.0 * n.sd < 0.02, n
    for e in fitted.estimates:
        assert e.ci95[0] <= TRUTH[e.name] <= e.ci95[1]
    assert fitted.reduced_chi2 < 1.1 and not fitted.unexplained
    assert all(f"{c}.latency_s" in fitted.table() for c in CHANNELS)


def test_what_a_recording_was_read_with_is_said_before_the_values(fitted: FitResult) -> None:
    assert fitted.cautions[0].startswith("early was read with 1 fault that may change the result: /wrench: a fault.")
    table = fitted.table()
    assert table.index("/wrench: a fault") < table.index("strip.E_pa")


def test_that_clocks_differ_is_said(fitted: FitResult) -> None:
    (said,) = (r for r in fitted.remarks if RIG.sensors[CHANNELS[0]].topic in r)
    assert "another offset in time in each recording: leads by" in said and "in early; lags by" in said
    assert "write" not in said


def test_the_usual_offset_is_that_of_the_recordings_that_tell_it() -> None:
    name = f"{CHANNELS[0]}.latency_s"
    known = Nuisance(name, "a", "s", 0.0, 0.02, (0.018, 0.022), 0.001, 0.03, False, ())
    rig = with_mean_nuisances(RIG, [known, replace(known, run="b", value=-0.01, sd=0.029)])
    assert rig.sensors[CHANNELS[0]].latency_s == pytest.approx(0.02, abs=1e-4)


def test_clocks_that_agree_are_reported_together() -> None:
    name = f"{CHANNELS[0]}.latency_s"
    one = Nuisance(name, "a", "s", 0.0, 0.019, (0.017, 0.021), 0.001, 0.03, False, ())
    both = [one, replace(one, run="b", value=0.021, ci95=(0.019, 0.023))]
    (said,) = remarks(RIG, both, trusted=True)
    assert said.endswith(f"lags by 20.00 +- 0.71 ms: write {name} = 0.02 into the rig.")
    weak = replace(one, run="c", value=-0.01, sd=0.029, ci95=(-0.067, 0.047))
    assert len(remarks(RIG, [*both, weak], trusted=True)) == 1
    (apart,) = remarks(cast(Any, RIG), [*both, replace(one, run="c", value=0.05)], trusted=True)
    assert "another offset in time in each recording" in apart


@pytest.mark.parametrize(("apart_s", "said"), [(0.0041, False), (0.0044, True)])
def test_two_clocks_differ_beyond_three_deviations_of_their_difference(apart_s: float, said: bool) -> None:
    """Of 1 ms each, which are 4.24 ms."""
    name = f"{CHANNELS[0]}.latency_s"
    one = Nuisance(name, "a", "s", 0.0, 0.019, (0.017, 0.021), 0.001, 0.03, False, ())
    (found,) = remarks(cast(Any, RIG), [one, replace(one, run="b", value=0.019 + apart_s)], trusted=True)
    assert ("in each recording" in found) is said
