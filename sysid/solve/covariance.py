"""How well a fit determines its parameters, and what it cannot tell apart.

Three covariances are compared parameter by parameter and the largest is kept: the inverse Fisher matrix of
the whitened residuals, widened by the misfit where the model does not reach the noise, the sandwich
estimate H^-1 (sum_b s_b s_b^T) H^-1 over blocks b of neighbouring samples (s_b = J_b^T r_b), which does
not trust the noise model in time (White 1982; Newey & West 1987), and that of the colour of what the fit leaves
(:mod:`sysid.noise.autocorrelation`).

Sentences are about the parameters that were asked for, with the nuisances projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sysid.model.parameters import FitParameter
from sysid.noise.autocorrelation import autocorrelated_scores
from sysid.settings.solve import SOLVE
from sysid.solve.optimum import Fitted


class Finding(NamedTuple):
    """A sentence on what the data tell of parameters, and the names of those that it says they do not determine."""

    sentence: str
    undetermined: tuple[str, ...] = ()


@dataclass(frozen=True)
class Uncertainty:
    """``sd``: in the fitted scale ``(p,)``; ``inflation``: by how much the largest estimate exceeds what the
    noise model alone says, 1 where it does not ``(p,)``; ``correlation``: ``(p, p)``; ``findings``: what the
    data cannot determine, in words; ``reduced_chi2``: misfit over noise."""

    sd: np.ndarray
    inflation: np.ndarray
    correlation: np.ndarray
    findings: tuple[Finding, ...]
    reduced_chi2: float

    @property
    def sentences(self) -> tuple[str, ...]:
        """What the data cannot determine."""
        return tuple(found.sentence for found in self.findings)


def uncertainty(fitted: Fitted) -> Uncertainty:
    """Uncertainty of a fit in its scaled parameters.

    How the discretisation error changes with them tells nothing of a parameter, as its size is not known: the larger of
    the deviations with and without that counts."""
    if not fitted.parameters:
        return Uncertainty(np.zeros(0), np.ones(0), np.zeros((0, 0)), (), _reduced(fitted))
    sd, inflation, correlation = _spread(fitted)
    wider = fitted
    if fitted.still is not None:
        without = replace(fitted, jacobian=fitted.still)
        still, _, other = _spread(without)
        if not np.all(sd >= still):
            wider, correlation = without, other
        inflation = np.maximum(inflation, still / (sd / inflation))
        sd = np.maximum(sd, still)
    found = _undetermined(wider, sd)
    found += _wide(fitted, sd, names_undetermined(found))
    found += _together(fitted.parameters, fitted.scaled, correlation, sd)
    return Uncertainty(sd, inflation, correlation, tuple(found), _reduced(fitted))


def names_undetermined(findings: Sequence[Finding]) -> set[str]:
    """Names of the parameters that the data do not determine."""
    return {name for found in findings for name in found.undetermined}


def _reduced(fitted: Fitted) -> float:
    """Reduced chi-square."""
    return fitted.chi2 / max(fitted.samples - len(fitted.parameters), 1)


def _tempered(fitted: Fitted, worth: float) -> np.ndarray:
    """The jacobian with what the recordings tell, not what was known before, worth as much less as the model misses
    them by more than their noise: (J^T J / worth + P)^-1 is the covariance of the tempered posterior."""
    rows: np.ndarray = fitted.jacobian.copy()
    rows[: len(rows) - fitted.pulls] /= np.sqrt(worth)
    return rows


def _spread(fitted: Fitted) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviations ``(p,)`` by the jacobian of a fit, by how much they exceed what the noise says ``(p,)``, and
    correlation ``(p, p)``.

    The search weighs recordings by 1 / kappa against the prior (:mod:`sysid.solve.gauss_newton`). Its
    estimate has the covariance A (J^T S J / kappa^2 + P) A, where A = (J^T J / kappa + P)^-1 and J^T S J is that of the
    scores.
    """
    prior = np.array([q.prior_sd for q in fitted.parameters])
    reduced = max(1.0, _reduced(fitted))
    kappa = max(overdispersion(fitted), reduced) if fitted.has_prior else 1.0
    inverse = inverse_information(_tempered(fitted, kappa), prior)
    plain = inverse_information(_tempered(fitted, reduced), prior)
    data, known = np.split(fitted.jacobian, [len(fitted.jacobian) - fitted.pulls])
    scores = _scores(fitted, fitted.residual)
    sandwich = inverse @ (scores.T @ scores / kappa**2 + known.T @ known) @ inverse
    colour = data.T @ data + autocorrelated_scores(fitted.parts, inverse / kappa)
    coloured = inverse @ (colour / kappa**2 + known.T @ known) @ inverse
    variance = np.max([np.diag(v) for v in (plain, sandwich, coloured)], axis=0)
    sd = np.minimum(np.sqrt(np.maximum(variance, 0.0)), SOLVE.widest_sd * prior)
    spread = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    correlation = np.clip(inverse / np.outer(spread, spread), -1.0, 1.0)
    return sd, np.sqrt(variance / np.maximum(np.diag(plain), 1e-300)), correlation


