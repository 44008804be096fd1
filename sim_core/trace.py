"""What a rollout comes to: readings, and where its nodes were."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from sim_core.permanent_state import PermanentState
from sim_core.scene.scene import Frame
from sim_core.scene.solid_range import LeastVolume
from sim_core.solve.report import StepReport
from sim_core.state_history import StateHistory

SETTLED_AFTER_S = 3.0
"""Length of a damped pseudo time step [s] beyond which rest is as good as reached."""

FOREVER_S = 1e9
"""Length of the last step of settling [s]: all that relaxes has relaxed."""


@dataclass(frozen=True)
class NodePath:
    """Where the nodes of a rollout were: ``times`` [s] ``(n,)``, ``positions`` [m] ``(n, N, 3)`` in the order of
    :class:`sim_core.scene.Scene`."""

    times: np.ndarray
    positions: np.ndarray


@dataclass(frozen=True)
class Trace:
    """Readings of all channels at the instants of the steps.

    ``times`` [s] ``(n,)``; ``outputs``: channel to ``(n, ...)``; ``kinds``: channel to 'wrench',
    'markers' or 'tracks'; ``ids``: marker numbers; ``reports``: one a step (``n - 1``); ``states``: node positions,
    frames, contact forces and slip at the same instants, where they were asked for, and ``path`` the positions alone.
    ``left``: what bodies keep at the end, None where they keep nothing.
    ``least_volumes``: where gels were pressed most.
    """

    times: np.ndarray
    outputs: dict[str, np.ndarray]
    kinds: dict[str, str]
    ids: dict[str, np.ndarray]
    reports: tuple[StepReport, ...]
    states: StateHistory | None = None
    path: NodePath | None = None
    left: PermanentState | None = None
    least_volumes: tuple[LeastVolume, ...] = ()

    def at(self, channel: str, times: np.ndarray) -> np.ndarray:
        """Readings at any times [s], linear between steps, held at the ends: ``(k, ...)``."""
        return interpolate(self.times, self.outputs[channel], times)


def interpolate(times: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Linear interpolation of ``values`` ``(n, ...)`` at the ``times`` [s] ``(n,)`` along the first axis, in their
    unit, held beyond the ends; ``at`` [s] ``(k,)``."""
    if len(times) == 1:
        return np.repeat(values, len(at), axis=0)
    right = np.clip(np.searchsorted(times, at, side="right"), 1, len(times) - 1)
    share = np.clip((at - times[right - 1]) / (times[right] - times[right - 1]), 0.0, 1.0)
    share = share.reshape(-1, *([1] * (values.ndim - 1)))
    return np.asarray((1.0 - share) * values[right - 1] + share * values[right])


def between(a: Frame, b: Frame, share: float = 0.5) -> Frame:
    """Frame that has gone a share of the way from one to another, turning about one axis."""
    turn = Slerp([0.0, 1.0], Rotation.concatenate([a[1], b[1]]))(share)
    return (1.0 - share) * a[0] + share * b[0], turn


def step_times(start: float, end: float, dt: float) -> np.ndarray:
    """Instants of the steps, ``dt`` apart, from ``start`` to ``end`` [s]: ``(n,)``. The last two share what is left."""
    count = max(1, int(np.ceil((end - start) / dt - 1e-9)))
    times = np.append(start + dt * np.arange(count), end)
    if count > 1:
        times[-2] = 0.5 * (times[-3] + end)
    return times
