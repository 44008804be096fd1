"""Laws that effects add to contacts, for the record of the core: each is called by the address of its formula."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np

from sim_core.contact.edges import EdgeContact
from sim_core.contact.rigid import RigidContact
from sim_core.contact.surface import SurfaceContact
from sim_core.core.slopes import NumberSlopes

KINDS = ("pressure", "bond", "friction")
"""Kinds of :class:`sim_core.contact.added_laws.Formula`, in the order of include/added_laws.hpp."""


def added_laws(
    terms: Sequence[RigidContact | SurfaceContact | EdgeContact], by: NumberSlopes, columns: int
) -> dict[str, Any]:
    """Fields of the record for the laws of contact ``terms``; ``columns``: room for derivatives."""
    formulas = [term.laws.formulas for term in terms]
    flat = list(chain.from_iterable(formulas))
    slopes = np.zeros((sum(len(f.numbers) for f in flat), columns))
    numbers = [(term, name) for term, own in zip(terms, formulas, strict=True) for f in own for name in f.numbers]
    for k, (term, name) in enumerate(numbers):
        slopes[k, : by.count] = dict(by.of(term.name)).get(name, 0.0)
    return {
        "added_start": np.cumsum([0, *(len(own) for own in formulas)]),
        "bond_reach": [term.laws.bond_reach for term in terms],
        "added_kind": [KINDS.index(f.kind) for f in flat],
        "added_function": [f.law.address for f in flat],
        "added_number_start": np.cumsum([0, *(len(f.numbers) for f in flat)]),
        "added_number": [value for f in flat for value in f.values],
        "d_added_number": slopes,
    }
