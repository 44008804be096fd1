"""Distances of many pairs of primitives by a kernel that is bound once: an unbound call costs more than its work."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sim_core.kernels import BoundKernel

SPARE = 256
"""Pairs that there is room for at first; doubled whenever that does not suffice."""


class PairDistance:
    """``kernel(x, *shapes, count, first, second, out)`` writes the distances [m] of the first ``count`` pairs."""

    def __init__(self, kernel: Callable[..., None], *shapes: np.ndarray) -> None:
        self._kernel, self._shapes = kernel, shapes
        self._x = np.empty((0, 3))
        self._count = np.zeros(1, dtype=np.int32)
        self._out = np.empty(0)

    def __call__(self, x: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Distances [m] ``(k,)`` of pairs, int32 ``(k,)`` each, where nodes are at ``x`` [m] ``(n, 3)``."""
        count = len(first)
        if count > len(self._out) or len(x) != len(self._x):
            self._bind(len(x), max(2 * count, SPARE))
        self._x[:], self._count[0] = x, count
        self._first[:count], self._second[:count] = first, second
        self._run()
        return np.array(self._out[:count])

    def _bind(self, nodes: int, capacity: int) -> None:
        self._x, self._out = np.zeros((nodes, 3)), np.zeros(capacity)
        self._first, self._second = np.zeros(capacity, dtype=np.int32), np.zeros(capacity, dtype=np.int32)
        pairs = (self._count, self._first, self._second, self._out)
        self._run = BoundKernel(self._kernel, self._x, *self._shapes, *pairs)