def inverse_information(jacobian: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """(J^T J)^-1 ``(p, p)``, no direction wider than ``SOLVE.widest_sd`` of the plausible ranges ``prior`` ``(p,)``."""
    values, vectors = _information(jacobian * prior)
    inverse = (vectors / np.maximum(values, SOLVE.widest_sd**-2)) @ vectors.T
    return np.asarray(inverse * np.outer(prior, prior))


def marginal(fitted: Fitted) -> tuple[list[FitParameter], np.ndarray, np.ndarray]:
    """The parameters that were asked for, the information about them with the nuisances unknown, in units of what they
    are judged by ``(q,)``, least first, and its directions ``(q, q)``."""
    width = np.array([p.width(at) for p, at in zip(fitted.parameters, fitted.scaled, strict=True)])
    aside = np.array([p.nuisance for p in fitted.parameters])
    columns = (fitted.jacobian * width)[:, ~aside]
    if aside.any():
        basis = np.linalg.qr((fitted.jacobian * width)[:, aside])[0]
        columns = columns - basis @ (basis.T @ columns)
    return [p for p in fitted.parameters if not p.nuisance], *_information(columns)


def _scores(fitted: Fitted, residual: np.ndarray) -> np.ndarray:
    """J^T r of each block of neighbouring samples ``(blocks, p)``."""
    out = [np.zeros((0, len(fitted.parameters)))]
    at = 0
    for _, _, times in fitted.labels[: -1 if fitted.has_prior else None]:
        rows = slice(at, at + len(times))
        at += len(times)
        if not len(times):
            continue
        edges = np.linspace(times.min(), times.max() + 1e-9, SOLVE.sandwich_blocks + 1)
        block = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, SOLVE.sandwich_blocks - 1)
        scores = np.zeros((SOLVE.sandwich_blocks, len(fitted.parameters)))
        np.add.at(scores, block, fitted.jacobian[rows] * residual[rows, None])
        out.append(scores)
    return np.concatenate(out)


def overdispersion(fitted: Fitted) -> float:
    """Improvement of chi-square that each parameter brings about by fitting chance, at least 1:
    tr(H^-1 sum_b s_b s_b^T) / p (Takeuchi 1976), with the scores s_b of what one linear step of least squares
    leaves. 1 for white noise, large for a misfit with structure, in which neighbouring samples repeat each
    other."""
    prior = np.array([q.prior_sd for q in fitted.parameters])
    values, vectors = _information(fitted.jacobian * prior)
    spread = prior[:, None] * vectors / np.sqrt(np.maximum(values, SOLVE.widest_sd**-2))
    left = fitted.residual - fitted.jacobian @ (spread @ (spread.T @ (fitted.jacobian.T @ fitted.residual)))
    return max(1.0, float(np.sum((_scores(fitted, left) @ spread) ** 2)) / len(prior))


