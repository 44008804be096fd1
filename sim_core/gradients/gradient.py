"""The gradient of a loss over a whole rollout."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.energies.term import Internals
from sim_core.trace import Trace

MEMORY_MB = 1024.0
"""Bound on what the steps that are kept of a rollout may take, where none is given."""


@dataclass(frozen=True)
class Gradient:
    """``value`` of the loss and its derivatives: ``parameters`` by name; ``poses``: by end effector ``(n_times, 6)``
    [1/m, 1/rad]; ``start_x`` [1/m] and ``start_v`` [s/m]: of the state that the first step starts from, ``(n, 3)``;
    ``start_memory``: of its internal variables (plastic curvature [m], elastic slip of friction [1/m], memory of
    stress), by term and name."""

    value: float
    parameters: dict[str, float]
    poses: dict[str, np.ndarray]
    start_x: np.ndarray
    start_v: np.ndarray
    start_memory: dict[str, Internals]
    trace: Trace
    fields: dict[str, np.ndarray]
    """By name, one value an element or hinge, or a vector a node (:class:`sim_core.scene.fields.Fields`)."""
