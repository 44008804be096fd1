"""Evidence of fitted models, and what an improvement is worth in time."""

from __future__ import annotations

import numpy as np

from sysid.diagnosis.candidates import Hypothesis
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.covariance import Uncertainty
from sysid.solve.optimum import Fitted


def log_evidence(fitted: Fitted, temper: float) -> float:
    """Laplace evidence of a fit with prior rows, up to a constant common to all models.

    log p = -chi2 / 2 - log det(J^T J) / 2 - sum log(prior widths), with the priors as rows of J. ``temper`` divides the
    weight of the data, not that of the priors, so that a parameter which the data do not touch changes nothing.
    Searches end where their own weights led them, so the least misfit with these weights is taken from where one linear
    step leads.
    """
    count = fitted.pulls
    data = slice(0, len(fitted.residual) - count)
    j, prior = fitted.jacobian[data], fitted.jacobian[len(fitted.residual) - count :]
    pull = fitted.residual[len(fitted.residual) - count :]
    information = j.T @ j / temper + prior.T @ prior
    slope = j.T @ fitted.residual[data] / temper + prior.T @ pull
    widths = float(sum(np.log(p.known_sd or p.prior_sd) for p in fitted.parameters))
    here = (fitted.chi2 - float(pull @ pull)) / temper + float(pull @ pull)
    least = here - float(slope @ np.linalg.solve(information, slope)) if fitted.parameters else here
    return -0.5 * least - 0.5 * float(np.linalg.slogdet(information)[1]) - widths


def held_out_gain(plain: np.ndarray, amended: np.ndarray) -> float:
    """Share of the robust misfit (:func:`_losses`) that an amendment removes, from whitened residuals ``(n,)`` of
    both."""
    before = _loss(plain)
    return (before - _loss(amended)) / before


def log_likelihood_ratio(plain: np.ndarray, amended: np.ndarray) -> np.ndarray:
    """Log likelihood ratio [nats] of two models for each reading ``(n,)`` that neither was fitted to, from whitened
    residuals ``(n,)`` of both; robust (:func:`_losses`), and tempered by the misfit that the better one leaves.

    Without parameters fitted there, no width of a prior and no number of them enters: a model that only follows the
    noise of other recordings loses on average (Vuong, Econometrica 57, 1989, for models compared so).
    """
    before, after = _losses(plain), _losses(amended)
    temper = max(1.0, min(float(before.sum()), float(after.sum())) / max(len(plain), 1))
    return np.asarray(0.5 * (before - after) / temper)


def deviations(ratios: np.ndarray, changes: np.ndarray) -> float:
    """Log likelihood ratio of two models over its standard deviation, as blocks of time differ in it: ``ratios``
    [nats] ``(n,)`` of the blocks, and ``changes`` ``(n,)``, the squares of what the models differ by in them, whitened.

    With the residual r of the plain model and the change D, a ratio is r.D - |D|^2 / 2: over |D|^2 it is how far beyond
    the middle between the two models the readings are, 1/2 where the amended one is right and -1/2 where the plain one
    is. That share, of all blocks together, is compared with how it changes where each block is left out (the jackknife
    of a ratio: Cochran, Sampling Techniques, 1977, section 6.17). What is right is right wherever it acts; what follows
    another model's errors wins in some blocks and loses in others. 0 where fewer than two blocks have a change.
    """
    acting = changes > 0.0
    ratios, changes = ratios[acting], changes[acting]
    n = len(ratios)
    if n < 2:
        return 0.0
    without = (ratios.sum() - ratios) / (changes.sum() - changes)
    variance = (n - 1) / n * float(np.sum((without - without.mean()) ** 2))
    return float(ratios.sum() / changes.sum() / max(np.sqrt(variance), 1e-12))


def _loss(r: np.ndarray) -> float:
    return float(np.sum(_losses(r)))


def _losses(r: np.ndarray) -> np.ndarray:
    """2 w^2 (sqrt(1 + (r/w)^2) - 1) with w = ``DIAGNOSIS.robust_width_sd``: quadratic for noise, linear beyond."""
    w = DIAGNOSIS.robust_width_sd
    return np.asarray(2.0 * w * w * (np.sqrt(1.0 + (r / w) ** 2) - 1.0))


def significance(inflation: float, gain: float) -> float:
    """Standard deviations that a gain [nats] is worth: the square root of the likelihood ratio 2 gain, over
    the ``inflation`` of the best known amplitude by the sandwich estimate (the adjusted likelihood of Chandler &
    Bate 2007). The amplitude's own distance from none would not do: it is short where only its ratio to
    another parameter is determined."""
    return float(np.sqrt(max(2.0 * gain, 0.0)) / inflation)


def inflation_of(hypothesis: Hypothesis, fitted: Fitted, known: Uncertainty) -> float:
    """By how much the noise model alone understates the standard deviation of the amplitude that is known best."""
    amplitudes = {f"effects.{hypothesis.key}.{a.parameter.name}" for a in hypothesis.amplitudes}
    found = [f for p, f in zip(fitted.parameters, known.inflation, strict=True) if p.name in amplitudes]
    return float(min(found, default=1.0))


def distance_from_none(hypothesis: Hypothesis, fitted: Fitted, known: Uncertainty) -> float:
    """How far the effect is from acting on nothing, in standard deviations of that of its sizes which is farthest."""
    sd = known.sd
    at = {p.name: (p, scaled, s) for p, scaled, s in zip(fitted.parameters, fitted.scaled, sd, strict=True)}
    found = 0.0
    for a in hypothesis.amplitudes:
        told = at.get(f"effects.{hypothesis.key}.{a.parameter.name}")
        if told is None:
            continue
        p, scaled, s = told
        if p.log or not np.isfinite(a.none):
            return float("inf")  # In the scale of its logarithm, nothing is infinitely far.
        found = max(found, abs(scaled - a.none) / max(s, 1e-300))
    return found