def _information(jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information in each direction of the parameters, least first ``(p,)``, and the directions as columns
    ``(p, p)``. What is below the round-off of the most informative direction is none at all."""
    p = jacobian.shape[1]
    triangle = np.linalg.qr(np.vstack([jacobian, np.zeros((p, p))]), mode="r")
    _, singular, rows = np.linalg.svd(triangle)
    singular[singular <= 1e-12 * singular[0]] = 0.0
    return singular[::-1] ** 2, rows[::-1].T


def _undetermined(fitted: Fitted, sd: np.ndarray) -> list[Finding]:
    """One for each direction that is not determined. ``sd``: of each parameter ``(p,)``."""
    parameters, values, vectors = marginal(replace(fitted, jacobian=_tempered(fitted, max(1.0, _reduced(fitted)))))
    at = {p.name: (x, spread) for p, x, spread in zip(fitted.parameters, fitted.scaled, sd, strict=True)}
    out = []
    for value, vector in zip(values, vectors.T, strict=True):
        if 1.0 / np.sqrt(max(value, 1e-300)) < SOLVE.undetermined_share:
            continue
        strong = np.flatnonzero(np.abs(vector) > 0.25)
        if len(strong) == 1:
            p = parameters[strong[0]]
            low, high = interval(p, *at[p.name])
            both = f"{f'{low:.3g} to {high:.3g} {p.unit}'.strip()} fit about as well"
            out.append(_not_determined(p, both))
            continue
        changes = []
        for k in strong:
            p = parameters[k]
            step = 0.1 * vector[k] / np.max(np.abs(vector))
            amount = p.width(at[p.name][0]) * step
            changes.append(
                f"{p.name} {'up' if amount > 0 else 'down'} by "
                + (f"{100 * abs(np.expm1(amount)):.2g} %" if p.log else f"{abs(amount):.2g} {p.unit}".rstrip())
            )
        names = tuple(parameters[k].name for k in strong)
        sentence = (
            f"The data do not determine {' and '.join(names)} separately, only in combination: {', '.join(changes)} "
            "together leave every reading as it is. Fix one of them, or record a motion that separates them."
        )
        out.append(Finding(sentence, names))
    return out


def _not_determined(parameter: FitParameter, why: str) -> Finding:
    name = parameter.name
    remedy = "Record a motion that depends on it, or fix it."
    return Finding(f"The data do not determine {name}: {why}. {remedy}", (name,))


def _no_more_than_known(parameter: FitParameter, reduced: float) -> Finding:
    """Recordings that a rig misses by far count for nothing against the prior: what they would say is unknown."""
    if reduced <= SOLVE.poor_reduced_chi2:
        return _not_determined(parameter, "its interval is what was known of it before")
    sentence = (
        f"What was known of {parameter.name} before alone decides on it, since the rig misses the recordings by "
        f"{np.sqrt(reduced):.2g} times their noise. Fit without that to see what they ask for."
    )
    return Finding(sentence, (parameter.name,))


def _wide(fitted: Fitted, sd: np.ndarray, said: set[str]) -> list[Finding]:
    """One for each parameter whose interval is too wide to determine it, unless it was named before: the noise
    alone would not leave it so wide, but what the rig does not explain, or a prior that says little, does."""
    out = []
    for p, scaled, spread in zip(fitted.parameters, fitted.scaled, sd, strict=True):
        if p.nuisance or p.name in said:
            continue
        if p.known_sd is not None and spread > SOLVE.uninformative_ratio * p.known_sd:
            out.append(_no_more_than_known(p, _reduced(fitted)))
            continue
        low, high = p.scaled_bounds
        if scaled - 1.96 * spread <= low and scaled + 1.96 * spread >= high:
            where = f"spans all possible values, {p.lower:g} to {p.upper:g} {p.unit}".rstrip()
        elif spread >= SOLVE.undetermined_share * p.width(scaled):
            first, last = interval(p, scaled, spread)
            where = f"is {first:.3g} to {last:.3g} {p.unit}".rstrip()
        else:
            continue
        out.append(_not_determined(p, f"its 95 % interval {where}"))
    return out


def _together(
    parameters: list[FitParameter], scaled: np.ndarray, correlation: np.ndarray, sd: np.ndarray
) -> list[Finding]:
    """One for each pair that is determined but strongly traded off."""
    out = []
    for a in range(len(parameters)):
        for b in range(a):
            if parameters[a].nuisance or parameters[b].nuisance:
                continue
            c = correlation[a, b]
            limit = SOLVE.undetermined_share * max(parameters[k].width(scaled[k]) for k in (a, b))
            if abs(c) > SOLVE.combined_correlation and max(sd[a], sd[b]) < limit:
                way = "up" if c > 0 else "down"
                sentence = (
                    f"{parameters[b].name} and {parameters[a].name} are traded off against each other "
                    f"(correlation {c:.3f}): if one is really higher, the other goes {way}."
                )
                out.append(Finding(sentence))
    return out


def interval(parameter: FitParameter, scaled: float, sd: float) -> tuple[float, float]:
    """95 % interval in physical units, cut at the bounds."""
    low, high = parameter.physical(scaled - 1.96 * sd), parameter.physical(scaled + 1.96 * sd)
    return low, high
