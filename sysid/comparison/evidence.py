"""Evidence of sets of directions over a ledger, after all that every model has is integrated out.

Every model has the parameters of the rig, the named approximations, and each column of an effect and of a closure with
a narrow width, the form error: careful simulators differ by a little of everything. With the products G of columns and
residual r, tempered by kappa, and priors N(m, L^-1) of these columns p,

    A = G_pp / kappa + L,    H = G_ss / kappa - G_sp A^-1 G_ps / kappa^2,
    g = -G_sr / kappa - G_sp A^-1 (L m - G_pr / kappa) / kappa,

the Bayes factor of coefficients N(0, S) of further directions s over none is

    log B = 1/2 g^T (H + S^-1)^-1 g - 1/2 log det(1 + S^(1/2) H S^(1/2)) + sum log 2 Phi(mean_k / sd_k),

the last term for amplitudes that are zero or more, by their marginals (Kass & Raftery, J. Am. Stat. Assoc. 90, 1995).

Unknown physics of a place may be any combination of its closures and of the effects that the library has there. With
their columns scaled to one standard deviation of the noise, T = diag(H)^(-1/2), the principal directions of T H T are
directions of their own, of which the faint ones are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.special import log_ndtr
from scipy.stats import truncnorm

from sysid.comparison.ledger import Column, Ledger
from sysid.comparison.priors import PRIORS, TRACES, Priors

FAINT = 0.1
"""Convention: trace below which a direction of unknown physics of the largest size is left out."""

PLAIN = ("parameter", "approximation")
"""Kinds of columns that are in all models with their own priors."""

LEAST_FORM = 1e-4
"""Convention: trace of the form error of each column where no approximation has a size."""

MOST_DIRECTIONS = 40
"""Cost: directions of unknown physics of a place."""


@dataclass(frozen=True)
class Amplitude:
    """Posterior of one amplitude in physical units. ``value``: its mean; ``interval``: 95 %."""

    column: Column
    value: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class Directions:
    """Coefficients of directions. ``index`` ``(k,)``: their numbers; ``sd`` ``(k,)``: of their priors; ``one_sided``
    ``(k,)``."""

    index: np.ndarray
    sd: np.ndarray
    one_sided: np.ndarray


def joined(parts: Sequence[Directions]) -> Directions:
    """All of several directions."""
    return Directions(
        np.concatenate([np.zeros(0, dtype=int), *(p.index for p in parts)]),
        np.concatenate([np.zeros(0), *(p.sd for p in parts)]),
        np.concatenate([np.zeros(0, dtype=bool), *(p.one_sided for p in parts)]),
    )


class Evidence:
    """Bayes factors over a ledger. ``weights`` ``(blocks,)``: of the blocks, all 1 by default; ``temper``: mean squared
    residual of the best model, by which the weight of the data is divided; ``like``: evidence of the same ledger, whose
    form error and directions are to be had.

    ``shapes``: by effect and label of a shape, the numbers of its directions; ``unknown``: by place, those of unknown
    physics, each with a coefficient of one standard deviation of the noise in all."""

    def __init__(
        self,
        ledger: Ledger,
        weights: np.ndarray | None = None,
        *,
        priors: Priors = PRIORS,
        temper: float = 1.0,
        like: Evidence | None = None,
    ) -> None:
        columns, n = ledger.columns, len(ledger.columns)
        grams = np.stack([b.gram for b in ledger.blocks])
        whole = np.tensordot(np.ones(len(grams)) if weights is None else weights, grams, 1) / temper
        kinds = np.array([c.kind for c in columns])
        sd, mean = np.array([c.prior_sd for c in columns]), np.array([c.prior_mean for c in columns])
        plain = np.flatnonzero(np.isin(kinds, PLAIN))
        own = np.concatenate([np.flatnonzero(kinds == "effect"), np.flatnonzero(kinds == "closure")])
        self._plain = [columns[k] for k in plain]
        self.columns, self._own, self._whole, self.temper = [columns[k] for k in own], own, whole, temper
        self.sd = np.array([c.prior_sd for c in self.columns])
        self.one_sided = np.array([c.one_sided for c in self.columns], dtype=bool)
        self._readings = ledger.readings
        self._form: np.ndarray = (
            self._form_error(whole, sd, mean, own, kinds, priors.form) if like is None else like._form
        )
        self._base, width = np.concatenate([plain, own]), np.concatenate([sd[plain], self._form])
        self._precision, self._mean = width**-2.0, mean[self._base] * np.isin(self._base, plain)
        inner = cho_factor(whole[np.ix_(self._base, self._base)] + np.diag(self._precision), lower=True)
        self._pull = self._precision * self._mean - whole[self._base, n]
        solved = cho_solve(inner, np.column_stack([whole[np.ix_(self._base, own)], self._pull]))
        self._information = whole[np.ix_(own, own)] - whole[np.ix_(own, self._base)] @ solved[:, :-1]
        self._slope = -whole[own, n] - whole[np.ix_(own, self._base)] @ solved[:, -1]
        determinant = 2.0 * float(np.sum(np.log(np.diag(inner[0])) + np.log(width)))
        fit = float(self._pull @ solved[:, -1]) - float(np.sum(self._mean**2 * self._precision)) - float(whole[n, n])
        self.log_marginal = 0.5 * (fit - determinant)
        self.shapes: dict[tuple[str, str], np.ndarray] = {}
        for k, c in enumerate(self.columns):
            if c.kind == "effect":
                key = (c.owner, c.hypothesis)
                self.shapes[key] = np.append(self.shapes.get(key, np.zeros(0, dtype=int)), k)
        self._bases: dict[str, np.ndarray] = self._unknown_bases() if like is None else like._bases
        self._stack()

    def _form_error(
        self, whole: np.ndarray, sd: np.ndarray, mean: np.ndarray, own: np.ndarray, kinds: np.ndarray, form: float
    ) -> np.ndarray:
        """Width of each column of an effect or closure in all models ``(k,)``: so that it changes the readings by a
        share of what the named approximations do, and no more than its prior."""
        parameters, named = np.flatnonzero(kinds == "parameter"), np.flatnonzero(kinds == "approximation")
        plain = np.concatenate([parameters, named])
        left = np.diag(_left(whole, parameters, sd[parameters] ** -2.0, named))
        size = np.sqrt(max(float(np.sum(left * (sd[named] ** 2 + mean[named] ** 2))), 0.0))
        traces = np.sqrt(np.maximum(np.diag(_left(whole, plain, sd[plain] ** -2.0, own)), 1e-12))
        return np.asarray(np.minimum(np.maximum(form * size, LEAST_FORM) / traces, sd[own]))

    def _unknown_bases(self) -> dict[str, np.ndarray]:
        """By place, combinations ``(own, r)`` of columns that are its principal directions."""
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self._information), 1e-12))
        places = np.array([c.place for c in self.columns])
        found = {}
        for place in dict.fromkeys(places):
            mine = np.flatnonzero(places == place)
            table = scale[mine][:, None] * self._information[np.ix_(mine, mine)] * scale[mine] / len(mine)
            sizes, directions = np.linalg.eigh(table)
            kept = np.flatnonzero(sizes * TRACES[-1] ** 2 > FAINT**2)[::-1][:MOST_DIRECTIONS]
            base = np.zeros((len(self.columns), len(kept)))
            base[mine] = directions[:, kept] * scale[mine][:, None] / np.sqrt(len(mine))
            found[str(place)] = base
        return found

    def _stack(self) -> None:
        """Directions: the columns, then those of unknown physics."""
        whole = np.hstack([np.eye(len(self.columns)), *self._bases.values()])
        self.information, self.slope = whole.T @ self._information @ whole, whole.T @ self._slope
        self._combinations = whole
        self.unknown, at = {}, len(self.columns)
        for place, base in self._bases.items():
            self.unknown[place] = np.arange(at, at + base.shape[1])
            at += base.shape[1]

    def directions(self, shape: tuple[str, str], scale: float = 1.0) -> Directions:
        """Those of one shape of an effect, with a part of the width of its prior."""
        k = self.shapes[shape]
        return Directions(k, scale * self.sd[k], self.one_sided[k])

    def unknown_directions(self, place: str, trace: float) -> Directions:
        """Those of unknown physics in a place that changes the readings by so many standard deviations."""
        k = self.unknown[place]
        return Directions(k, np.full(len(k), trace), np.zeros(len(k), dtype=bool))

    def factor(self, chosen: Directions) -> float:
        """log B of directions."""
        k, sd = chosen.index, chosen.sd
        if not len(k):
            return 0.0
        table = sd[:, None] * self.information[np.ix_(k, k)] * sd
        table[np.diag_indices(len(k))] += 1.0
        root = np.linalg.cholesky(table)
        solved = solve_triangular(root, self.slope[k] * sd, lower=True, check_finite=False)
        found = 0.5 * float(solved @ solved) - float(np.sum(np.log(np.diag(root))))
        if chosen.one_sided.any():
            inverse = solve_triangular(root, np.eye(len(k)), lower=True, check_finite=False)
            deviations = np.sqrt(np.sum(inverse**2, axis=0))
            found += float(np.sum((np.log(2.0) + log_ndtr(inverse.T @ solved / deviations))[chosen.one_sided]))
        return found

    def explained(self, chosen: Directions) -> float:
        """How much of the readings is explained by directions, in standard deviations of the noise."""
        (mean,) = self._solved(chosen)[:1]
        return float(np.sqrt(max(float(self.slope[chosen.index] @ mean), 0.0)))

    def left(self, chosen: Directions) -> float:
        """Mean squared whitened residual of the most probable parameters and amplitudes, 1 for noise alone."""
        n, own = len(self._whole) - 1, len(self._own)
        combined = self._combinations[:, chosen.index]
        base = len(self._base)
        maps = np.zeros((n + 1, base + len(chosen.index) + 1))
        maps[self._base, np.arange(base)] = 1.0
        maps[self._own, base:-1] += combined[:own]
        maps[n, -1] = 1.0
        table = maps.T @ self._whole @ maps
        precision = np.concatenate([self._precision, chosen.sd**-2.0])
        pull = np.concatenate([self._precision * self._mean, np.zeros(len(chosen.index))])
        best = np.linalg.solve(table[:-1, :-1] + np.diag(precision), pull - table[:-1, -1])
        z = np.append(best, 1.0)
        return float(self.temper * (z @ table @ z) / max(self._readings, 1))

    def trace(self, shape: tuple[str, str], factors: np.ndarray) -> float:
        """How much an effect with these factors changes the readings, in standard deviations of the noise, less what
        all models have."""
        s = self.shapes[shape]
        return float(np.sqrt(max(0.0, factors @ self.information[np.ix_(s, s)] @ factors) * self.temper))

    def amplitudes(self, chosen: Directions) -> list[Amplitude]:
        """Marginal posterior of each amplitude of an effect; unknown physics has no size of its own."""
        mean, covariance = self._solved(chosen)
        found = []
        for k, m, sd in zip(chosen.index, mean, np.sqrt(np.diag(covariance)), strict=True):
            if k >= len(self.columns):
                continue
            c = self.columns[k]
            low = (max(c.lower, 0.0) if c.one_sided else c.lower) - m
            marginal = truncnorm(low / sd, (c.upper - m) / sd, loc=m, scale=sd)
            ends = sorted(_physical(c, float(v)) for v in marginal.ppf([0.025, 0.975]))
            found.append(Amplitude(c, _physical(c, float(marginal.mean())), (ends[0], ends[1])))
        return found

    def fitted_amplitudes(self, chosen: Directions) -> list[Amplitude]:
        """Posterior of each parameter of the effects that the ledger is linearised with, jointly with directions."""
        own, count = self._combinations[: len(self._own), chosen.index], len(self._base)
        maps = np.zeros((len(self._whole), count + len(chosen.index) + 1))
        maps[self._base, np.arange(count)] = 1.0
        maps[self._own, count:-1] += own
        maps[-1, -1] = 1.0
        table = maps.T @ self._whole @ maps
        precision = np.concatenate([self._precision, chosen.sd**-2.0])
        pull = np.concatenate([self._precision * self._mean, np.zeros(len(chosen.index))]) - table[:-1, -1]
        covariance = np.linalg.inv(table[:-1, :-1] + np.diag(precision))
        mean, sd = covariance @ pull, np.sqrt(np.diag(covariance))
        return [
            Amplitude(c, _physical(c, m), (_physical(c, m - 1.96 * s), _physical(c, m + 1.96 * s)))
            for c, m, s in zip(self._plain, mean, sd, strict=False)
            if c.kind == "parameter" and c.hypothesis
        ]

    def _solved(self, chosen: Directions) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of coefficients."""
        k = chosen.index
        covariance = np.linalg.inv(self.information[np.ix_(k, k)] + np.diag(chosen.sd**-2.0))
        return covariance @ self.slope[k], covariance


def residual_products(ledger: Ledger, wanted: np.ndarray) -> np.ndarray:
    """Products ``(k, k)`` of columns of a ledger less what parameters and approximations take up."""
    base = np.flatnonzero(np.isin([c.kind for c in ledger.columns], PLAIN))
    precision = np.array([ledger.columns[k].prior_sd for k in base]) ** -2.0
    return _left(ledger.gram, base, precision, wanted)


def _left(whole: np.ndarray, base: np.ndarray, precision: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Products of columns less what a base takes up of them ``(k, k)``."""
    inner = cho_factor(whole[np.ix_(base, base)] + np.diag(precision), lower=True)
    cross = whole[np.ix_(base, wanted)]
    return np.asarray(whole[np.ix_(wanted, wanted)] - cross.T @ cho_solve(inner, cross))


def _physical(column: Column, factor: float) -> float:
    value = column.at + factor * column.scale
    return float(np.exp(value)) if column.log else value
