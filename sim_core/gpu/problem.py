"""Rollouts of one mesh as arrays: what all have in common, and what each has of its own. Imports numpy alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

OWN = (
    "external",
    "mass",
    "mass_damping",
    "stretch_stiffness",
    "stretch_damping",
    "rest_angle",
    "bend_stiffness",
    "bend_damping",
    "law",
    "body_rotation",
    "follower_local",
)
"""Arrays of the record that a rollout may have of its own, in the order of ``Launch`` (rollouts.cpp)."""


@dataclass
class Problem:
    """``record``: fields of the record, of the first rollout (:mod:`sim_core.core.record_layout`); ``own``: by names of
    its arrays, those of all rollouts ``(n, ...)`` where they differ; ``plan``: :mod:`sim_core.gpu.plan`. ``places``:
    origins [m] and rotations of the mounts ``(n or 1, t, mounts, 12)`` at ``times`` [s] ``(t,)``; ``start``: positions
    of the nodes before they settle [m] ``(n or 1, nodes, 3)``; ``inertia``: whether it counts after that."""

    rollouts: int
    record: dict[str, Any]
    own: dict[str, np.ndarray]
    plan: dict[str, Any]
    places: np.ndarray
    times: np.ndarray
    start: np.ndarray
    inertia: bool

    def part(self, count: int) -> Problem:
        """The first of the rollouts."""
        own = {name: array[:count] for name, array in self.own.items()}
        return replace(self, rollouts=count, own=own, places=self.places[:count], start=self.start[:count])
