"""Which quantity a subject is coloured by, and its values on all surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.postprocess import QUANTITIES, quantity
from sysid.show.style import round_up
from sysid.show.subject import Subject

PREFERRED = ("pressure", "strain", "curvature", "displacement")
"""What a subject is coloured by where nothing is asked for: the first that is not zero everywhere."""

LARGEST = 99.5
"""Percentile of the values that takes the end of the scale: single nodes do not."""


@dataclass(frozen=True)
class Colouring:
    """Values in the unit shown: by body ``(n, v)``, NaN where a body has none; ``top``: end of the scale, from 0."""

    name: str
    unit: str
    words: str
    values: dict[str, np.ndarray]
    top: float

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} [{self.unit}]"


def colouring(subject: Subject, name: str) -> Colouring | None:
    """A subject by one quantity; None where it is zero everywhere."""
    q = QUANTITIES[name]
    values = {
        skin.body: q.factor
        * np.stack(
            [
                quantity(name, subject.layout, skin, subject.states, k, subject.frames[k])
                for k in range(len(subject.times))
            ]
        )
        for skin in subject.skins
    }
    known = np.concatenate([v[np.isfinite(v)] for v in values.values()] or [np.zeros(0)])
    if not len(known) or float(known.max()) < 1e-9:
        return None
    positive = known[known > 1e-3 * float(known.max())]
    return Colouring(name, q.unit, q.words, values, round_up(float(np.percentile(positive, LARGEST))))


def colourings(subject: Subject) -> dict[str, Colouring]:
    """All quantities that are not zero everywhere, the preferred one first."""
    found = {name: c for name in QUANTITIES if (c := colouring(subject, name)) is not None}
    first = [name for name in PREFERRED if name in found]
    return {name: found[name] for name in dict.fromkeys([*first, *found])}
