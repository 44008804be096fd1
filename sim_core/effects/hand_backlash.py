"""Backlash of the hand: it follows its command only when the play between them is used up.

    p' = p                          |c - p| <= b
    p' = c - b (c - p) / |c - p|    otherwise

with the command c, the place p of the hand before, and half the play b, in space; turns likewise, along the shortest
turn from one orientation to the other (play operator: Brokate & Sprekels, Hysteresis and Phase Transitions, 1996, sec.
2.1; with a ball in place of an interval). At the start the hand is in the middle of its play.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import CommandMap
from sim_core.effects.scopes import END_EFFECTORS

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

    from sim_core.scene.scene import Frame


class HandBacklash(CommandMap["Frame"]):
    """A hand with play."""

    name = "hand_backlash"
    title = "the hand has play"
    words = "The hand stays where it is after each reversal until the play of joints, gears or gripper is used up."
    signature = "After each reversal of the motion all sensors see the hand at rest for the same distance."
    source = "Brokate & Sprekels, Hysteresis and Phase Transitions, 1996, sec. 2.1 (play operator)"
    slot = "robot"
    follows = "robot"
    scope = END_EFFECTORS
    twins = ("command_lag", "static_friction")
    separated_by = "Slow reversals in air at several speeds: play is a distance, a lag is a time."
    parameters = (
        EffectParameter("play_m", "m", 0.0, 0.05, (2e-4, 1e-3), 0.0, False, 5e-4, "half the play of places"),
        EffectParameter("play_deg", "deg", 0.0, 30.0, (0.2,), 0.0, False, 0.3, "half the play of turns"),
    )
    example = {"play_m": 4e-4, "play_deg": 0.0}

    def begin(self, pose: Frame, values: Values) -> Frame:
        return pose

    def advance(self, memory: Frame, pose: Frame, dt: float, values: Values) -> tuple[Frame, Frame]:
        place, turn = pose
        if values["play_m"] > 0.0:
            place = memory[0] + _share(pose[0] - memory[0], values["play_m"]) * (pose[0] - memory[0])
        if values["play_deg"] > 0.0:
            turn = _towards(memory[1], pose[1], np.deg2rad(values["play_deg"]))
        return (place, turn), (place, turn)

    def pull(self, times: np.ndarray, poses: Sequence[Frame], weights: np.ndarray, values: Values) -> np.ndarray:
        from scipy.spatial.transform import Rotation

        play, turn_play = values["play_m"], np.deg2rad(values["play_deg"])
        here = [poses[0]]
        for pose in poses[1:]:
            here.append(self.advance(here[-1], pose, 0.0, values)[0])
        behind = [here[0], *here[:-1]]
        one, other = (Rotation.concatenate([turn for _, turn in frames]) for frames in (behind, poses))
        by_behind, by_command = _turn_slopes(one, other, turn_play)
        out, carried = np.zeros_like(weights), np.zeros(6)
        for k in reversed(range(1, len(times))):
            w, away = weights[k] + carried, poses[k][0] - behind[k][0]
            kept = _by_behind(away, play) @ w[:3]
            out[k] = np.concatenate([w[:3] - kept, by_command[k].T @ w[3:]])
            carried = np.concatenate([kept, by_behind[k].T @ w[3:]])
        out[0] = weights[0] + carried
        return out


def _share(away: np.ndarray, play: float) -> np.ndarray:
    """Share of the way to the command that is made, ``(..., 1)``."""
    size = np.linalg.norm(away, axis=-1, keepdims=True)
    return np.where(size > play, 1.0 - play / np.where(size > 0.0, size, 1.0), 0.0)


def _by_behind(away: np.ndarray, play: float) -> np.ndarray:
    """Derivative of where the hand is by where it was, ``(3, 3)``; by the command, it is one less this."""
    size = float(np.linalg.norm(away))
    if size <= play:
        return np.zeros((3, 3)) if play == 0.0 else np.eye(3)
    n = away / size
    return np.asarray(play / size * (np.eye(3) - np.outer(n, n)))


def _towards(one: Rotation, other: Rotation, play: float) -> Rotation:
    from sim_core.geometry.turns import geodesic

    return geodesic(one, other, _share((one.inv() * other).as_rotvec(), play)[..., 0])


def _turn_slopes(one: Rotation, other: Rotation, play: float) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the turn in the world of where the hand is by small turns of where it was, and of the command,
    ``(n, 3, 3)`` each."""
    if play == 0.0:
        return np.zeros((len(one), 3, 3)), np.tile(np.eye(3), (len(one), 1, 1))
    from sim_core.geometry.turns import turn_slopes

    return turn_slopes(lambda a, b: _towards(a, b, play), one, other)
