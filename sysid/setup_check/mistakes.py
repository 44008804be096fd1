"""The discrete mistakes of set-up that are tried, each with what it makes of readings or poses and the line that mends
the rig.

A mistake of the readings is a linear map of what the rig predicts for the right set-up, so that one rollout serves all
of them; one of the poses says where the end effectors really were, and needs a rollout of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs.trajectory import PoseTrajectory
from sysid.settings.setup_check import SETUP_CHECK

Poses = Mapping[str, PoseTrajectory]


@dataclass(frozen=True)
class Mistake:
    """One mistake of set-up.

    ``kind``: a word for its kind, the same for all recordings; ``words``: what is wrong, a clause;
    ``line``: what to write into the rig, or what to do; ``part``: sensor, camera or end effector; ``weight``: how
    common it is relative to others. One of the two: ``readings`` maps the readings ``(k, m)`` of the channel ``part``
    that the right set-up gives to those that are recorded; ``poses`` maps recorded poses to the true ones.
    """

    kind: str
    words: str
    line: str
    part: str
    weight: float = 1.0
    readings: Callable[[np.ndarray], np.ndarray] | None = None
    poses: Callable[[Poses], dict[str, PoseTrajectory]] | None = None


def signed_permutations() -> list[np.ndarray]:
    """The 48 matrices ``(3, 3)`` that exchange or reverse axes, the identity first."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[np.arange(3), order] = signs
            found.append(matrix)
    return found


def commonness(matrix: np.ndarray) -> float:
    """How common a signed permutation is among mistakes of axes: 1 for one that takes a single act (a quarter or half
    turn about one axis, one axis reversed, two exchanged, all reversed), and the share of mistakes for one that takes
    two of them at once."""
    along = np.count_nonzero(np.diag(matrix)) == 3
    turned = np.linalg.det(matrix) > 0.0
    exchanged = np.trace(matrix) == 1.0 and (turned or matrix.min() == 0.0)
    return 1.0 if along or exchanged else SETUP_CHECK.prior_of_mistake


def axes_of(matrix: np.ndarray) -> str:
    """Axes along which the rows of a signed permutation are, as the rig file has them: ``[x, -z, y]``."""
    words = []
    for row in matrix:
        axis = int(np.argmax(np.abs(row)))
        words.append(("-" if row[axis] < 0.0 else "") + "xyz"[axis])
    return "[" + ", ".join(words) + "]"


def pose_text(position: np.ndarray, rotation: Rotation) -> str:
    """A pose as a rig file has it; by its quaternion where roll and yaw are degenerate."""
    if np.degrees(rotation.magnitude()) < 1e-6:
        return f"{{position_m: {numbers(position, 5)}}}"
    if abs(rotation.as_matrix()[2, 0]) > 1.0 - 1e-9:
        return f"{{position_m: {numbers(position, 5)}, quaternion_xyzw: {numbers(rotation.as_quat(), 7)}}}"
    return f"{{position_m: {numbers(position, 5)}, rpy_deg: {numbers(rotation.as_euler('xyz', degrees=True), 2)}}}"


def numbers(values: np.ndarray, digits: int = 4) -> str:
    """Numbers as a rig file has them."""
    return "[" + ", ".join(f"{round(float(v), digits) + 0.0:g}" for v in values) + "]"
