"""Power and errors of the posterior as curves over the strength of what is missing.

Effects of the library are concealed in ledgers of empty recordings (:mod:`sysid.comparison.injection`), whose truth
comes from another formulation, at a trace that is log-uniform between two ends. An effect that is looked at in several
shapes has one of them, which is then left out of the library: no case is explained exactly. A share of the cases
conceals an effect that the library does not have at all. The alarm is the log odds that something is missing; its level
is one that the given share of the empty ledgers exceeds, which with few of them is their largest.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from sim_core.effects import effect_by_name
from sim_core.errors import ConfigError
from sysid.comparison.injection import Injection, injected
from sysid.comparison.ledger import Ledger, read_ledger
from sysid.comparison.posterior import UNKNOWN, Posterior, posterior
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

SURE = 0.9
"""Convention: probability from which an answer is sure."""

CURVE_FILE = "curve.json"


@dataclass(frozen=True)
class Judged:
    """One case. ``effect``: empty where nothing is concealed; ``inside``: whether the library has it; ``odds`` [nats]:
    that something is missing over nothing; ``said``: the most probable set; ``sure``: its probability."""

    ledger: str
    effect: str
    trace: float
    inside: bool
    odds: float
    said: tuple[str, ...]
    sure: float

    @property
    def right(self) -> bool:
        """Whether what is said is what is concealed: its name, or that it is unknown in its place."""
        if self.inside or not self.effect:
            return set(self.said) == {self.effect} - {""}
        place = effect_by_name(self.effect).slot
        return len(self.said) == 1 and self.said[0].startswith(f"{UNKNOWN}{place} ")

    @property
    def named(self) -> bool:
        """Whether an effect of the library is said to be missing."""
        return any(not name.startswith(UNKNOWN) for name in self.said)


@dataclass(frozen=True)
class Bin:
    """Rates of the cases within a range of ``trace``, None without any. ``right_name``: of effects that the library
    has; ``among``: it, alone or with others; ``right_place``: of other effects, said to be unknown in their slot;
    ``wrong``: a false name above the probability 0.9."""

    trace: tuple[float, float]
    cases: int
    noticed: float | None
    right_name: float | None
    among: float | None
    right_place: float | None
    wrong: float | None


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
    folder: Path, out: Path, *, cases: int, seed: int = 0, on_progress: Callable[[float, str], None] | None = None
) -> str:
    """Judge ``cases`` drawn cases over the empty ledgers of a folder, write ``curve.json`` into ``out`` and return the
    table. Raises ``ConfigError`` where there are no two such ledgers."""
    empty = empty_ledgers(folder)
    if len(empty) < 2:
        raise ConfigError(
            f"{folder} holds {len(empty)} ledgers of cases that conceal nothing, and two are needed at least.",
            "Record cases with 'thinshell prove record' and make their ledgers with 'thinshell prove ledgers'.",
        )
    tell = on_progress or (lambda share, text: None)
    rng = np.random.default_rng(seed)
    found = [_judged(name, ledger, None, True) for name, ledger in empty.items()]
    for k in range(cases):
        tell(k / cases, f"case {k + 1} of {cases}")
        name = str(rng.choice(list(empty)))
        found.append(drawn_case(name, empty[name], rng))
    out.mkdir(parents=True, exist_ok=True)
    rates = rates_of(found)
    (out / CURVE_FILE).write_text(
        json.dumps({"rates": asdict(rates), "cases": [asdict(j) for j in found]}, indent=2) + "\n"
    )
    return table(rates)


def empty_ledgers(folder: Path) -> dict[str, Ledger]:
    """Ledgers of the cases of a folder whose truth conceals nothing."""
    found = {}
    for path in sorted(folder.glob(f"**/{LEDGER_FILE}")):
        truth = path.with_name("truth.json")
        if truth.is_file() and not json.loads(truth.read_text())["effects"]:
            found[str(path.parent.relative_to(folder))] = read_ledger(path)
    return found


def drawn_case(name: str, ledger: Ledger, rng: np.random.Generator) -> Judged:
    """One effect concealed in a ledger."""
    shapes = list(dict.fromkeys((c.owner, c.hypothesis) for c in ledger.columns if c.kind == "effect"))
    effect = str(rng.choice(ledger.effects))
    mine = [h for e, h in shapes if e == effect]
    hypothesis = mine[int(rng.integers(len(mine)))]
    trace = float(np.exp(rng.uniform(*np.log(TRACES))))
    inside = bool(rng.random() >= OUTSIDE)
    there = injected(ledger, Injection(effect, hypothesis, trace), rng)
    if not inside:
        there = there.without([effect])
    elif len(mine) > 1:
        there = there.without_shape(effect, hypothesis)
    return _judged(name, there, (effect, trace), inside)


def _judged(name: str, ledger: Ledger, concealed: tuple[str, float] | None, inside: bool) -> Judged:
    found = posterior(ledger, bags=0)
    effect, trace = concealed or ("", 0.0)
    best = found.models[0]
    return Judged(name, effect, trace, inside, _odds(found), best.effects, best.probability)


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
                _rate([j.sure > SURE and j.named and not j.right for j in here]),
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
        ("trace", "cases", "noticed", "right name", "among others", "right place", "sure, wrong")
    ]
    for b in rates.bins:
        shares = (b.noticed, b.right_name, b.among, b.right_place, b.wrong)
        cells = ["-" if r is None else f"{100.0 * r:.0f} %" for r in shares]
        rows.append((f"{b.trace[0]:g} .. {b.trace[1]:g}", str(b.cases), *cells))
    lines = ["".join(f"{cell:>13}" for cell in row) for row in rows]
    lines += [
        f"Alarm above {rates.alarm_level_nats:.1f} nats, from {rates.empty_ledgers} empty recordings, of which "
        f"{100.0 * rates.named_empty:.0f} % have another answer than nothing as their most probable one.",
        f"Seen half the time at a trace of {rates.half_seen_trace:.1f}, {rates.deafness:.1f} times that of a matched "
        "test.",
    ]
    return "\n".join(lines)
