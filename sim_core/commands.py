"""From commanded poses to where end effectors are: the effects that act on commands, one after the other.

Offsets against the poses (:mod:`sim_core.scene.offset`) come after these. Without such effects the frames that come out
are the very ones that went in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.effects.base import Instance
from sim_core.effects.hooks import CommandMap
from sim_core.effects.registry import active
from sim_core.rigs import Rig
from sim_core.scene.scene import Frame

Frames = Mapping[str, Frame]
"""Frames of end effectors by name."""


class CommandChain:
    """The command maps of a rig with what they remember. Begin with :meth:`begin`."""

    def __init__(self, rig: Rig) -> None:
        self._maps: list[Instance] = active(rig, CommandMap)
        self._memory: dict[tuple[str, str], Any] = {}

    def __bool__(self) -> bool:
        return bool(self._maps)

    def begin(self, frames: Frames) -> dict[str, Frame]:
        """Rest at the commanded frames."""
        self._memory = {
            (m.key, name): m.effect.begin(frames[name], m.values)
            for m in self._maps
            for name in m.targets
            if name in frames
        }
        return dict(frames)

    def kept(self) -> dict[tuple[str, str], Any]:
        """What is remembered now, to go back to by :meth:`restore`."""
        return dict(self._memory)

    def restore(self, kept: Mapping[tuple[str, str], Any]) -> None:
        """Remember what was remembered before."""
        self._memory = dict(kept)

    def advance(self, frames: Frames, dt: float) -> dict[str, Frame]:
        """Frames of the end effectors after ``dt`` [s] in which the commands went to ``frames``."""
        out = dict(frames)
        for m in self._maps:
            for name in m.targets:
                if name in out:
                    kept = self._memory[m.key, name]
                    self._memory[m.key, name], out[name] = m.effect.advance(kept, out[name], dt, m.values)
        return out


def driven_frames(rig: Rig, commanded: Sequence[Frames], times: np.ndarray) -> list[dict[str, Frame]]:
    """Frames of the end effectors at ``times`` [s] from the commanded ones."""
    chain = CommandChain(rig)
    if not chain:
        return [dict(frames) for frames in commanded]
    out = [chain.begin(commanded[0])]
    for k in range(1, len(times)):
        out.append(chain.advance(commanded[k], float(times[k] - times[k - 1])))
    return out


def motion_between(low: Frame, high: Frame) -> np.ndarray:
    """Translation [m] and turn [rad] from one frame to another near it, in the axes of the first, ``(6,)``."""
    return np.concatenate([low[1].inv().apply(high[0] - low[0]), (low[1].inv() * high[1]).as_rotvec()])


def commanded_weights(
    rig: Rig, commanded: Sequence[Frames], times: np.ndarray, weights: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Derivatives of a loss by small motions of commanded poses in the axes of the true frames (a translation along
    them, a turn about the true origin) ``(n, 6)`` by end effector, from those by motions of the true frames."""
    maps: list[Instance] = active(rig, CommandMap)
    out = {name: w.copy() for name, w in weights.items()}
    for name in out:
        own = [m for m in maps if name in m.targets and name in commanded[0]]
        if not own:
            continue
        stages = [[frames[name] for frames in commanded]]
        for m in own:
            stages.append(_through(m, stages[-1], times))
        offset = rig.end_effectors[name].offset()
        w = _in_world(stages[-1], out[name], offset)
        for m, poses in zip(reversed(own), reversed(stages[:-1]), strict=True):
            w = m.effect.pull(times, poses, w, m.values)
        out[name] = _in_axes(stages[0], w, offset)
    return out


def _through(instance: Instance, poses: Sequence[Frame], times: np.ndarray) -> list[Frame]:
    """Poses that one map makes of others."""
    memory = instance.effect.begin(poses[0], instance.values)
    out = [poses[0]]
    for k in range(1, len(times)):
        memory, pose = instance.effect.advance(memory, poses[k], float(times[k] - times[k - 1]), instance.values)
        out.append(pose)
    return out


def _turned(poses: Sequence[Frame], offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes of the true frames ``(n, 3, 3)``, and their origins relative to those of the poses in the world [m]."""
    rotations = Rotation.concatenate([r for _, r in poses])
    return (rotations * Rotation.from_rotvec(offset[3:])).as_matrix(), rotations.apply(offset[:3])


def _in_world(poses: Sequence[Frame], weights: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """From weights of motions of the true frames in their axes to those of p + rho, exp(phi) R of the poses."""
    axes, arms = _turned(poses, offset)
    force, couple = (np.einsum("nij,nj->ni", axes, part) for part in (weights[:, :3], weights[:, 3:]))
    return np.hstack([force, couple + np.cross(arms, force)])


def _in_axes(poses: Sequence[Frame], weights: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """The inverse of :func:`_in_world`."""
    axes, arms = _turned(poses, offset)
    couple = weights[:, 3:] - np.cross(arms, weights[:, :3])
    return np.hstack([np.einsum("nij,ni->nj", axes, part) for part in (weights[:, :3], couple)])
