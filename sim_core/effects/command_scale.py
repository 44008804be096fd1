"""Scale of the commanded motion: the end effector moves too far, or not far enough, by a constant share of its way.

p_i' = p_i + s_i (p_i - p_i0)

from the first pose p_0 on, along the axes of the base frame: errors of the lengths of links, or of the pitch of
spindles (Mooring, Roth & Driels, Fundamentals of Manipulator Calibration, 1991). Turns are as commanded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import CommandMap
from sim_core.effects.scopes import END_EFFECTORS

if TYPE_CHECKING:
    from sim_core.scene.scene import Frame

NAMES = ("scale_x", "scale_y", "scale_z")


class CommandScale(CommandMap[np.ndarray]):
    """A robot whose metre is not a metre."""

    name = "command_scale"
    title = "the robot moves too far"
    words = "The end effector moves further, or less far, than its poses say, by a constant share along each axis."
    signature = "Depths and ways are off in proportion to the distance from the start, with and without contact."
    source = "Mooring, Roth & Driels, Fundamentals of Manipulator Calibration, 1991"
    slot = "robot"
    follows = "robot"
    scope = END_EFFECTORS
    twins = ("end_effector_compliance", "marker_scale", "camera_intrinsics")
    separated_by = "A motion in air along a ruler."
    parameters = tuple(
        EffectParameter(n, "-", -0.5, 1.0, (0.02,), 0.0, False, 0.02, f"share of the way along {n[-1]} that is added")
        for n in NAMES
    )
    example = {"scale_x": 0.1, "scale_y": -0.1, "scale_z": 0.08}

    def begin(self, pose: Frame, values: Values) -> np.ndarray:
        return pose[0]

    def advance(self, memory: np.ndarray, pose: Frame, dt: float, values: Values) -> tuple[np.ndarray, Frame]:
        return memory, (pose[0] + _shares(values) * (pose[0] - memory), pose[1])

    def pull(self, times: np.ndarray, poses: Sequence[Frame], weights: np.ndarray, values: Values) -> np.ndarray:
        out, more = weights.copy(), _shares(values) * weights[:, :3]
        out[:, :3] += more
        out[0, :3] -= more.sum(axis=0)
        return np.asarray(out)


def _shares(values: Values) -> np.ndarray:
    return np.array([values[n] for n in NAMES])
