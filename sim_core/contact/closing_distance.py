"""By how much nodes have come nearer to each other."""

import numpy as np
import taichi as ti

from sim_core.kernels import F1, F2, I1, BoundKernel, vec3


@ti.func
def _farthest(a: ti.template(), b: ti.template(), members: ti.template(), mean):
    squared = 0.0
    for k in range(members.shape[0]):
        i = members[k]
        move = vec3(b[i, 0] - a[i, 0], b[i, 1] - a[i, 1], b[i, 2] - a[i, 2]) - mean
        squared = ti.max(squared, move.dot(move))
    return ti.sqrt(squared)


@ti.func
def _mean(a: ti.template(), b: ti.template(), members: ti.template()):
    total = vec3(0.0, 0.0, 0.0)
    for k in range(members.shape[0]):
        i = members[k]
        total += vec3(b[i, 0] - a[i, 0], b[i, 1] - a[i, 1], b[i, 2] - a[i, 2])
    return total / members.shape[0]


@ti.kernel
def _approach(a: F2, b: F2, ours: I1, theirs: I1, stretch: F1, out: F1):
    ti.loop_config(serialize=True)
    for _ in range(1):
        mean = 0.5 * (_mean(a, b, ours) + _mean(a, b, theirs))
        out[0] = stretch[0] * _farthest(a, b, ours, mean) + stretch[1] * _farthest(a, b, theirs, mean)


class Approach:
    """Bound on how much nearer any of our nodes has come to any of theirs: the largest moves of both from a common
    mean. ``ours``, ``theirs``: int32 ``(k,)``; ``stretch``: how many times further than its nodes a side may move."""

    def __init__(self, ours: np.ndarray, theirs: np.ndarray, stretch: tuple[float, float]) -> None:
        self._members = (ours.astype(np.int32), theirs.astype(np.int32), np.array(stretch))
        self._a = self._b = np.empty((0, 3))
        self._out = np.zeros(1)

    def __call__(self, a: np.ndarray, b: np.ndarray) -> float:
        """While nodes moved from ``a`` to ``b`` [m] ``(n, 3)`` [m]."""
        if len(a) != len(self._a):
            self._a, self._b = np.zeros((len(a), 3)), np.zeros((len(a), 3))
            self._run = BoundKernel(_approach, self._a, self._b, *self._members, self._out)
        self._a[:], self._b[:] = a, b
        self._run()
        return float(self._out[0])
