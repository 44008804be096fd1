"""Posterior probabilities of what is missing, from the ledger of a diagnosis.

A model is a set of at most three causes, effects of the library and places with unknown physics, each with one of its
explanations (:mod:`sysid.comparison.explanations`), whose directions the Bayes factor is of
(:mod:`sysid.comparison.evidence`). An effect is no cause beside unknown physics of its own place, which has its
columns. Causes are missing independently of each other but for weights that are learnt
(:mod:`sysid.comparison.priors`). All single ones are computed, pairs with the most probable of them, and triples with
the most probable pairs, the latter with the best explanations only. The temper is the mean squared residual that all
columns together leave, at least 1.

Probabilities are the mean over bootstrap samples of the blocks (bagged posterior: Huggins & Miller, arXiv 1912.07104),
which makes them honest where no model is right and blocks disagree.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from math import comb

import numpy as np
from scipy.special import logsumexp

from sysid.comparison.evidence import Directions, Evidence, joined
from sysid.comparison.explanations import UNKNOWN, Cause, Explanation, causes_of
from sysid.comparison.ledger import Ledger
from sysid.comparison.priors import NOTHING_MISSING, PLACE, PRIORS, TRACES, Priors

PAIRED = 7
"""Cost: most probable single causes that are paired with all others."""

EXPLAINED_TWICE = 2
"""Cost: explanations of each cause of a pair."""

EXTENDED_PAIRS = 6
"""Cost: most probable pairs that a third cause is added to."""

BAGS = 50
"""Cost: bootstrap samples of the blocks; the standard error of a probability is at most 1 / (2 BAGS^(1/2))."""

BAGGED_MODELS = 60
"""Cost: most probable models of which bootstrap samples are taken; others keep the share that they have in all data."""


@dataclass(frozen=True)
class Model:
    """A set of effects and of places with unknown physics, empty where nothing is missing. ``log_bayes_factor`` [nats]:
    over nothing missing, averaged over explanations; ``hypotheses``: the most probable shape of each, with its
    ``directions``."""

    effects: tuple[str, ...]
    hypotheses: tuple[str, ...]
    directions: tuple[Directions, ...]
    log_bayes_factor: float
    probability: float


@dataclass(frozen=True)
class Posterior:
    """``models``: most probable first; ``places``: of the model, by name of a cause."""

    models: tuple[Model, ...]
    places: dict[str, str]

    @property
    def nothing(self) -> float:
        """Probability that nothing is missing."""
        return next(m.probability for m in self.models if not m.effects)

    @property
    def unknown(self) -> float:
        """Probability that some physics is missing that the library does not have."""
        return sum(m.probability for m in self.models if any(e.startswith(UNKNOWN) for e in m.effects))

    @property
    def inclusion(self) -> dict[str, float]:
        """Probability of each cause that it is missing, largest first."""
        return _sums((e, m.probability) for m in self.models for e in m.effects)

    @property
    def in_place(self) -> dict[str, float]:
        """Probability of each place of the model that something is missing there, known or not, largest first."""
        return _sums((p, m.probability) for m in self.models for p in {self.places[e] for e in m.effects})

    def credible(self, level: float = 0.95) -> tuple[Model, ...]:
        """The fewest models that hold this probability together."""
        sums = np.cumsum([m.probability for m in self.models])
        return self.models[: int(np.searchsorted(sums, level)) + 1]


def _sums(pairs: Iterable[tuple[str, float]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, value in pairs:
        found[name] = found.get(name, 0.0) + value
    return dict(sorted(found.items(), key=lambda pair: -pair[1]))


@dataclass(frozen=True)
class Candidate:
    """A set of causes with one explanation of each. ``prior``: logarithm of the shares of these explanations;
    ``counts`` ``(f,)``: of what has a learnt prior weight; ``factor``: log B."""

    names: tuple[str, ...]
    explanations: tuple[Explanation, ...]
    prior: float
    counts: np.ndarray
    factor: float


@dataclass(frozen=True)
class Compared:
    """All candidates over a ledger, nothing missing the first. ``causes``: by name; ``evidence``: that they are of."""

    candidates: tuple[Candidate, ...]
    causes: dict[str, Cause]
    evidence: Evidence

    def logs(self, weights: np.ndarray, nothing: float = NOTHING_MISSING) -> np.ndarray:
        """Logarithms of the probabilities of the candidates but for a constant. ``weights``: of the counts."""
        each = 1.0 - nothing ** (1.0 / max(len(self.causes), 1))
        odds = np.log(each) - np.log1p(-each)
        found = [c.factor + c.prior + len(c.names) * odds + float(c.counts @ weights) for c in self.candidates]
        return np.array(found)


def temper_of(ledger: Ledger, priors: Priors = PRIORS) -> float:
    """Mean squared residual that all columns together leave, at least 1."""
    evidence = Evidence(ledger, priors=priors)
    everything = [evidence.directions(shape) for shape in evidence.shapes]
    everything += [evidence.unknown_directions(place, TRACES[-1]) for place in evidence.unknown]
    return max(1.0, evidence.left(joined(everything)))


def compared(ledger: Ledger, priors: Priors = PRIORS) -> Compared:
    """All sets of up to three causes, over a ledger."""
    evidence = Evidence(ledger, priors=priors, temper=temper_of(ledger, priors))
    weights = priors.weights
    causes = {c.name: c for c in causes_of(evidence, weights)}
    nothing = Candidate((), (), 0.0, np.zeros(len(PLACE)), 0.0)
    singles = [_joined(evidence, [c], [e]) for c in causes.values() for e in c.explanations]
    value = _best(singles, weights)
    paired = sorted(value, key=lambda names: -value[names])[:PAIRED]
    first = [names[0] for names in paired]
    pairs = {tuple(sorted((a, b))) for a in first for b in causes if _apart([causes[a], causes[b]])}
    doubles = [
        _joined(evidence, [causes[n] for n in names], chosen)
        for names in sorted(pairs)
        for chosen in product(
            *(causes[n].explanations[: EXPLAINED_TWICE if n in first else 1] for n in names)
        )
    ]  # fmt: skip
    value = _best(doubles, weights)
    extended = sorted(value, key=lambda names: -value[names])[:EXTENDED_PAIRS]
    more = {
        tuple(sorted((*pair, n))) for pair in extended for n in causes if _apart([causes[m] for m in (*pair, n)])
    }  # fmt: skip
    triples = [
        _joined(evidence, [causes[n] for n in names], [causes[n].explanations[0] for n in names])
        for names in sorted(more)
    ]
    mixed = [m for c in (*doubles, *triples) if (m := _mixed(c, causes)) is not None]
    return Compared((nothing, *singles, *doubles, *triples, *mixed), causes, evidence)


def _mixed(found: Candidate, causes: dict[str, Cause]) -> Candidate | None:
    """Unknown physics that looks like the effects of one place of a set, beside the rest of it; None where no two
    effects have a place in common. All mixtures of as many effects of a place are equally probable."""
    places = [causes[n].place for n in found.names]
    place = max(places, key=places.count)
    inside = [k for k, p in enumerate(places) if p == place]
    name = f"{UNKNOWN}{place}"
    if len(inside) < 2 or name not in causes:
        return None
    parts = [found.explanations[k] for k in inside]
    rest = [k for k in range(len(places)) if k not in inside]
    others = sum(c.place == place and not c.unknown for c in causes.values())
    share = -float(np.log(comb(others, len(inside))))
    counts = np.sum([e.counts for e in parts], axis=0)
    counts[[PLACE["unknown"], PLACE["mixture"]]] += 1.0
    label = " and ".join(found.names[k] for k in inside)
    whole = Explanation(
        label, joined([e.directions for e in parts]), sum(e.prior for e in parts) + share, counts, found.factor
    )
    order = sorted([(name, whole), *((found.names[k], found.explanations[k]) for k in rest)], key=lambda pair: pair[0])
    names = tuple(n for n, _ in order)
    return _candidate([causes[n] for n in names], [e for _, e in order], found.factor)


def _apart(causes: Sequence[Cause]) -> bool:
    """Whether causes may be missing together: all different, and none that another has within it."""
    unknown = {c.place for c in causes if c.unknown}
    return len({c.name for c in causes}) == len(causes) and not any(
        c.place in unknown and not c.unknown for c in causes
    )


def _joined(evidence: Evidence, causes: Sequence[Cause], chosen: Sequence[Explanation]) -> Candidate:
    together = len(chosen) > 1
    factor = evidence.factor(joined([e.directions for e in chosen])) if together else chosen[0].factor
    return _candidate(causes, chosen, factor)


def _candidate(causes: Sequence[Cause], chosen: Sequence[Explanation], factor: float) -> Candidate:
    counts = np.sum([e.counts for e in chosen], axis=0)
    counts[PLACE["same_place"]] += len(causes) - len({c.place for c in causes})
    if len(causes) > 1:
        counts[PLACE["pair" if len(causes) == 2 else "triple"]] += 1.0
    return Candidate(tuple(c.name for c in causes), tuple(chosen), sum(e.prior for e in chosen), counts, factor)


def _best(found: Sequence[Candidate], weights: np.ndarray) -> dict[tuple[str, ...], float]:
    """Largest logarithm of each set."""
    best: dict[tuple[str, ...], float] = {}
    for c in found:
        best[c.names] = max(best.get(c.names, -np.inf), c.factor + c.prior + float(c.counts @ weights))
    return best


def posterior(
    ledger: Ledger,
    *,
    nothing: float = NOTHING_MISSING,
    priors: Priors = PRIORS,
    bags: int = BAGS,
    seed: int = 0,
) -> Posterior:
    """Posterior probabilities of all sets of up to three causes. ``nothing``: prior probability that nothing is
    missing; ``bags``: bootstrap samples of the blocks, 0: all data as they are."""
    found = compared(ledger, priors)
    if not bags or len(ledger.blocks) == 1:
        return judged(found, priors, nothing=nothing)
    return judged(found, priors, nothing=nothing, probability=_bagged(ledger, found, priors, nothing, bags, seed))


def judged(
    found: Compared,
    priors: Priors = PRIORS,
    *,
    nothing: float = NOTHING_MISSING,
    probability: np.ndarray | None = None,
) -> Posterior:
    """Posterior probabilities of sets of causes that were compared. ``probability``: of the candidates, by default that
    of all data."""
    logs = found.logs(priors.weights, nothing)
    shares = _normalised(logs) if probability is None else probability
    groups: dict[tuple[str, ...], list[int]] = {}
    for k, c in enumerate(found.candidates):
        groups.setdefault(c.names, []).append(k)
    before = np.array([c.prior + float(c.counts @ priors.weights) for c in found.candidates])
    factors = np.array([c.factor for c in found.candidates])
    models = []
    for names, mine in groups.items():
        best = found.candidates[max(mine, key=lambda k: float(logs[k]))]
        averaged = np.logaddexp.reduce(factors[mine] + before[mine]) - np.logaddexp.reduce(before[mine])
        models.append(
            Model(
                names,
                tuple(e.label for e in best.explanations),
                tuple(e.directions for e in best.explanations),
                float(averaged),
                float(shares[mine].sum()),
            )
        )
    places = {name: cause.place for name, cause in found.causes.items()}
    return Posterior(tuple(sorted(models, key=lambda m: -m.probability)), places)


def _bagged(ledger: Ledger, found: Compared, priors: Priors, nothing: float, bags: int, seed: int) -> np.ndarray:
    """Mean probabilities over bootstrap samples of the blocks."""
    logs = found.logs(priors.weights, nothing)
    of_all = _normalised(logs)
    order = np.argsort(-of_all, kind="stable")[:BAGGED_MODELS]
    chosen = [found.candidates[k] for k in order]
    rest = logs[order] - np.array([c.factor for c in chosen])
    share, total = float(of_all[order].sum()), np.zeros(len(order))
    together = [joined([e.directions for e in c.explanations]) for c in chosen]
    rng, count, temper = np.random.default_rng(seed), len(ledger.blocks), found.evidence.temper
    for _ in range(bags):
        drawn = rng.multinomial(count, np.full(count, 1.0 / count)).astype(float)
        evidence = Evidence(ledger, drawn, priors=priors, temper=temper, like=found.evidence)
        total += _normalised(rest + np.array([evidence.factor(d) for d in together]))
    probability = of_all.copy()
    probability[order] = share * total / bags
    return np.asarray(probability)


def _normalised(logs: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(logs - logsumexp(logs)))
