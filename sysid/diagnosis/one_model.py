"""What the posterior of a ledger says, beside the verdict of a diagnosis.

All rests on :mod:`sysid.comparison.posterior`: no limit of the verdict has a part in it. The most probable set of
causes is the answer; where it is less than sure, all sets as large that belong to the 95 % are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sim_core.effects import effect_by_name
from sysid.comparison.explanations import UNKNOWN
from sysid.comparison.ledger import Ledger
from sysid.comparison.posterior import posterior
from sysid.settings.diagnosis import DIAGNOSIS

WHERE = {
    "gel": "in the gel",
    "sheet": "in the sheet",
    "contact": "at a contact",
    "robot": "in the motion of the hand",
    "environment": "in what acts on the bodies from outside",
    "wrench": "in a wrench sensor",
    "camera": "in a camera",
    "markers": "in the markers",
    "clock": "in a clock",
}
"""Places of the model in words."""


@dataclass(frozen=True)
class ProbableSet:
    """Causes that are missing together. ``causes``: names of effects, and 'unknown: ' with a place; ``words``."""

    causes: tuple[str, ...]
    words: str
    probability: float


@dataclass(frozen=True)
class OneModel:
    """``kind``: 'nothing_missing', 'named', 'one_of' or 'unknown', where a place with unknown physics is in the most
    probable set; ``sets``: most probable first; ``nothing``, ``unknown``: probabilities that nothing is missing, and
    that something is that no effect of the library describes; ``effects``, ``places``: probability by effect, and of
    each place of the model that something is missing there, largest first; ``sentence``."""

    kind: str
    sentence: str
    sets: tuple[ProbableSet, ...]
    nothing: float
    unknown: float
    effects: dict[str, float]
    places: dict[str, float]

    @property
    def answer(self) -> tuple[str, ...]:
        """Effects that are said to be missing, or to be one of those that are."""
        chosen = self.sets if self.kind == "one_of" else self.sets[:1]
        return tuple(dict.fromkeys(c for s in chosen for c in s.causes if not c.startswith(UNKNOWN)))


def one_model(ledger: Ledger) -> OneModel:
    """What a ledger says."""
    found = posterior(ledger, bags=0)
    best = found.models[0]
    sets = tuple(
        ProbableSet(m.effects, _words(m.effects), m.probability) for m in found.credible()[: DIAGNOSIS.sets_shown]
    )
    known = {e: p for e, p in found.inclusion.items() if not e.startswith(UNKNOWN)}
    unnamed = any(e.startswith(UNKNOWN) for e in best.effects)
    kind = "unknown" if unnamed else "named" if best.effects else "nothing_missing"
    if kind == "named" and best.probability < DIAGNOSIS.sure_probability:
        sets = tuple(s for s in sets if len(s.causes) == len(best.effects) and UNKNOWN not in "".join(s.causes))
        kind = "one_of" if len(sets) > 1 else kind
    else:
        sets = sets[:1]
    return OneModel(
        kind, _sentence(sets, found.nothing, found.unknown, next(iter(found.in_place), "")), sets, found.nothing,
        found.unknown, known, found.in_place,
    )  # fmt: skip


def _words(causes: Sequence[str]) -> str:
    parts = []
    for cause in causes:
        if cause.startswith(UNKNOWN):
            place = cause.removeprefix(UNKNOWN)
            parts.append(f"something that no known effect describes is missing {WHERE.get(place, place)}")
        else:
            parts.append(effect_by_name(cause).title)
    return " and ".join(parts) or "nothing is missing"


def _sentence(sets: Sequence[ProbableSet], nothing: float, unknown: float, place: str) -> str:
    said = "; or ".join(f"{s.words} ({_percent(s.probability)})" for s in sets)
    rest = f"Something that no known effect describes: {_percent(unknown)}. Nothing: {_percent(nothing)}."
    where = f" Most probably, what is missing is {WHERE.get(place, place)}." if nothing < 0.5 and place else ""
    return f"By the one model: {said}. {rest}{where}"


def _percent(probability: float) -> str:
    if probability < 0.01:
        return "less than 1 %"
    return "more than 99 %" if probability > 0.99 else f"{100.0 * probability:.0f} %"
