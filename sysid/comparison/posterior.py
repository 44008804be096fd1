"""Posterior probabilities of what is missing, from the ledger of a diagnosis.

A model is a set of effects and of slots with physics that is unknown. The coefficients of the closures of a slot, in
units of what it is known to within, are N(0, w^2) in all models, by which careful simulators differ, and N(0, W^2)
where the slot is one of the set. With the products G of columns and residual r, tempered by kappa, priors N(m, L^-1) of
parameters and narrow closures p and N(0, S) of what a set adds with columns s, the former are integrated out once,

    A = G_pp / kappa + L,    H = G_ss / kappa - G_sp A^-1 G_ps / kappa^2,
    g = -G_sr / kappa - G_sp A^-1 (L m - G_pr / kappa) / kappa,

and the Bayes factor of the set over the rig without any effect is

    log B = 1/2 g^T (H + S^-1)^-1 g - 1/2 log det(1 + S^(1/2) H S^(1/2)) + sum log 2 Phi(mean_k / sd_k),

the last term for amplitudes that are zero or more, by their marginals (Kass & Raftery, J. Am. Stat. Assoc. 90, 1995).
The temper kappa is the mean squared residual that all columns together leave, at least 1. Shapes of an effect are
equally probable, effects and slots are missing independently of each other, and nothing is missing with the prior
probability one half. All single ones and all pairs are computed; triples extend the most probable pairs.

Probabilities are the mean over bootstrap samples of the blocks (bagged posterior: Huggins & Miller, arXiv 1912.07104),
which makes them honest where no model is right and blocks disagree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import log_ndtr, logsumexp
from scipy.stats import truncnorm

from sysid.comparison.ledger import Column, Ledger

NOTHING_MISSING = 0.5
"""Convention: prior probability that nothing is missing."""

BACKGROUND_WIDTH = 0.02
"""Prior: w, standard deviation of the coefficients of closures where careful simulators differ, in units of that where
the physics of a slot is unknown. The marginal likelihood of ten empty strips by another formulation is largest at 0.003
and as good as that from 0.001 to 0.005; this is wider, since one stand is not all stands."""

UNKNOWN_WIDTH = 1.0
"""Prior: W, likewise where it is unknown."""

UNKNOWN = "unknown: "
"""Begin of the name of a slot with unknown physics, where effects have their names."""

EXTENDED_PAIRS = 20
"""Cost: most probable pairs of effects that a third effect is added to."""

BAGS = 200
"""Cost: bootstrap samples of the blocks; the standard error of a probability is at most 1 / (2 BAGS^(1/2))."""

BAGGED_MODELS = 60
"""Cost: most probable models of which bootstrap samples are taken; others keep the share that they have in all data."""


@dataclass(frozen=True)
class Amplitude:
    """Posterior of one amplitude in physical units. ``value``: its mean; ``interval``: 95 %."""

    column: Column
    value: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class Model:
    """A set of effects and of slots with unknown physics, empty where nothing is missing. ``log_bayes_factor`` [nats]:
    over nothing missing, averaged over shapes; ``hypotheses``: the most probable shape of each effect."""

    effects: tuple[str, ...]
    hypotheses: tuple[str, ...]
    log_bayes_factor: float
    probability: float


@dataclass(frozen=True)
class Posterior:
    """``models``: most probable first."""

    models: tuple[Model, ...]

    @property
    def nothing(self) -> float:
        """Probability that no effect of the library is missing."""
        return next(m.probability for m in self.models if not m.effects)

    @property
    def unknown(self) -> float:
        """Probability that some physics is missing that the library does not have."""
        return sum(m.probability for m in self.models if any(e.startswith(UNKNOWN) for e in m.effects))

    @property
    def inclusion(self) -> dict[str, float]:
        """Probability of each effect that it is missing, largest first."""
        found: dict[str, float] = {}
        for m in self.models:
            for e in m.effects:
                found[e] = found.get(e, 0.0) + m.probability
        return dict(sorted(found.items(), key=lambda pair: -pair[1]))

    def credible(self, level: float = 0.95) -> tuple[Model, ...]:
        """The fewest models that hold this probability together."""
        sums = np.cumsum([m.probability for m in self.models])
        return self.models[: int(np.searchsorted(sums, level)) + 1]


@dataclass(frozen=True)
class Widths:
    """Standard deviations of the coefficients of closures, in units of their own: where careful simulators differ, and
    where the physics is unknown."""

    background: float = BACKGROUND_WIDTH
    unknown: float = UNKNOWN_WIDTH


class Evidence:
    """Bayes factors of sets of hypotheses over a ledger. ``weights`` ``(blocks,)``: of the blocks, all 1 by default;
    ``temper``: mean squared residual of the best model, by which the weight of the data is divided."""

    def __init__(
        self, ledger: Ledger, weights: np.ndarray | None = None, *, widths: Widths = Widths(), temper: float = 1.0
    ) -> None:
        columns, n = ledger.columns, len(ledger.columns)
        grams = np.stack([b.gram for b in ledger.blocks])
        whole = np.tensordot(np.ones(len(grams)) if weights is None else weights, grams, 1) / temper
        base = [k for k, c in enumerate(columns) if c.kind != "effect"]
        own = [k for k, c in enumerate(columns) if c.kind != "parameter"]
        more = np.sqrt(widths.unknown**2 - widths.background**2)
        narrow = [c.prior_sd * (widths.background if c.kind == "closure" else 1.0) for c in columns]
        self._columns = [columns[k] for k in own]
        self._sd = np.array([c.prior_sd * (more if c.kind == "closure" else 1.0) for c in self._columns])
        self._base, self._own = np.array(base, dtype=int), np.array(own, dtype=int)
        self._precision = np.array([narrow[k] ** -2 for k in base])
        self._pull = self._precision * np.array([columns[k].prior_mean for k in base]) - whole[self._base, n]
        self._slope, self._information = -whole[self._own, n], whole[np.ix_(self._own, self._own)]
        if base:
            inner = cho_factor(whole[np.ix_(base, base)] + np.diag(self._precision), lower=True)
            solved = cho_solve(inner, np.column_stack([whole[np.ix_(base, own)], self._pull]))
            self._information = self._information - whole[np.ix_(own, base)] @ solved[:, :-1]
            self._slope = self._slope - whole[np.ix_(own, base)] @ solved[:, -1]
        self._whole, self._temper = whole, temper
        self._readings = sum(b.readings for b in ledger.blocks)
        self._one_sided = np.array([c.one_sided for c in self._columns], dtype=bool)
        places: dict[tuple[str, str], list[int]] = {}
        for k, c in enumerate(self._columns):
            key = (c.owner, c.hypothesis) if c.kind == "effect" else (f"{UNKNOWN}{c.owner}", "")
            places.setdefault(key, []).append(k)
        self.places = {key: np.array(k) for key, k in places.items()}

    def factor(self, hypotheses: Sequence[tuple[str, str]]) -> float:
        """log B of hypotheses, each an effect and a shape of it."""
        mean, covariance, s = self._solved(hypotheses)
        sd = self._sd[s]
        occam = float(np.linalg.slogdet(np.eye(len(s)) + sd[:, None] * self._information[np.ix_(s, s)] * sd)[1])
        sided = self._one_sided[s]
        positive = np.log(2.0) + log_ndtr(mean[sided] / np.sqrt(np.diag(covariance)[sided]))
        return 0.5 * float(self._slope[s] @ mean) - 0.5 * occam + float(np.sum(positive))

    def left(self, hypotheses: Sequence[tuple[str, str]]) -> float:
        """Mean squared whitened residual of the most probable parameters and amplitudes, 1 for noise alone."""
        n = len(self._whole) - 1
        s = np.concatenate([self.places[h] for h in hypotheses]).astype(int) if hypotheses else np.zeros(0, int)
        chosen = np.concatenate([self._base, self._own[s]])
        precision = np.concatenate([self._precision, self._sd[s] ** -2])
        slope = np.concatenate([self._pull, -self._whole[self._own[s], n]])
        best = np.linalg.solve(self._whole[np.ix_(chosen, chosen)] + np.diag(precision), slope)
        whole, z = np.append(chosen, n), np.append(best, 1.0)
        return float(self._temper * (z @ self._whole[np.ix_(whole, whole)] @ z) / max(self._readings, 1))

    def trace(self, hypothesis: tuple[str, str], factors: np.ndarray) -> float:
        """How much an effect with these factors changes the readings, in standard deviations of the noise, less what
        parameters and narrow closures take up."""
        s = self.places[hypothesis]
        return float(np.sqrt(max(0.0, factors @ self._information[np.ix_(s, s)] @ factors) * self._temper))

    def amplitudes(self, hypotheses: Sequence[tuple[str, str]]) -> list[Amplitude]:
        """Marginal posterior of each amplitude of hypotheses; coefficients of closures have no size of their own."""
        mean, covariance, s = self._solved(hypotheses)
        found = []
        for k, m, sd in zip(s, mean, np.sqrt(np.diag(covariance)), strict=True):
            c = self._columns[k]
            if c.kind == "closure":
                continue
            low = (max(c.lower, 0.0) if c.one_sided else c.lower) - m
            marginal = truncnorm(low / sd, (c.upper - m) / sd, loc=m, scale=sd)
            ends = sorted(_physical(c, float(v)) for v in marginal.ppf([0.025, 0.975]))
            found.append(Amplitude(c, _physical(c, float(marginal.mean())), (ends[0], ends[1])))
        return found

    def _solved(self, hypotheses: Sequence[tuple[str, str]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s = np.concatenate([self.places[h] for h in hypotheses])
        covariance = np.linalg.inv(self._information[np.ix_(s, s)] + np.diag(self._sd[s] ** -2))
        return covariance @ self._slope[s], covariance, s


def _physical(column: Column, factor: float) -> float:
    value = column.at + factor * column.scale
    return float(np.exp(value)) if column.log else value


def temper_of(ledger: Ledger, widths: Widths = Widths()) -> float:
    """Mean squared residual that all columns together leave, at least 1."""
    evidence = Evidence(ledger, widths=widths)
    return max(1.0, evidence.left(list(evidence.places)))


def posterior(
    ledger: Ledger,
    *,
    nothing: float = NOTHING_MISSING,
    widths: Widths = Widths(),
    bags: int = BAGS,
    seed: int = 0,
) -> Posterior:
    """Posterior probabilities of all sets of up to three effects and slots with unknown physics. ``nothing``: prior
    probability that nothing is missing; ``widths``: of closures; ``bags``: bootstrap samples of the blocks, 0: all data
    as they are."""
    temper = temper_of(ledger, widths)
    models = _all_models(Evidence(ledger, widths=widths, temper=temper))
    effects = {e for found in models for e in found}
    each = 1.0 - nothing ** (1.0 / max(len(effects), 1))
    odds = np.log(each) - np.log1p(-each)
    sets = list(models)
    prior = np.array([len(s) * odds for s in sets])
    of_all = _normalised(prior + np.array([models[s][0] for s in sets]))
    probability = of_all
    order = np.argsort(-of_all, kind="stable")[:BAGGED_MODELS]
    if bags and len(ledger.blocks) > 1:
        rng = np.random.default_rng(seed)
        share = float(of_all[order].sum())
        shapes = [models[sets[k]][1] for k in order]
        offset = [models[sets[k]][2] for k in order]
        total = np.zeros(len(order))
        for _ in range(bags):
            drawn = rng.multinomial(len(ledger.blocks), np.full(len(ledger.blocks), 1.0 / len(ledger.blocks)))
            evidence = Evidence(ledger, drawn.astype(float), widths=widths, temper=temper)
            factors = [evidence.factor(s) + o if s else 0.0 for s, o in zip(shapes, offset, strict=True)]
            total += _normalised(prior[order] + np.array(factors))
        probability = of_all.copy()
        probability[order] = share * total / bags
    found = [
        Model(s, tuple(label for _, label in models[s][1]), models[s][0], float(probability[k]))
        for k, s in enumerate(sets)
    ]
    return Posterior(tuple(sorted(found, key=lambda m: -m.probability)))


Averaged = tuple[float, tuple[tuple[str, str], ...], float]
"""log B averaged over the shapes of a set, its best shapes, and log B less that of these."""


def _all_models(evidence: Evidence) -> dict[tuple[str, ...], Averaged]:
    """Sets of effects."""
    shapes: dict[str, list[tuple[str, str]]] = {}
    for effect, label in evidence.places:
        shapes.setdefault(effect, []).append((effect, label))
    found: dict[tuple[str, ...], Averaged] = {(): (0.0, (), 0.0)}
    for effect, mine in shapes.items():
        found[(effect,)] = _averaged(evidence, [(h,) for h in mine])
    pairs: dict[tuple[str, ...], Averaged] = {}
    for a, b in combinations(shapes, 2):
        pairs[(a, b)] = _averaged(evidence, [(x, y) for x in shapes[a] for y in shapes[b]])
    found.update(pairs)
    for (a, b), (_, best, less) in sorted(pairs.items(), key=lambda p: -p[1][0])[:EXTENDED_PAIRS]:
        for c in shapes:
            names = tuple(sorted({a, b, c}))
            if len(names) == 3 and names not in found:
                # The third effect is averaged over its shapes, beside the best ones of the pair.
                value, whole, third = _averaged(evidence, [(*best, z) for z in shapes[c]])
                found[names] = (value + less, whole, third + less)
    return found


def _averaged(evidence: Evidence, sets: Sequence[tuple[tuple[str, str], ...]]) -> Averaged:
    values = np.array([evidence.factor(s) for s in sets])
    mean = float(logsumexp(values) - np.log(len(values)))
    best = int(np.argmax(values))
    return mean, sets[best], mean - float(values[best])


def _normalised(logs: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(logs - logsumexp(logs)))
