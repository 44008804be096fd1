"""Rotations between two others, and the derivatives of where they turn to."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

TURN_STEP = 1e-5
"""Turn [rad] by which turns are differentiated, centrally."""


def geodesic(one: Rotation, other: Rotation, share: np.ndarray | float) -> Rotation:
    """Rotations after a ``share``, ``(n,)`` or one number, of the shortest turn from one to the other:

    R(s) = R_1 exp(s log(R_1^T R_2))
    """
    turn = (one.inv() * other).as_rotvec()
    return one * Rotation.from_rotvec(np.asarray(share)[..., None] * turn)


def turn_slopes(
    between: Callable[[Rotation, Rotation], Rotation], one: Rotation, other: Rotation
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the turn in the world of ``between(one, other)`` by small turns in the world of ``one`` and of
    ``other``, n rotations each, ``(n, 3, 3)`` each; by central differences."""
    middle = between(one, other)
    found: tuple[list[np.ndarray], list[np.ndarray]] = [], []
    for axis in np.eye(3):
        for which, slopes in enumerate(found):
            ends = []
            for step in (TURN_STEP, -TURN_STEP):
                turn = Rotation.from_rotvec(step * axis)
                there = between(turn * one, other) if which == 0 else between(one, turn * other)
                ends.append((there * middle.inv()).as_rotvec())
            slopes.append((ends[0] - ends[1]) / (2.0 * TURN_STEP))
    return np.stack(found[0], axis=-1), np.stack(found[1], axis=-1)
