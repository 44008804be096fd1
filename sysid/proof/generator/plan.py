"""Which cases a shard has: what each conceals, on which rig."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np

from sim_core.effects import all_effects
from sysid.proof.generator.concealed import DRAWS
from sysid.proof.truths.conceal import LIBRARY, OUTSIDE

RIGS = ("bench", "strip", "gel")
"""The bench is simulated by the simulator itself on a finer mesh; the others have truths of other formulations."""

SHARES = {"empty": 1 / 3, "one": 0.4, "two": 0.1, "outside": 1 / 6}
"""Shares of the kinds of cases."""


@dataclass(frozen=True)
class CasePlan:
    """One case. ``rig``: one of :data:`RIGS`; ``effects``: what it conceals."""

    rig: str
    effects: tuple[str, ...]


def plan_cases(rng: np.random.Generator, cases: int, rigs: Sequence[str]) -> list[CasePlan]:
    """Cases in random order: kinds by their shares, rigs in turn, every effect of a rig once before any comes twice."""
    library = {rig: sorted(DRAWS if rig == "bench" else LIBRARY[rig]) for rig in rigs}
    decks = {rig: _deck(rng, [n for n in library[rig] if n in all_effects()]) for rig in rigs}
    outside = {rig: _deck(rng, sorted(OUTSIDE[rig])) for rig in rigs if rig in OUTSIDE}
    found = []
    for kind, count in _counts(cases, bool(outside)).items():
        turns = cycle(rng.permutation(sorted(outside) if kind == "outside" else list(rigs)))
        for _ in range(count):
            rig = str(next(turns))
            if kind == "outside":
                found.append(CasePlan(rig, (outside[rig](),)))
            else:
                found.append(CasePlan(rig, _distinct(decks[rig], {"empty": 0, "one": 1, "two": 2}[kind])))
    return [found[k] for k in rng.permutation(len(found))]


def _counts(cases: int, outside: bool) -> dict[str, int]:
    """How many cases of each kind; what rounding leaves goes to those with one effect."""
    counts = {kind: round(share * cases) for kind, share in SHARES.items()}
    if not outside:
        counts["outside"] = 0
    counts["one"] = cases - sum(counts[kind] for kind in counts if kind != "one")
    return counts


def _deck(rng: np.random.Generator, names: list[str]) -> Callable[[], str]:
    """Deals names in random order, all of them before any again."""
    left: list[str] = []

    def deal() -> str:
        if not left:
            left.extend(str(n) for n in rng.permutation(names))
        return left.pop()

    return deal


def _distinct(deal: Callable[[], str], count: int) -> tuple[str, ...]:
    found: list[str] = []
    while len(found) < count:
        name = deal()
        if name not in found:
            found.append(name)
    return tuple(found)
