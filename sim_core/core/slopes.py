"""Derivatives of the numbers of the mechanics by parameters, as the core takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Modulations:
    """Columns that are sums of others, with weights that change in time: column ``of[e]`` times ``weights[:, e]`` ``(t,
    e)`` is added to column ``to[e]``."""

    of: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    to: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    weights: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True)
class NumberSlopes:
    """Derivatives of the numbers of the mechanics by parameters. ``keys``: of the numbers, as
    :mod:`sim_core.gradients.directions` has them; ``table``: ``(n_keys, n_parameters)``, of columns that are sums of
    others which numbers these have; ``modulations``: these sums."""

    keys: Sequence[tuple[str, str, str]] = ()
    table: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    modulations: Modulations = field(default_factory=Modulations)

    @property
    def count(self) -> int:
        """How many parameters there are."""
        return int(self.table.shape[1])

    def of(self, owner: str) -> list[tuple[str, np.ndarray]]:
        """Numbers of a term that change, with their slopes ``(p,)``."""
        return [(q, self.table[k]) for k, (kind, name, q) in enumerate(self.keys) if kind == "terms" and name == owner]
