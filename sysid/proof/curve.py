"""Power and errors of the posterior as curves over the strength of what is missing.

Effects of the library are concealed in ledgers of empty recordings (:mod:`sysid.comparison.injection`), whose truth
comes from another formulation, at a trace that is log-uniform between two ends, as far as physics allows it. An effect
that has a shape is concealed in one that is drawn and that no diagnosis looks at: no case is explained exactly. A share
of the cases conceals an effect that the library does not have at all. Prior weights may be learnt
(:mod:`sysid.comparison.learning`) from the ledgers of other parts than the one that is judged. The alarm is the log
odds that something is missing; its level is one that the given share of the empty ledgers exceeds, which with few of
them is their largest.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from sim_core.errors import ConfigError
from sysid.comparison.explanations import UNKNOWN
from sysid.comparison.injection import Concealer, Injection, injected
from sysid.comparison.learning import UNDESCRIBED, Case, learnt_form, learnt_weights, shared_out
from sysid.comparison.ledger import Ledger, read_ledger
from sysid.comparison.posterior import Compared, Posterior, compared, judged
from sysid.comparison.priors import PRIORS, Priors, feature_names
from sysid.progress.callback import Progress
from sysid.proof.ledgers import LEDGER_FILE

TRACES = (2.0, 100.0)
"""Convention: least and largest trace of an effect that is concealed."""

BINS = (2.0, 4.0, 6.0, 9.0, 13.0, 20.0, 40.0, 100.0)
"""Convention: ends of the ranges of trace that rates are given for."""

OUTSIDE = 0.2
"""Convention: share of the cases whose effect the library does not have."""

ALARMS = 0.01
"""Convention: share of empty recordings that may raise an alarm."""

MATCHED_TRACE = 4.1
"""Trace that a matched test over 240 columns at a level of 1 % sees half the time."""

TRIES = 100
"""Convention: draws for each case, of which implausible ones are not concealed."""

SURE = 0.9
"""Convention: probability from which an answer is sure."""

LEARNT_FROM = 200
"""Cost: cases that prior weights are learnt from."""

CURVE_FILE = "curve.json"


@dataclass(frozen=True)
class Judged:
    """One case. ``effect``, ``place``: empty where nothing is concealed; ``inside``: whether the library has it;
    ``odds`` [nats]: that something is missing over nothing; ``said``: the most probable set; ``sure``: its probability;
    ``likeliest``: the place where something is missing most probably; ``true``: probability of what is concealed."""

    ledger: str
    effect: str
    place: str
    trace: float
    inside: bool
    odds: float
    said: tuple[str, ...]
    sure: float
    likeliest: str
    true: float

    @property
    def right(self) -> bool:
        """Whether what is said is what is concealed: its name, or that it is unknown in its place."""
        return set(self.said) == set(names_of(self.effect, self.place, self.inside))

    @property
    def named(self) -> bool:
        """Whether an effect of the library is said to be missing."""
        return any(not name.startswith(UNKNOWN) for name in self.said)


@dataclass(frozen=True)
class Drawn:
    """A case to be judged. ``ledger``: with the ``effect`` concealed, which amends a ``place`` of the model, of a
    library that has it or not (``inside``); ``name``: of the empty ledger."""

    name: str
    ledger: Ledger
    effect: str
    place: str
    trace: float
    inside: bool

    @property
    def names(self) -> tuple[str, ...]:
        """What is right to say."""
        return names_of(self.effect, self.place, self.inside)

    def judged(self, found: Compared, priors: Priors) -> Judged:
        """What the posterior says of it."""
        said = judged(found, priors)
        best, places = said.models[0], said.in_place
        true = sum(m.probability for m in said.models if set(m.effects) == set(self.names))
        return Judged(
            self.name, self.effect, self.place, self.trace, self.inside, _odds(said), best.effects, best.probability,
            next(iter(places), ""), true,
        )  # fmt: skip


def names_of(effect: str, place: str, inside: bool) -> tuple[str, ...]:
    """What is right to say of an effect that is concealed."""
    return (effect,) if effect and inside else (f"{UNKNOWN}{place}",) if effect else ()


@dataclass(frozen=True)
class Bin:
    """Rates of the cases within a range of ``trace``, None without any. ``right_name``: of effects that the library
    has; ``among``: it, alone or with others; ``unknown``: of other effects, said to be unknown in their place;
    ``right_place``: of these, where something is missing most probably; ``wrong``: a false name above the probability
    0.9; ``score``: mean log probability of what is concealed, of which a share of 0.01 is given to everything else."""

    trace: tuple[float, float]
    cases: int
    noticed: float | None
    right_name: float | None
    among: float | None
    unknown: float | None
    right_place: float | None
    wrong: float | None
    score: float | None


@dataclass(frozen=True)
class Rates:
    """``named_empty``: share of empty ledgers whose most probable answer is not nothing; ``half_seen_trace``: that is
    seen half the time; ``deafness``: that over the trace of a matched test."""

    empty_ledgers: int
    named_empty: float
    alarm_level_nats: float
    half_seen_trace: float
    deafness: float
    bins: tuple[Bin, ...]


def make_curve(
    folder: Path,
    out: Path,
    *,
    cases: int,
    seed: int = 0,
    folds: int = 1,
    on_progress: Progress | None = None,
) -> str:
    """Judge ``cases`` drawn cases over the empty ledgers of a folder, write ``curve.json`` into ``out`` and return the
    table. ``folds``: parts of these ledgers, the cases of each judged by prior weights that are learnt from those of
    the others; 1: by those that the tool has. Raises ``ConfigError`` where there are too few such ledgers."""
    empty = empty_ledgers(folder, max(2, folds))
    tell = on_progress or (lambda share, text: None)
    rng = np.random.default_rng(seed)
    drawn = [Drawn(name, ledger.merged, "", "", 0.0, True) for name, ledger in empty.items()]
    drawn += drawn_cases(empty, cases, rng)
    seen: list[Compared] = []
    for k, case in enumerate(drawn):
        tell(k / len(drawn), f"case {k + 1} of {len(drawn)}")
        seen.append(compared(case.ledger))
    numbers = dict.fromkeys(empty, PRIORS)
    if folds > 1:
        known = [Case.of(s, case.names) for s, case in zip(seen, drawn, strict=True)]
        for part in np.array_split(rng.permutation(list(empty)), folds):
            others = [k for k, case in enumerate(drawn) if case.name not in part]
            numbers |= dict.fromkeys((str(name) for name in part), _learnt(drawn, known, others))
    found = [case.judged(s, numbers[case.name]) for s, case in zip(seen, drawn, strict=True)]
    out.mkdir(parents=True, exist_ok=True)
    rates = rates_of(found)
    kept = {"rates": asdict(rates), "numbers": {n: asdict(v) for n, v in numbers.items()} if folds > 1 else {}}
    (out / CURVE_FILE).write_text(json.dumps({**kept, "cases": [asdict(j) for j in found]}, indent=2) + "\n")
    return table(rates)


def _learnt(drawn: Sequence[Drawn], known: Sequence[Case], chosen: Sequence[int]) -> Priors:
    """Prior weights learnt from some of the cases."""
    empty = [known[k] for k in chosen if not drawn[k].effect]
    return learnt_weights(shared_out([known[k] for k in chosen if drawn[k].effect], empty))


def make_learnt(folder: Path, *, cases: int = LEARNT_FROM, seed: int = 0) -> str:
    """The form error and prior weights that are learnt from the empty ledgers of a folder, in words."""
    empty = empty_ledgers(folder, 2)
    merged = {name: one.merged for name, one in empty.items()}
    priors = learnt_form(list(merged.values()))
    drawn = drawn_cases(empty, cases, np.random.default_rng(seed))
    found = [Case.of(compared(d.ledger, priors), d.names) for d in drawn]
    priors = learnt_weights(shared_out(found, [Case.of(compared(one, priors), ()) for one in merged.values()]), priors)
    lines = [
        f"The form error is {priors.form:.3g} of the named approximations. Logarithms of prior weights, and "
        "what the tool has:"
    ]
    lines += [
        f"{name:>12}{value:8.2f}{before:8.2f}"
        for name, value, before in zip(feature_names(), priors.weights, PRIORS.weights, strict=True)
    ]
    return "\n".join(lines)


def empty_ledgers(folder: Path, least: int) -> dict[str, Ledger]:
    """Ledgers of the cases of a folder whose truth conceals nothing. Raises ``ConfigError`` where they are fewer than
    ``least``."""
    found = {}
    for path in sorted(folder.glob(f"**/{LEDGER_FILE}")):
        truth = path.with_name("truth.json")
        if truth.is_file() and not json.loads(truth.read_text())["effects"]:
            found[str(path.parent.relative_to(folder))] = read_ledger(path)
    if len(found) < least:
        raise ConfigError(
            f"{folder} holds {len(found)} ledgers of cases that conceal nothing, and {least} are needed at least.",
            "Record cases with 'thinshell prove record' and make their ledgers with 'thinshell prove ledgers'.",
        )
    return found


def drawn_cases(empty: Mapping[str, Ledger], count: int, rng: np.random.Generator) -> list[Drawn]:
    """Cases with one effect concealed in one of some ledgers. Raises ``ConfigError`` where none can be."""
    merged = {name: one.merged for name, one in empty.items()}
    concealers = {name: Concealer(one) for name, one in merged.items()}
    found: list[Drawn] = []
    for _ in range(TRIES * count):
        if len(found) == count:
            return found
        name = str(rng.choice(list(merged)))
        case = _drawn_case(name, merged[name], concealers[name], rng)
        found += [] if case is None else [case]
    raise ConfigError(
        f"Effects that can be concealed were drawn {len(found)} times in {TRIES * count}, and {count} are needed.",
        "Use ledgers in which effects of a plausible size are visible.",
    )


def _drawn_case(name: str, ledger: Ledger, concealer: Concealer, rng: np.random.Generator) -> Drawn | None:
    """One effect concealed in a ledger, None where that would not be plausible."""
    effect = str(rng.choice(list(concealer.shapes)))
    shapes = concealer.shapes[effect]
    hypothesis = shapes[int(rng.integers(len(shapes)))]
    trace = float(np.exp(rng.uniform(*np.log(TRACES))))
    inside = bool(rng.random() >= OUTSIDE)
    change = concealer.change(Injection(effect, hypothesis, trace), rng)
    if change is None:
        return None
    column = next(c for c in ledger.columns if (c.owner, c.hypothesis) == (effect, hypothesis))
    place, there = column.place, injected(ledger, change)
    if not inside:
        there = there.without([effect])
    elif column.kind == "effect" and column.shape:
        there = there.without_shape(effect, hypothesis)
    return Drawn(name, there, effect, place, trace, inside)


def _odds(found: Posterior) -> float:
    missing = sum(m.probability for m in found.models if m.effects)
    tiny = np.finfo(float).tiny
    return float(np.log(max(missing, tiny)) - np.log(max(found.nothing, tiny)))


def rates_of(found: Sequence[Judged]) -> Rates:
    """Level of the alarm, and rates by range of trace."""
    empty = [j for j in found if not j.effect]
    level = float(np.quantile([j.odds for j in empty], 1.0 - ALARMS, method="higher"))
    concealed = [j for j in found if j.effect]
    bins = []
    for low, high in pairwise(BINS):
        here = [j for j in concealed if low <= j.trace < high]
        bins.append(
            Bin(
                (low, high),
                len(here),
                _rate([j.odds > level for j in here]),
                _rate([j.right for j in here if j.inside]),
                _rate([j.effect in j.said for j in here if j.inside]),
                _rate([j.right for j in here if not j.inside]),
                _rate([j.likeliest == j.place for j in here if not j.inside]),
                _rate([j.sure > SURE and j.named and not j.right for j in here]),
                float(np.mean([np.log((1.0 - UNDESCRIBED) * j.true + UNDESCRIBED) for j in here])) if here else None,
            )
        )
    half = half_seen([j.trace for j in concealed], [j.odds > level for j in concealed])
    return Rates(
        len(empty), _rate([bool(j.said) for j in empty]) or 0.0, level, half, half / MATCHED_TRACE, tuple(bins)
    )


def half_seen(traces: Sequence[float], seen: Sequence[bool]) -> float:
    """Trace that is seen half the time: where a step from not seen to seen has the fewest cases on its wrong sides."""
    order = np.argsort(traces)
    sorted_traces, noticed = np.asarray(traces)[order], np.asarray(seen)[order]
    wrong = np.concatenate([[0], np.cumsum(noticed)]) + np.concatenate([np.cumsum(~noticed[::-1])[::-1], [0]])
    best = int(np.argmin(wrong))
    if best == 0:
        return float(sorted_traces[0])
    if best == len(sorted_traces):
        return float(sorted_traces[-1])
    return float(np.sqrt(sorted_traces[best - 1] * sorted_traces[best]))


def _rate(flags: Sequence[bool]) -> float | None:
    return float(np.mean(flags)) if flags else None


def table(rates: Rates) -> str:
    """The rates in words."""
    rows: list[tuple[str, ...]] = [
        ("trace", "cases", "noticed", "right name", "among others", "unknown", "right place", "sure, wrong", "score")
    ]
    for b in rates.bins:
        shares = (b.noticed, b.right_name, b.among, b.unknown, b.right_place, b.wrong)
        cells = ["-" if r is None else f"{100.0 * r:.0f} %" for r in shares]
        cells.append("-" if b.score is None else f"{b.score:.2f}")
        rows.append((f"{b.trace[0]:g} .. {b.trace[1]:g}", str(b.cases), *cells))
    lines = ["".join(f"{cell:>13}" for cell in row) for row in rows]
    lines += [
        f"Alarm above {rates.alarm_level_nats:.1f} nats, from {rates.empty_ledgers} empty recordings, of which "
        f"{100.0 * rates.named_empty:.0f} % have another answer than nothing as their most probable one.",
        f"Seen half the time at a trace of {rates.half_seen_trace:.1f}, {rates.deafness:.1f} times that of a matched "
        "test.",
    ]
    return "\n".join(lines)
