"""Posterior probabilities of what is missing, from the ledger of a diagnosis.

A model is a set of at most three causes, effects of the library and places with unknown physics, each with one of its
explanations (:mod:`sysid.comparison.explanations`), whose directions the Bayes factor is of
(:mod:`sysid.comparison.evidence`). An effect is no cause together with unknown physics of its own place, which has its
columns. Causes are missing independently of each other but for weights that are learnt
(:mod:`sysid.comparison.priors`). All single ones are computed, pairs with the most probable of them, and triples with
the most probable pairs, the latter with the best explanations only. The temper is the mean squared residual that all
columns together leave, at least 1.

Probabilities are the mean over bootstrap samples of the blocks (bagged posterior: Huggins & Miller, arXiv 1912.07104),
which makes them honest where no model is right and blocks disagree.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import comb

import numpy as np
from scipy.special import logsumexp

from sysid.comparison.evidence import Directions, Evidence, joined
from sysid.comparison.explanations import UNKNOWN, VISIBLE, Cause, Explanation, causes_of, counts_of
from sysid.comparison.ledger import AMPLITUDE, Ledger
from sysid.comparison.priors import AMPLITUDES, NOTHING_MISSING, PLACE, PRIORS, SHARES, TRACES, Priors

PAIRED = 7
"""Cost: most probable single causes that are paired with all others."""

EXPLAINED_TWICE = 2
"""Cost: explanations of each cause of a pair."""

FITTED = "as fitted"
"""In place of the shape of an effect in a ledger that is linearised with it."""

MOST_CAUSES = 3
"""Cost: causes of one set."""

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
    ``directions`` in the ledger ``at``."""

    effects: tuple[str, ...]
    hypotheses: tuple[str, ...]
    directions: tuple[Directions, ...]
    log_bayes_factor: float
    probability: float
    at: int = 0


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
    ``counts`` ``(f,)``: of what has a learnt prior weight; ``factor``: log B; ``at``: number of the ledger that it is
    compared in, 0 for that of the rig alone."""

    names: tuple[str, ...]
    explanations: tuple[Explanation, ...]
    prior: float
    counts: np.ndarray
    factor: float
    at: int = 0


@dataclass(frozen=True)
class Compared:
    """All candidates over a ledger, nothing missing the first. ``places``: of the model, by cause; ``evidences``: over
    the ledger of the rig alone and those with effects that are fitted."""

    candidates: tuple[Candidate, ...]
    places: dict[str, str]
    evidences: tuple[Evidence, ...]

    def logs(self, weights: np.ndarray, nothing: float = NOTHING_MISSING) -> np.ndarray:
        """Logarithms of the probabilities of the candidates but for a constant. ``weights``: of the counts."""
        each = 1.0 - nothing ** (1.0 / max(len(self.places), 1))
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
    """All sets of up to three causes, over a ledger and those where sets of effects are fitted: each set where most of
    its effects are fitted, and of two such places where it has more evidence."""
    parts, weights = (ledger, *ledger.amended), priors.weights
    temper = min(temper_of(one, priors) for one in parts)
    evidences = tuple(Evidence(one, priors=priors, temper=temper) for one in parts)
    own = {tuple(sorted(one.fitted)): _fitted_factor(one, evidences[k], ledger, evidences[0], priors)
           for k, one in enumerate(parts) if k}  # fmt: skip
    places: dict[str, str] = {}
    found: list[Candidate] = []
    for k, (one, evidence) in enumerate(zip(parts, evidences, strict=True)):
        # What resembles an effect that is fitted is compared where it is.
        alone = {names[0] for names in own if len(names) == 1 and k == 0}
        causes = {c.name: _less(c, alone) for c in causes_of(evidence, weights)}
        places |= {name: c.place for name, c in causes.items()} | one.fitted
        sets = _sets(evidence, causes, weights, MOST_CAUSES - len(one.fitted))
        if k == 0:
            found += sets
            continue
        names = tuple(sorted(one.fitted))
        found += [_beside(c, one.fitted, own[names], k, places) for c in sets if _fits(c, one.fitted, places)]
        found += _left_of(one.fitted, own, evidence, k, places)
    return Compared(tuple(_chosen(found, [set(one.fitted) for one in parts])), places, evidences)


def _fitted_factor(one: Ledger, own: Evidence, base: Ledger, nothing: Evidence, priors: Priors) -> float:
    """log B of effects that are fitted, by the marginal likelihoods where they are and where the rig alone is. A
    reading that one of the two does not predict counts as missed by its noise."""
    sizes = [k for k, c in enumerate(one.columns) if c.kind == "parameter" and c.hypothesis == AMPLITUDE]
    logs = [own.log_marginal]
    for scale in AMPLITUDES[1:] if sizes else ():
        columns = list(one.columns)
        for k in sizes:
            columns[k] = replace(columns[k], prior_sd=scale * columns[k].prior_sd)
        narrow = replace(one, columns=tuple(columns))
        logs.append(Evidence(narrow, priors=priors, temper=own.temper, like=own).log_marginal)
    sided = sum(one.columns[k].lower >= one.columns[k].prior_mean - 1e-9 * one.columns[k].prior_sd for k in sizes)
    unseen = 0.5 * (one.readings - base.readings) / own.temper
    mean = float(logsumexp(logs)) - float(np.log(len(logs)))
    return mean - nothing.log_marginal + float(np.log(2.0)) * sided + unseen


def _less(cause: Cause, effects: set[str]) -> Cause:
    return replace(cause, explanations=tuple(e for e in cause.explanations if e.like not in effects))


def _sets(evidence: Evidence, causes: dict[str, Cause], weights: np.ndarray, most: int) -> list[Candidate]:
    """Nothing, and sets of up to so many causes in addition to what a ledger is linearised with."""
    places = {name: c.place for name, c in causes.items()}
    singles = [_joined(evidence, [c], [e]) for c in causes.values() for e in c.explanations] if most > 0 else []
    doubles: list[Candidate] = []
    triples: list[Candidate] = []
    if most > 1:
        value = _best(singles, weights)
        first = [names[0] for names in sorted(value, key=lambda names: -value[names])[:PAIRED]]
        pairs = {tuple(sorted((a, b))) for a in first for b in causes if _apart((a, b), places)}
        doubles = [
            _joined(evidence, [causes[n] for n in names], chosen)
            for names in sorted(pairs)
            for chosen in product(
                *(causes[n].explanations[: EXPLAINED_TWICE if n in first else 1] for n in names)
            )
        ]  # fmt: skip
    if most > 2:
        value = _best(doubles, weights)
        extended = sorted(value, key=lambda names: -value[names])[:EXTENDED_PAIRS]
        more = {tuple(sorted((*pair, n))) for pair in extended for n in causes if _apart((*pair, n), places)}
        triples = [
            _joined(evidence, [causes[n] for n in names], [causes[n].explanations[0] for n in names])
            for names in sorted(more)
        ]
    mixed = [m for c in (*doubles, *triples) if (m := _mixed(c, causes)) is not None]
    return [_candidate((), places, (), 0.0), *singles, *doubles, *triples, *mixed]


def _fits(found: Candidate, fitted: dict[str, str], places: dict[str, str]) -> bool:
    """Whether causes may be missing in addition to effects that are fitted."""
    return _apart((*fitted, *found.names), places)


def _beside(found: Candidate, fitted: dict[str, str], own: float, at: int, places: dict[str, str]) -> Candidate:
    """A set of causes together with the effects that are fitted where it was compared."""
    explained = {**{name: _as_fitted() for name in fitted}, **dict(zip(found.names, found.explanations, strict=True))}
    names = tuple(sorted(explained))
    return _candidate(names, places, [explained[n] for n in names], own + found.factor, at)


def _as_fitted() -> Explanation:
    """An effect as it is fitted."""
    none = Directions(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0, dtype=bool))
    return Explanation(FITTED, none, 0.0, np.zeros(len(PLACE)), 0.0)


def _left_of(
    fitted: dict[str, str], own: dict[tuple[str, ...], float], evidence: Evidence, at: int, places: dict[str, str]
) -> list[Candidate]:
    """Effects that are fitted, with what is left of one of them, and unknown physics that resembles it but for that
    (:mod:`sysid.comparison.explanations`)."""
    whole, found = tuple(sorted(fitted)), []
    for name, place in fitted.items():
        rest = tuple(n for n in whole if n != name)
        explained = float(np.sqrt(2.0 * max(own[whole] - max(own.get(rest, 0.0), 0.0), 0.0)))
        if explained <= VISIBLE or place not in evidence.unknown:
            continue
        unknown = tuple(sorted((*rest, f"{UNKNOWN}{place}")))
        others = 1 + sum(p == place for e, p in places.items() if e != name and not e.startswith(UNKNOWN))
        for k, size in enumerate(SHARES):
            directions = evidence.unknown_directions(place, size * explained)
            factor = own[whole] + evidence.factor(directions)
            left = Explanation(FITTED, directions, 0.0, counts_of(f"left {k}"), factor)
            found.append(_candidate(whole, places, [left if n == name else _as_fitted() for n in whole], factor, at))
            if _apart(unknown, places):
                alike = replace(left, prior=-float(np.log(others)), counts=counts_of(f"alike {k}", "unknown"))
                parts = [alike if n.startswith(UNKNOWN) else _as_fitted() for n in unknown]
                found.append(_candidate(unknown, places, parts, factor, at))
    return found


def _chosen(found: Sequence[Candidate], fitted: Sequence[set[str]]) -> list[Candidate]:
    """Of each set the candidates where most of its effects are fitted, and of two such places those of the one with
    more evidence; what only resembles effects that are fitted stays."""
    best: dict[tuple[str, ...], tuple[int, float, int]] = {}
    for c in found:
        if fitted[c.at] <= set(c.names):
            best[c.names] = max(best.get(c.names, (-1, -np.inf, 0)), (len(fitted[c.at]), c.factor, c.at))
    return [c for c in found if not fitted[c.at] <= set(c.names) or c.at == best[c.names][2]]


def _mixed(found: Candidate, causes: dict[str, Cause]) -> Candidate | None:
    """Unknown physics that looks like the effects of one place of a set, with the rest of it; None where no two
    effects have a place in common. All mixtures of as many effects of a place are equally probable."""
    of = [causes[n].place for n in found.names]
    place = max(of, key=of.count, default="")
    inside = [k for k, p in enumerate(of) if p == place]
    name = f"{UNKNOWN}{place}"
    if len(inside) < 2 or name not in causes:
        return None
    parts = [found.explanations[k] for k in inside]
    rest = [k for k in range(len(of)) if k not in inside]
    others = sum(c.place == place and not c.unknown for c in causes.values())
    share = -float(np.log(comb(others, len(inside))))
    counts = np.sum([e.counts for e in parts], axis=0)
    counts[[PLACE["unknown"], PLACE["mixture"]]] += 1.0
    label = " and ".join(found.names[k] for k in inside)
    whole = Explanation(
        label, joined([e.directions for e in parts]), sum(e.prior for e in parts) + share, counts, found.factor
    )
    order = sorted([(name, whole), *((found.names[k], found.explanations[k]) for k in rest)], key=lambda pair: pair[0])
    places = {name: c.place for name, c in causes.items()}
    return _candidate(tuple(n for n, _ in order), places, [e for _, e in order], found.factor)


def _apart(names: Sequence[str], places: dict[str, str]) -> bool:
    """Whether causes may be missing together: all different, and none that another has within it."""
    unknown = {places[n] for n in names if n.startswith(UNKNOWN)}
    return len(set(names)) == len(names) and not any(places[n] in unknown and not n.startswith(UNKNOWN) for n in names)


def _joined(evidence: Evidence, causes: Sequence[Cause], chosen: Sequence[Explanation]) -> Candidate:
    together = len(chosen) > 1
    factor = evidence.factor(joined([e.directions for e in chosen])) if together else chosen[0].factor
    return _candidate(tuple(c.name for c in causes), {c.name: c.place for c in causes}, chosen, factor)


def _candidate(
    names: tuple[str, ...], places: dict[str, str], chosen: Sequence[Explanation], factor: float, at: int = 0
) -> Candidate:
    counts = np.sum([np.zeros(len(PLACE)), *(e.counts for e in chosen)], axis=0)
    counts[PLACE["same_place"]] += len(names) - len({places[n] for n in names})
    if len(names) > 1:
        counts[PLACE["pair" if len(names) == 2 else "triple"]] += 1.0
    return Candidate(names, tuple(chosen), sum(e.prior for e in chosen), counts, factor, at)


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
    missing; ``bags``: bootstrap samples of the blocks, 0: all data as they are, as where sets of effects are fitted."""
    found = compared(ledger, priors)
    if not bags or len(ledger.blocks) == 1 or ledger.amended:
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
                best.at,
            )
        )
    return Posterior(tuple(sorted(models, key=lambda m: -m.probability)), found.places)


def _bagged(ledger: Ledger, found: Compared, priors: Priors, nothing: float, bags: int, seed: int) -> np.ndarray:
    """Mean probabilities over bootstrap samples of the blocks."""
    logs = found.logs(priors.weights, nothing)
    of_all = _normalised(logs)
    order = np.argsort(-of_all, kind="stable")[:BAGGED_MODELS]
    chosen = [found.candidates[k] for k in order]
    rest = logs[order] - np.array([c.factor for c in chosen])
    share, total = float(of_all[order].sum()), np.zeros(len(order))
    together = [joined([e.directions for e in c.explanations]) for c in chosen]
    rng, count, temper = np.random.default_rng(seed), len(ledger.blocks), found.evidences[0].temper
    for _ in range(bags):
        drawn = rng.multinomial(count, np.full(count, 1.0 / count)).astype(float)
        evidence = Evidence(ledger, drawn, priors=priors, temper=temper, like=found.evidences[0])
        total += _normalised(rest + np.array([evidence.factor(d) for d in together]))
    probability = of_all.copy()
    probability[order] = share * total / bags
    return np.asarray(probability)


def _normalised(logs: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(logs - logsumexp(logs)))
