"""All effects at once from one rollout a recording, and the evidence that chance reaches."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any, cast

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sim_core.effects import RecordingScales, effect_by_name
from sim_core.simulate import Trace
from sysid.comparison.evidence import Evidence
from sysid.comparison.priors import Priors
from sysid.diagnosis.candidates import Amplitude, Hypothesis, drawn_shapes, hypotheses
from sysid.diagnosis.screening import Screen, look
from sysid.discretisation.approximations import Approximations
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 1.0, 200)
SIGMA, SHARE = 0.01, 0.05
MATERIAL, LAW, OTHER = (f[:, None] for f in (np.sin(6.0 * T), np.cos(6.0 * T), np.sin(23.0 * T)))
OWN = 0.01 * np.sin(20.0 * T)[:, None]


def relaxation(typical: float, label: str = "") -> Hypothesis:
    effect = effect_by_name("gel_relaxation")
    size = next(p for p in effect.parameters if p.name == "share")
    return Hypothesis("gel_relaxation" + label, effect, {"tau_s": 0.2}, (Amplitude(size, 0.0, typical),))


class Linear:
    """Reads log(E) sin, whatever the range of contacts; the first effect adds cos times its share, the second another
    course."""

    def submit(self, rig: Any, run: Any, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        found: Future[Prediction] = Future()
        modulus = next(b.material.E_pa for n, b in rig.bodies.items() if n == "gel")
        found.set_result(Prediction({"gauge": np.log(modulus) * MATERIAL}, {}, cast(Trace, None)))
        return found

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        slopes = MATERIAL[:, :, None]
        return [Prediction({"gauge": scaled[0] * MATERIAL}, {"gauge": slopes}, cast(Trace, None)) for _ in runs]

    def submit_responses(
        self, rig: Any, run: Any, parameters: Any, scaled: np.ndarray, candidates: Sequence[Any], modulated: Any = ()
    ) -> Future[Prediction]:
        courses = {"gel_relaxation": LAW, "gel_relaxation#other": OTHER, "gel_relaxation#broken": np.nan * LAW}
        columns = [courses[key] * values["share"] for c in candidates for key, values in c.items()]
        found: Future[Prediction] = Future()
        derivatives = np.stack([MATERIAL, *columns], axis=-1)
        found.set_result(Prediction({"gauge": scaled[0] * MATERIAL}, {"gauge": derivatives}, cast(Trace, None)))
        return found


def recording(seed: int, share: float, at: np.ndarray) -> Run:
    """A recording with a share of the law and half of the error of the mesh."""
    noise = SIGMA * np.random.default_rng(seed).standard_normal(T.shape)[:, None]
    data = at[0] * MATERIAL + share * LAW + 0.5 * OWN + noise
    return Run(f"run{seed}", "", (), {}, (Measured("gauge", "markers", T, data, ("u",)),), 1.0)


def screened(small_rig: Any, share: float, seeds: Sequence[int] = (1,)) -> Any:
    """A screen of recordings with a share of the law, its baseline and what failed."""
    rig = small_rig()
    parameters = fit_parameters(rig, ["gel.E"])
    at = start_of(rig, parameters)

    engine, noise = cast(Any, Linear()), {"gauge": ChannelNoise(np.array([SIGMA]), 0.0, "test")}

    def problem(numbers: Sequence[int]) -> Problem:
        shapes = [ErrorShape("mesh", tuple({"gauge": OWN} for _ in numbers))]
        return Problem([recording(n, share, at) for n in numbers], noise, engine, shapes, prior=True)

    given = problem(seeds)
    base = given.evaluate(rig, parameters, at)
    wanted = [relaxation(0.1), relaxation(0.1, "#other"), relaxation(0.1, "#broken")]
    screen, failed = look(engine, base, given, wanted, None, Approximations(engine, base, given))
    return screen, base, failed


def test_what_is_missing_is_found_with_its_size(small_rig: Any) -> None:
    """The fall of chi-square is that of the law that is missing; the other promises nothing; what cannot be simulated
    takes no part."""
    screen, base, failed = screened(small_rig, SHARE)
    assert [h.key for h in screen.hypotheses] == ["gel_relaxation", "gel_relaxation#other"] and not failed
    best, other = screen.singles()
    assert best.numbers == (0,) and best.gain > 50.0 and other.gain < 3.0
    assert best.factors[0][0] * 0.1 == pytest.approx(SHARE, abs=3.0 * SIGMA / np.sqrt(100.0))
    left = base.chi2 - best.fall
    assert left == pytest.approx(len(T), rel=0.3)


def test_a_factor_stays_within_its_bounds(small_rig: Any) -> None:
    """A share below zero is none."""
    screen, _, _ = screened(small_rig, -SHARE)
    assert screen.score([0]).factors[0][0] == pytest.approx(0.0, abs=1e-9)
    assert screen.score([0]).gain < 0.0


def test_the_simulated_null_is_rarely_exceeded(small_rig: Any) -> None:
    """Of 60 recordings without any law about one in a hundred; of those with one all."""
    gains, thresholds = [], []
    for seed in range(60):
        screen, _, _ = screened(small_rig, 0.0, (100 + seed,))
        gains.append(screen.singles()[0].gain)
        thresholds.append(screen.threshold())
    assert np.mean(np.array(gains) > thresholds) <= 0.05
    assert -6.0 < np.median(thresholds) < 12.0
    assert screened(small_rig, SHARE)[0].singles()[0].gain > max(thresholds)


def test_the_ledger_of_a_look_has_its_evidence(small_rig: Any) -> None:
    """Of readings with the dense covariance of noise, modulus and error of the mesh, and twice that for an amplitude
    that cannot be negative and is far from zero; all readings are in its blocks of time."""
    screen, base, _ = screened(small_rig, SHARE, (1, 2))
    found = screen.ledger(base)
    (own,) = (c for c in found.columns if c.owner == "mesh")
    modulus = next(c for c in found.columns if c.kind == "parameter")
    share = next(c for c in found.columns if c.kind == "effect")
    left = np.concatenate([m.values[:, 0] for run in (1, 2) for m in recording(run, SHARE, base.scaled).measured])
    left -= np.tile(base.scaled[0] * MATERIAL[:, 0] + own.prior_mean * OWN[:, 0], 2)

    def density(law: float) -> float:
        shapes = ((modulus.prior_sd, MATERIAL), (own.prior_sd, OWN), (law * share.prior_sd * share.scale, LAW))
        tables = [sd * np.tile(shape[:, 0], 2) for sd, shape in shapes]
        covariance = SIGMA**2 * np.eye(len(left)) + sum(np.outer(t, t) for t in tables)
        return float(multivariate_normal(None, covariance).logpdf(left))

    evidence = Evidence(found, priors=Priors(form=1e-6))
    first, other = list(evidence.shapes)
    assert first[0] == other[0] == "gel_relaxation" and evidence.columns[0].place == "gel"
    law = evidence.directions(first)
    assert evidence.factor(law) == pytest.approx(density(1.0) - density(0.0) + np.log(2.0), abs=1e-4)
    assert sum(b.readings for b in found.blocks) == 2 * len(T)
    (amplitude,) = evidence.amplitudes(law)
    assert amplitude.value == pytest.approx(SHARE, abs=3.0 * SIGMA / np.sqrt(200.0))


def test_two_laws_are_scored_together(small_rig: Any) -> None:
    """The minimum over both is the least-squares solution."""
    screen, base, _ = screened(small_rig, SHARE)
    both = screen.score([0, 1])
    assert len(both.factors) == 2 and both.fall >= screen.score([0]).fall - 1e-6
    assert isinstance(screen, Screen) and isinstance(base, Fitted)


def test_a_recording_that_forbids_a_law_does_not_hide_it_in_the_others(small_rig: Any) -> None:
    """In the second recording the response is wrong, as near a resonance: far too large, and against the residual."""
    screen, _, _ = screened(small_rig, SHARE, (1, 2))
    place = screen.places[0][0]
    spoilt = screen.blocks[1].gram
    spoilt[place] *= -30.0
    spoilt[:, place] *= -30.0
    assert screen.score([0]).gain < 0.0
    best = screen.by_recording()[0]
    assert best.numbers == (0,) and best.gain > 20.0
    assert best.factors[0][0] * 0.1 == pytest.approx(SHARE, abs=0.02)


def test_a_shape_is_drawn_for_a_benchmark_that_no_diagnosis_looks_at(small_rig: Any) -> None:
    scales = RecordingScales(2.0, 0.01, 1.0, 0.1, 0.05)
    rig = small_rig()
    looked = hypotheses(rig, scales)
    drawn = drawn_shapes(rig, scales, np.random.default_rng(1))
    assert {h.effect.name for h in drawn} == {h.effect.name for h in looked if h.shape}
    for h in drawn:
        assert h.drawn and all(h.shape != other.shape for other in looked if other.effect is h.effect)
        for name, value in h.shape.items():
            ends = [other.shape[name] for other in looked if other.effect is h.effect]
            if min(ends) < max(ends):
                assert min(ends) <= value <= max(ends)
    again = drawn_shapes(rig, scales, np.random.default_rng(2))
    assert [h.shape for h in again] != [h.shape for h in drawn]
