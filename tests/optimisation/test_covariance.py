"""What is said of parameters that the data reach weakly, or not at all."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from sysid.model.parameters import FitParameter
from sysid.noise.autocorrelation import Samples
from sysid.settings.solve import SOLVE
from sysid.solve.covariance import interval, names_undetermined, uncertainty
from sysid.solve.optimum import Fitted

N = 50


def fitted(jacobian: np.ndarray, misfit: float = 1.0) -> Fitted:
    """A fit with this whitened jacobian ``(n, p)``."""
    parameters = [FitParameter(f"p{k}", "Pa", True, 1.0, 1e13, 2.0, "") for k in range(jacobian.shape[1])]
    residual = misfit * np.random.default_rng(0).standard_normal(len(jacobian))
    labels = [(0, "gauge", np.linspace(0.0, 1.0, len(jacobian)))]
    nothing = cast(Any, None)
    return Fitted(
        parameters, np.full(len(parameters), 10.0), nothing, residual, jacobian, labels, [], nothing, 1, True, ""
    )


@pytest.mark.parametrize("misfit", [1.0, 1e4])
@pytest.mark.parametrize("strength", [0.0, 1.0, 1e9])
def test_a_parameter_without_influence_is_as_wide_as_its_range(strength: float, misfit: float) -> None:
    jacobian = np.column_stack([strength * np.ones(N), np.zeros(N)])
    fit = fitted(jacobian, misfit)
    known = uncertainty(fit)
    assert np.isfinite(known.sd).all() and np.isfinite(known.correlation).all()
    assert 2.0 <= known.sd[1] <= SOLVE.widest_sd * 2.0
    assert any("do not determine p1" in s for s in known.sentences)
    assert np.isfinite(interval(fit.parameters[1], 10.0, known.sd[1])).all()


def test_a_pair_that_cancels_is_said_to_be_known_only_together() -> None:
    slope = np.linspace(1.0, 2.0, N)
    known = uncertainty(fitted(1e7 * np.column_stack([slope, -slope])))
    assert (known.sd > SOLVE.undetermined_share * 2.0).all()
    assert any("p0 and p1 separately, only in combination" in s for s in known.sentences)


def test_well_determined_parameters_have_the_deviation_of_least_squares() -> None:
    jacobian = np.random.default_rng(1).standard_normal((N, 2)) * [1e4, 30.0]
    expected = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    fit = fitted(jacobian, 1e-9)
    np.testing.assert_allclose(uncertainty(fit).sd, expected, rtol=1e-9)


@pytest.mark.parametrize(("value", "determined"), [(0.055, True), (0.001, False)])
def test_a_number_is_judged_by_its_own_size(value: float, determined: bool) -> None:
    """A damping of 0.055 +- 0.007 s is known, though a plausible one is 0.01; 0.001 +- 0.007 s is not."""
    damping = FitParameter("strip.stiffness_damping_s", "s", False, 0.0, 10.0, 0.01, "")
    jacobian = np.full((N, 1), 1.0 / 0.007 / np.sqrt(N))
    fit = replace(fitted(jacobian, 1e-9), parameters=[damping], scaled=np.array([value]))
    assert uncertainty(fit).sd == pytest.approx([0.007])
    sentences = uncertainty(fit).sentences
    assert bool(sentences) != determined
    if sentences:
        assert sentences[0].startswith("The data do not determine strip.stiffness_damping_s: 0 to 0.01")


def test_a_channel_without_samples_is_left_out() -> None:
    fit = fitted(np.ones((N, 1)))
    fit.labels.append((0, "blind", np.zeros(0)))
    assert np.isfinite(uncertainty(fit).sd).all()


def test_names_of_what_is_not_determined_may_hold_anything() -> None:
    """Those of bags are in them, and one may go on where another ends."""
    slope = np.linspace(1.0, 2.0, N)
    fit = fitted(1e7 * np.column_stack([slope, -slope, np.zeros(N), 1.0 - slope**2]))
    names = ["gel.nu[press (2)]", "gel.nu", "big_gel.nu[a and b]", "gel.nu[a: b]"]
    fit = replace(fit, parameters=[replace(p, name=n) for p, n in zip(fit.parameters, names, strict=True)])
    found = uncertainty(fit).findings
    assert {frozenset(f.undetermined) for f in found} == {frozenset(names[:2]), frozenset(names[2:3])}
    assert names_undetermined(found) == set(names[:3])
    assert all(name in f.sentence for f in found for name in f.undetermined)


def torn(strength: float) -> Fitted:
    """Readings miss by no more than noise does, but neighbours alike: half of them pull one way and half the other."""
    residual = np.where(np.arange(N) < N // 2, 1.0, -1.0)
    return replace(fitted(np.full((N, 1), strength / np.sqrt(N))), residual=residual)


def test_what_misfit_leaves_wide_is_not_determined() -> None:
    fit = torn(1.9)
    known = uncertainty(fit)
    low, high = interval(fit.parameters[0], 10.0, known.sd[0])
    assert known.sd[0] > SOLVE.undetermined_share * 2.0
    assert known.sentences == (
        f"The data do not determine p0: its 95 % interval is {low:.3g} to {high:.3g} Pa. Record a motion that depends "
        "on it, or fix it.",
    )


def test_the_interval_in_words_is_that_of_the_table() -> None:
    fit = torn(0.8)
    known = uncertainty(fit)
    low, high = interval(fit.parameters[0], 10.0, known.sd[0])
    assert known.inflation[0] > 1.5
    assert known.sentences[0].startswith(f"The data do not determine p0: {low:.3g} to {high:.3g} Pa fit about as well.")


@pytest.mark.parametrize("misfit", [1.0, 27.0])
def test_what_was_known_before_is_not_widened_by_a_misfit(misfit: float) -> None:
    """Data that say nothing of a parameter leave what was known of it, those that say something are worth less: the
    tempered posterior."""
    known, sd = 0.05, 0.02
    slope = np.zeros((N, 2))
    slope[:, 0] = 1.0 / sd / np.sqrt(N)
    fit = fitted(np.vstack([slope, np.eye(2) / known]), np.sqrt(misfit))
    residual = np.concatenate([np.sqrt(misfit) * np.ones(N), np.zeros(2)])
    residual[1:N:2] *= -1.0
    labels = [(0, "gauge", np.linspace(0.0, 1.0, N)), (-1, "prior", np.zeros(2))]
    parameters = [replace(p, known_sd=known) for p in fit.parameters]
    fit = replace(fit, parameters=parameters, residual=residual, labels=labels)
    found = uncertainty(fit)
    reduced = N * misfit / (N - 2)
    assert found.reduced_chi2 == pytest.approx(reduced)
    assert found.sd == pytest.approx([(1.0 / (reduced * sd**2) + known**-2) ** -0.5, known], rel=1e-6)


def waving(amplitude: float, strength: float, known: float | None) -> Fitted:
    """A fit that misses by noise and a wave of ``amplitude``, which is as good as it gets. Its readings tell of a
    parameter to 1 / ``strength``; it was ``known`` before so well."""
    t = np.linspace(0.0, 1.0, 1000)
    wave = np.sin(3.0 * t)
    residual = np.random.default_rng(1).standard_normal(len(t)) + amplitude * np.sin(7.0 * t + 0.3)
    residual -= wave * (wave @ residual) / (wave @ wave)
    jacobian, labels = strength * wave / np.linalg.norm(wave), [(0, "gauge", t)]
    fit = fitted(np.ones((2, 1)))
    if known is not None:
        residual, jacobian = np.append(residual, 0.0), np.append(jacobian, 1.0 / known)
        labels.append((-1, "prior", np.zeros(1)))
    parameter = replace(fit.parameters[0], prior_sd=known or 1.0, known_sd=known)
    return replace(fit, parameters=[parameter], residual=residual, jacobian=jacobian[:, None], labels=labels)


@pytest.mark.parametrize("amplitude", [0.0, 3.0, 10.0])
@pytest.mark.parametrize("strength", [0.3, 1.0, 10.0])
def test_what_was_known_before_is_not_widened_by_a_misfit_with_structure(strength: float, amplitude: float) -> None:
    """The search weighs it up against recordings in which neighbours miss alike: what those say may be worth nothing,
    but takes nothing from what was known."""
    known = 0.05
    assert uncertainty(waving(amplitude, strength / known, known)).sd[0] < 1.1 * known


@pytest.mark.parametrize("amplitude", [0.0, 3.0, 10.0])
def test_what_was_known_hardly_before_changes_nothing(amplitude: float) -> None:
    """However much it is weighed up against a misfit with structure, of which the colour is seen."""
    samples = Samples(np.ones((1000, 1), dtype=bool), np.linspace(0.0, 1.0, 1000), (np.array([0]),))
    fits = [replace(waving(amplitude, 1e4, known), compared={(0, "gauge"): samples}) for known in (1.0, None)]
    hardly, never = (uncertainty(fit).sd[0] for fit in fits)
    assert hardly == pytest.approx(never, rel=1e-3)
