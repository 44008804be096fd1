"""What one thing that is missing may be: an effect of the library in some shape, or unknown physics in some place.

An effect is looked at in a few shapes, and is seldom in one of these. It may be

- in one of them, with amplitudes of one of a few scales,
- in several at once, which is how a shape between them looks,
- in one of them and, of the size eps |a|, in any direction of unknown physics of its place, where |a| is what it
  explains itself: what is left of a shape that is not looked at.

Unknown physics of a place resembles an effect of this place but for the same directions of the size eps |a|, or
several of them at once (:mod:`sysid.comparison.posterior`), or none, in directions of the size of a few traces. The
first of these explains as much as that effect with what is left of it, so that what needs more than a named shape is
never surely that effect. Scales are equally probable; how probable all else is, is learnt
(:class:`sysid.comparison.priors.Priors`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.comparison.evidence import Directions, Evidence, joined
from sysid.comparison.priors import AMPLITUDES, PLACE, SHARES, TRACES

UNKNOWN = "unknown: "
"""Begin of the name of a place with unknown physics, where effects have their names."""

VISIBLE = 3.0
"""Convention: trace that an effect explains, in standard deviations of the noise, from which what is left of it has a
size."""


@dataclass(frozen=True)
class Explanation:
    """``label``: the shape of an effect, or of the effect that unknown physics resembles; ``prior``: logarithm of its
    share among those of the same name, but for ``counts`` ``(f,)`` of what has a prior weight that is learnt;
    ``factor``: log B by itself; ``like``: the effect that unknown physics resembles."""

    label: str
    directions: Directions
    prior: float
    counts: np.ndarray
    factor: float
    like: str = ""


@dataclass(frozen=True)
class Cause:
    """One thing that may be missing. ``place``: of the model; ``explanations``: most probable first."""

    name: str
    place: str
    explanations: tuple[Explanation, ...]

    @property
    def unknown(self) -> bool:
        """Whether it is physics that the library does not have."""
        return self.name.startswith(UNKNOWN)


def causes_of(evidence: Evidence, weights: np.ndarray) -> list[Cause]:
    """All effects and places of a ledger. ``weights``: logarithms of the prior weights, by which explanations are
    sorted."""
    effects: dict[str, list[str]] = {}
    for effect, label in evidence.shapes:
        effects.setdefault(effect, []).append(label)
    places = {e: evidence.columns[evidence.shapes[e, labels[0]][0]].place for e, labels in effects.items()}
    found: list[Cause] = []
    alike: dict[str, list[Explanation]] = {place: [] for place in evidence.unknown}
    for effect, labels in effects.items():
        own = _of_shapes(evidence, effect, labels)
        best = max(own, key=lambda e: e.prior + e.factor)
        explained = evidence.explained(best.directions)
        if explained > VISIBLE and places[effect] in evidence.unknown:
            share = -float(np.log(sum(p == places[effect] for p in places.values())))
            for k, size in enumerate(SHARES):
                both = joined([best.directions, evidence.unknown_directions(places[effect], size * explained)])
                factor = evidence.factor(both)
                own.append(Explanation(best.label, both, 0.0, counts_of(f"left {k}"), factor))
                alike[places[effect]].append(
                    Explanation(best.label, both, share, counts_of(f"alike {k}"), factor, effect)
                )
        found.append(Cause(effect, places[effect], _sorted(own, weights)))
    for place in evidence.unknown:
        free = []
        for k, size in enumerate(TRACES):
            directions = evidence.unknown_directions(place, size)
            free.append(Explanation("", directions, 0.0, counts_of(f"free {k}"), evidence.factor(directions)))
        own = [Explanation(e.label, e.directions, e.prior, e.counts + counts_of("unknown"), e.factor, e.like)
               for e in (*free, *alike[place])]  # fmt: skip
        found.append(Cause(f"{UNKNOWN}{place}", place, _sorted(own, weights)))
    return found


def _of_shapes(evidence: Evidence, effect: str, labels: Sequence[str]) -> list[Explanation]:
    """An effect in each of its shapes, and in all of them at once."""
    found = []
    each = -float(np.log(len(labels) * len(AMPLITUDES)))
    for scale in AMPLITUDES:
        parts = [evidence.directions((effect, label), scale) for label in labels]
        for label, part in zip(labels, parts, strict=True):
            found.append(Explanation(label, part, each, counts_of(), evidence.factor(part)))
        if len(parts) > 1:
            whole = joined(parts)
            whole = replace(whole, one_sided=np.zeros(len(whole.index), dtype=bool))
            best = max(range(len(parts)), key=lambda k: found[k - len(parts)].factor)
            share = -float(np.log(len(AMPLITUDES)))
            found.append(Explanation(labels[best], whole, share, counts_of("family"), evidence.factor(whole)))
    return found


def _sorted(found: Sequence[Explanation], weights: np.ndarray) -> tuple[Explanation, ...]:
    return tuple(sorted(found, key=lambda e: -(e.prior + e.factor + float(e.counts @ weights))))


def counts_of(*names: str) -> np.ndarray:
    """What prior weights count in an explanation ``(f,)``, by their names."""
    found = np.zeros(len(PLACE))
    for name in names:
        found[PLACE[name]] += 1.0
    return found
