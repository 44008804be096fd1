"""Which quantity a subject is coloured by, and its values on all surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.errors import ConfigError, nearest_match
from sim_core.postprocess import QUANTITIES, quantity
from sysid.show.style import round_up
from sysid.show.subject import Subject

PREFERRED = ("pressure", "strain", "curvature", "displacement")
"""What a subject is coloured by where nothing is asked for: the first that is not zero everywhere."""

BODY = "body"
"""What colours each body in its own colour."""

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


def check_quantity(by: str | None) -> None:
    """Whether something can be coloured by this. Raises ``ConfigError``."""
    if by is not None and by not in (BODY, *QUANTITIES):
        raise ConfigError(f"Nothing can be coloured by {by!r}.", nearest_match(by, [BODY, *QUANTITIES]))


def chosen(subject: Subject, coloured: dict[str, Colouring], by: str | None) -> Colouring | None:
    """What a subject is coloured by where ``by`` was asked for: without, what says most, and a rig at rest by body."""
    first = None if subject.what == "rig" else next(iter(coloured), None)
    return coloured.get(by or first or BODY)


def telling_step(subject: Subject, coloured: Colouring | None) -> int:
    """The instant at which the quantity is largest over all bodies together; without one, the middle."""
    if coloured is None:
        return len(subject.times) // 2 if subject.moves else 0
    total = sum(np.nan_to_num(v).sum(axis=1) for v in coloured.values.values())
    return int(np.argmax(total))
