"""The numbers of the posterior that are learnt: the form error and prior weights (:class:`Priors`).

Recordings that conceal nothing, whose truth is another formulation, have the marginal likelihood

    log p(y | nothing) = 1/2 b^T A^-1 b - 1/2 log det A + 1/2 log det L - 1/2 m^T L m - 1/2 r^T r + const,

with the precision A = G + L and b = L m - G_r of parameters, approximations and the form error about their means m. Its
sum over such recordings is largest at the form error that is learnt (type II maximum likelihood: MacKay, Neural
Computation 4, 1992), with what the tool has as a prior, to a factor of e.

Logarithms w of prior weights have no part in these recordings. Models k of a case, log B_k their Bayes factors and
n_k what they count of each weight, have the probability p_k ~ B_k exp(n_k w), and what is concealed the probability
p = sum of those that say it, with the derivative

    d log p / dw = E[n | what is concealed] - E[n].

The mean of log((1 - u) p + u) over cases is made largest, with u the share of recordings that no model describes,
which bounds what one of them can cost, and what the tool has as a prior, to a standard deviation of w.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.special import logsumexp

from sysid.comparison.evidence import Evidence
from sysid.comparison.ledger import Ledger
from sysid.comparison.posterior import Compared
from sysid.comparison.priors import PRIORS, Priors

LEAST, MOST = 1e-4, 1.0
"""Convention: bounds of a width that is learnt."""

KNOWN_TO = 1.0
"""Convention: standard deviation of the logarithm of a width or of a prior weight before it is learnt."""

UNDESCRIBED = 0.01
"""Convention: share of recordings that no model describes."""

EMPTY = 0.5
"""Convention: share of recordings in which nothing is missing."""


@dataclass(frozen=True)
class Case:
    """One case with a known truth. ``counts`` ``(n, f)``: of the candidates; ``logs`` ``(n,)``: logarithms of all else
    of their probabilities; ``true`` ``(n,)``: which of them say what is concealed; ``weight``: of the case."""

    counts: np.ndarray
    logs: np.ndarray
    true: np.ndarray
    weight: float = 1.0

    @staticmethod
    def of(found: Compared, names: Sequence[str], weight: float = 1.0) -> Case:
        """Of a comparison and the names of what is concealed."""
        counts = np.array([c.counts for c in found.candidates])
        true = np.array([set(c.names) == set(names) for c in found.candidates])
        return Case(counts, found.logs(np.zeros(counts.shape[1])), true, weight)

    def probability(self, weights: np.ndarray) -> float:
        """Of what is concealed."""
        logs = self.logs + self.counts @ weights
        return float(np.exp(logs - logsumexp(logs))[self.true].sum())


def log_marginal(ledger: Ledger, priors: Priors = PRIORS) -> float:
    """log p(y | nothing) but for a constant [nats]."""
    return Evidence(ledger, priors=priors).log_marginal


def learnt_form(ledgers: Sequence[Ledger], priors: Priors = PRIORS) -> Priors:
    """The size of the form error, from recordings that conceal nothing."""

    def loss(at: float) -> float:
        each = [log_marginal(one, replace(priors, form=float(np.exp(at)))) for one in ledgers]
        return float(0.5 * ((at - np.log(priors.form)) / KNOWN_TO) ** 2 - np.sum(each))

    found = minimize_scalar(loss, bounds=np.log([LEAST, MOST]), method="bounded", options={"xatol": 0.05})
    return replace(priors, form=float(np.exp(found.x)))


def score(cases: Sequence[Case], weights: np.ndarray) -> tuple[float, np.ndarray]:
    """Sum of the logarithmic score of cases by their weights, and its derivative ``(f,)``."""
    value, slope = 0.0, np.zeros(len(weights))
    for case in cases:
        logs = case.logs + case.counts @ weights
        shares = np.exp(logs - logsumexp(logs))
        p = float(shares[case.true].sum())
        mixed = (1.0 - UNDESCRIBED) * p + UNDESCRIBED
        value += case.weight * float(np.log(mixed))
        if p > 0.0:
            gain = shares[case.true] @ case.counts[case.true] - p * (shares @ case.counts)
            slope += case.weight * (1.0 - UNDESCRIBED) / mixed * gain
    return value, slope


def learnt_weights(cases: Sequence[Case], priors: Priors = PRIORS) -> Priors:
    """The prior weights, from cases with a known truth."""
    start = priors.weights

    def loss(at: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = score(cases, at)
        away = (at - start) / KNOWN_TO
        return 0.5 * float(away @ away) - value, away / KNOWN_TO - slope

    found = minimize(loss, start, jac=True, method="L-BFGS-B").x
    return Priors.of_weights(found, priors.form)


def shared_out(cases: Sequence[Case], empty: Sequence[Case]) -> list[Case]:
    """All cases, with weights that give those in which nothing is missing their share."""
    each = EMPTY / (1.0 - EMPTY) * len(cases) / max(len(empty), 1)
    return [*cases, *(replace(one, weight=each) for one in empty)]
