"""A guide: a point of one body on a line through another, for slider joints.

With the point q and the line through g along d, all of them combinations of nodes (sums over the nodes of both bodies),

    E = k/2 |r x d|^2,    r = q - g

|d| = 1 but for the stretch of the body that carries the line, so r x d is how far q is off the line. The line belongs
to nodes, so force and moment of the two bodies on each other sum to zero.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.energies.affine import KAPPA_PA
from sim_core.energies.term import Memoryless


class Guide(Memoryless):
    """Term of one slider. ``nodes``: int ``(n,)``; ``apart``, ``along``: weights ``(n,)`` of r and d, each of the sum
    zero; ``size_m``: of the body that is guided. The stiffness [N/m] is that of a cube of this size, 8 kappa size."""

    def __init__(self, name: str, nodes: np.ndarray, apart: np.ndarray, along: np.ndarray, size_m: float) -> None:
        self.name = name
        self._nodes = np.asarray(nodes, dtype=np.int32)
        self._apart, self._along = apart, along
        self._stiffness = 8.0 * KAPPA_PA * size_m

    @property
    def nodes(self) -> np.ndarray:
        """Of both bodies, int32 ``(n,)``."""
        return self._nodes

    @property
    def weights(self) -> np.ndarray:
        """Of r and d ``(n, 2)``."""
        return np.column_stack([self._apart, self._along])

    @property
    def stiffness(self) -> float:
        """k [N/m]."""
        return self._stiffness

    def configure(self, parameters: Mapping[str, float]) -> None:
        del parameters
