"""All effects at once from one rollout a recording, and the model linearised where a set of them is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from sim_core.effects import RecordingScales, effect_by_name
from sim_core.errors import ConvergenceError
from sim_core.simulate import Trace
from sysid.comparison.evidence import Evidence
from sysid.comparison.posterior import compared
from sysid.comparison.priors import AMPLITUDES, PRIORS, Priors
from sysid.diagnosis.candidates import Amplitude, Hypothesis, drawn_shapes, hypotheses
from sysid.diagnosis.look import Look, look
from sysid.discretisation.approximations import Approximations, refinement_errors
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import Prediction
from sysid.model.responses import Modulated
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.solve import SOLVE
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 1.0, 200)
SIGMA, SHARE = 0.01, 0.05
NARROW = replace(PRIORS, form=1e-6)
COLUMNS = np.array([1.0, 0.7, 0.4])
MATERIAL, LAW, OTHER = (f[:, None] * COLUMNS for f in (np.sin(6.0 * T), np.cos(6.0 * T), np.sin(23.0 * T)))
OWN = 0.01 * np.sin(20.0 * T)[:, None] * COLUMNS


def relaxation(typical: float, label: str = "") -> Hypothesis:
    effect = effect_by_name("gel_relaxation")
    size = next(p for p in effect.parameters if p.name == "share")
    return Hypothesis("gel_relaxation" + label, effect, {"tau_s": 0.2}, (Amplitude(size, 0.0, typical),))


def _share_sd() -> float:
    size = relaxation(0.1).amplitudes[0]
    return size.sd * (size.typical - size.none)


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
        columns += [np.zeros_like(MATERIAL) for _ in modulated]
        derivatives = np.stack([MATERIAL, *columns], axis=-1)
        found.set_result(Prediction({"gauge": scaled[0] * MATERIAL}, {"gauge": derivatives}, cast(Trace, None)))
        return found


def recording(seed: int, share: float, at: np.ndarray) -> Run:
    """A recording with a share of the law and half of the error of the mesh."""
    noise = SIGMA * np.random.default_rng(seed).standard_normal(MATERIAL.shape)
    data = at[0] * MATERIAL + share * LAW + 0.5 * OWN + noise
    return Run(f"run{seed}", "", (), {}, (Measured("gauge", "markers", T, data, ("u", "v", "w")),), 1.0)


def looked(small_rig: Any, share: float, seeds: Sequence[int] = (1,), fitted: float | None = None) -> tuple[Look, Any]:
    """A look at recordings with a share of the law, and its baseline; ``fitted``: from where the law has this share."""
    rig = small_rig()
    parameters = fit_parameters(rig, ["gel.E"])
    at = start_of(rig, parameters)
    engine, noise = cast(Any, Linear()), {"gauge": ChannelNoise(np.full(3, SIGMA), 0.0, "test")}
    shapes = [ErrorShape("mesh", tuple({"gauge": OWN} for _ in seeds))]
    runs = [recording(n, share, at) for n in seeds]
    named = replace(refinement_errors(shapes, runs), instant=())
    given = Problem(runs, noise, engine, prior=True, named=named)
    base = given.evaluate(rig, parameters, at)
    wanted = [relaxation(0.1), relaxation(0.1, "#other"), relaxation(0.1, "#broken")]
    found = look(engine, base, given, wanted, Approximations(engine, base, given))
    given = given.with_named(found.named)
    if fitted is None:
        return found.look_at(given, base), base
    there = rig.model_copy(update={"effects": {"gel_relaxation": {"share": fitted, "tau_s": 0.2}}})
    nothing = rig.model_copy(update={"effects": {"gel_relaxation": {"share": 0.0, "tau_s": 0.2}}})
    own = fit_parameters(there, ["effects.gel_relaxation.share"])
    values = [Prediction({"gauge": at[0] * MATERIAL + fitted * LAW},
                         {"gauge": np.stack([MATERIAL, LAW], axis=-1)}, cast(Trace, None)) for _ in seeds]  # fmt: skip
    known = [replace(own[0], prior_sd=_share_sd())]
    amended = given.compare(values, nothing, [*parameters, *known], np.array([at[0], fitted]))
    return found.look_at(given, amended, wanted[:1]), amended


def test_a_fit_begins_where_the_amplitude_is_most_probable(small_rig: Any) -> None:
    """What is missing has its size, and what cannot be simulated takes no part."""
    found, base = looked(small_rig, SHARE)
    assert [h.key for h in found.hypotheses.values()] == ["gel_relaxation", "gel_relaxation#other"] and not found.failed
    (first, _) = found.hypotheses
    (factors,), shift = found.start([first], 1.0)
    assert factors[0] * 0.1 == pytest.approx(SHARE, abs=3.0 * SIGMA / np.sqrt(100.0))
    assert shift.shape == base.scaled.shape


def test_a_factor_stays_within_its_bounds(small_rig: Any) -> None:
    """A share below zero is none."""
    found, _ = looked(small_rig, -SHARE)
    assert found.start([next(iter(found.hypotheses))], 1.0)[0][0][0] == pytest.approx(0.0, abs=1e-9)


def test_what_is_linear_is_as_probable_where_it_is_fitted(small_rig: Any) -> None:
    """The Bayes factor of a law by the marginal likelihoods where it is fitted, wherever that is, is that of the ledger
    of the baseline, in which it is one more direction."""
    plain, _ = looked(small_rig, SHARE, (1, 2))
    factor = compared(plain.ledger.merged, NARROW)
    best = max(c.factor for c in factor.candidates if c.names == ("gel_relaxation",) and not c.counts.any())
    for at in (SHARE, 0.6 * SHARE):
        there, _ = looked(small_rig, SHARE, (1, 2), fitted=at)
        assert there.ledger.fitted == {"gel_relaxation": "gel"}
        both = compared(replace(plain.ledger, amended=(there.ledger,)).merged, NARROW)
        (own,) = (c for c in both.candidates if c.names == ("gel_relaxation",) and not c.counts.any())
        assert own.at == 1
        # Of three widths of the prior, equally probable, the widest has the evidence in full, the others less.
        assert own.factor == pytest.approx(best, abs=1.2)
        assert own.factor == pytest.approx(_averaged(plain), abs=0.02)


def _averaged(plain: Look) -> float:
    """log B of the law by the ledger of the baseline, averaged over the widths of the prior of its amplitude."""
    evidence = Evidence(plain.ledger, priors=NARROW)
    shape = next(iter(plain.hypotheses))
    factors = [evidence.factor(evidence.directions(shape, scale)) for scale in AMPLITUDES]
    return float(logsumexp(factors) - np.log(len(factors)))


def test_the_ledger_of_a_look_has_its_evidence(small_rig: Any) -> None:
    """Of readings with the dense covariance of noise, modulus and error of the mesh, and twice that for an amplitude
    that cannot be negative and is far from zero; all readings are in its blocks of time."""
    seen, base = looked(small_rig, SHARE, (1, 2))
    found = seen.ledger
    (own,) = (c for c in found.columns if c.owner == "mesh")
    modulus = next(c for c in found.columns if c.kind == "parameter")
    share = next(c for c in found.columns if c.kind == "effect")
    left = np.concatenate([m.values.ravel() for run in (1, 2) for m in recording(run, SHARE, base.scaled).measured])
    (mean,) = (c for c in found.columns if c.owner == "averaging of a sensor")
    curved = np.zeros(OWN.shape)
    curved[1:-1] = base.scaled[0] / 24.0 * (MATERIAL[2:] - 2.0 * MATERIAL[1:-1] + MATERIAL[:-2])
    known = base.scaled[0] * MATERIAL + own.prior_mean * OWN + mean.prior_mean * curved
    left -= np.tile(known.ravel(), 2)

    jumps = np.zeros(OWN.shape)
    jumps[1:-1] = np.sqrt(2.0 / 3.0) * (OWN[1:-1] - 0.5 * (OWN[:-2] + OWN[2:]))
    of_instants = block_diag(*(np.outer(g, g) for g in np.tile(jumps, (2, 1))))

    def density(law: float) -> float:
        shapes = [(modulus.prior_sd, MATERIAL), (own.prior_sd, OWN), (mean.prior_sd, curved)]
        shapes += [(law * share.prior_sd * share.scale, LAW)]
        tables = [sd * np.tile(shape.ravel(), 2) for sd, shape in shapes]
        covariance = SIGMA**2 * np.eye(len(left)) + of_instants + sum(np.outer(t, t) for t in tables)
        return float(multivariate_normal(None, covariance).logpdf(left))

    evidence = Evidence(found, priors=Priors(form=1e-6))
    first, other = list(evidence.shapes)
    assert first[0] == other[0] == "gel_relaxation" and evidence.columns[0].place == "gel"
    law = evidence.directions(first)
    assert evidence.factor(law) == pytest.approx(density(1.0) - density(0.0) + np.log(2.0), abs=1e-4)
    assert sum(b.readings for b in found.blocks) == 6 * len(T)
    (amplitude,) = evidence.amplitudes(law)
    assert amplitude.value == pytest.approx(SHARE, abs=3.0 * SIGMA / np.sqrt(200.0))


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


def test_rollouts_along_open_motions_are_looked_at_and_those_that_fail_are_left_out(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By how much the first one differs from its linear response, of which there is none here, is an error of each
    instant; the second one fails."""
    still = Modulated("finger.offset_x_m", np.array([0.0, 1.0]), np.zeros(2))
    plain: Future[Prediction] = Future()
    ended: Future[Prediction] = Future()
    lost: Future[Prediction] = Future()
    lost.set_exception(ConvergenceError("It does not converge.", "Begin elsewhere."))
    monkeypatch.setattr(Approximations, "open_motions", lambda *_: [still, still])
    monkeypatch.setattr(Approximations, "offsets", lambda *_: [still])
    monkeypatch.setattr(Approximations, "submit_along", lambda *_: [plain, ended, lost])
    rig = small_rig()
    parameters = fit_parameters(rig, ["gel.E"])
    at = start_of(rig, parameters)
    slipped = np.where(T > 0.5, 3.0 * SIGMA, 0.0)[:, None] * COLUMNS
    plain.set_result(Prediction({"gauge": 0.9 * MATERIAL}, {}, cast(Trace, None)))
    ended.set_result(Prediction({"gauge": 0.9 * MATERIAL + slipped}, {}, cast(Trace, None)))
    engine, noise = cast(Any, Linear()), {"gauge": ChannelNoise(np.full(3, SIGMA), 0.0, "test")}
    runs = [recording(1, 0.0, at)]
    given = Problem(runs, noise, engine, prior=True, named=refinement_errors([], runs))
    base = given.evaluate(rig, parameters, at)
    named = look(engine, base, given, [relaxation(0.1)], Approximations(engine, base, given)).named
    rows = np.sum(np.square(named.instant[0]["gauge"]), axis=(1, 2))
    squares = np.sum(slipped**2, axis=1)
    reach = len(T) // (2 * (SOLVE.error_course_levels[-1][0] - 1))
    about = [squares[max(0, k - reach) : k + reach + 1].mean() for k in range(len(T))]
    # It stays for 100 readings, which know it no better than one.
    np.testing.assert_allclose(rows, 50.0 * (squares + about), rtol=1e-9, atol=1e-15)
