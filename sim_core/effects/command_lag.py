"""Lag of an end effector behind its command: a delay and a first-order response.

    p_d(t) = p_c(t - d),    tau dp/dt = p_d - p,    R likewise along the geodesic

with the delay d of the controller and the time constant tau of the arm's tracking. Between steps the delayed command is
held at the end of the step, for which the response is exact: p' = p + (1 - exp(-dt / tau)) (p_d - p), and R' = R
exp((1 - exp(-dt / tau)) log(R^T R_d)) (first-order hold of a linear servo: Siciliano et al., Robotics, 2009, sec. 8.3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sim_core.effects.base import EffectParameter, RecordingScales, Values
from sim_core.effects.hooks import CommandMap
from sim_core.effects.scopes import END_EFFECTORS, Scope
from sim_core.rigs import Rig

if TYPE_CHECKING:
    from sim_core.scene.scene import Frame


@dataclass(frozen=True)
class Past:
    """``commands``: as far back as the delay reaches, (time since the start [s], pose), the oldest first; ``pose``:
    where the end effector is."""

    commands: tuple[tuple[float, Frame], ...]
    pose: Frame


class CommandLag(CommandMap[Past]):
    """An end effector that follows its command late."""

    name = "command_lag"
    title = "the robot follows its command late"
    words = (
        "The end effector is not yet where it was commanded: the controller delays the command, and the arm follows it "
        "like a first-order system."
    )
    signature = "All sensors lag behind the commanded motion alike, the more the faster it is."
    source = "Siciliano, Sciavicco, Villani & Oriolo, Robotics, 2009, sec. 8.3"
    slot = "robot"
    follows = "robot"
    scope = Scope("an end effector that is driven by its command", END_EFFECTORS.names)
    twins = ("stream_delay",)
    separated_by = "Compare the streams with one another: a late clock of one stream leaves the others in time."
    parameters = (
        EffectParameter(
            "delay_s", "s", 0.0, 2.0, (0.02,), 0.0, False, 0.05, "delay of the command", "sampling_s", (1.0, 4.0)
        ),
        EffectParameter(
            "tau_s", "s", 0.0, 5.0, (0.05,), 0.0, False, 0.1, "time constant of the arm", "sampling_s", (2.0, 8.0)
        ),
    )
    example = {"delay_s": 0.015, "tau_s": 0.03}

    def variants(self, rig: Rig, scales: RecordingScales | None = None) -> tuple[Mapping[str, tuple[float, ...]], ...]:
        """A delay alone, and a first-order response alone; none where poses are measured: they have the lag."""
        if not any(e.driven_by == "commanded" for e in rig.end_effectors.values()):
            return ()
        own = [p.fitted_to(scales) for p in self.parameters]
        return tuple({p.name: p.typical if p is q else (0.0,) for p in own} for q in own)

    def begin(self, pose: Frame, values: Values) -> Past:
        return Past(((0.0, pose),), pose)

    def advance(self, memory: Past, pose: Frame, dt: float, values: Values) -> tuple[Past, Frame]:
        commands = (*memory.commands, (memory.commands[-1][0] + dt, pose))
        delay, share = values["delay_s"], _share(dt, values["tau_s"])
        goal = pose if delay == 0.0 else _interpolated(commands, commands[-1][0] - delay)
        reached = goal if share == 1.0 else _towards(memory.pose, goal, share)
        first = max(0, sum(t <= commands[-1][0] - delay for t, _ in commands) - 1)
        return Past(commands[first:], reached), reached

    def pull(self, times: np.ndarray, poses: Sequence[Frame], weights: np.ndarray, values: Values) -> np.ndarray:
        from scipy.spatial.transform import Rotation

        from sim_core.geometry.turns import geodesic, turn_slopes

        since = times - times[0]
        left, mix = _delayed(since, values["delay_s"])
        rotations = Rotation.concatenate([r for _, r in poses])
        right = np.minimum(left + 1, len(times) - 1)
        goals = geodesic(rotations[left], rotations[right], mix)
        by_left, by_right = turn_slopes(lambda a, b: geodesic(a, b, mix), rotations[left], rotations[right])
        shares = np.array([1.0, *(_share(float(dt), values["tau_s"]) for dt in np.diff(times))])
        here = [goals[0]]
        for k in range(1, len(times)):
            here.append(geodesic(here[-1], goals[k], shares[k]))
        behind = Rotation.concatenate([here[0], *here[:-1]])
        by_here, by_goal = turn_slopes(lambda a, b: geodesic(a, b, shares), behind, goals)
        out, carried = np.zeros_like(weights), np.zeros(6)
        for k in reversed(range(len(times))):
            w = weights[k] + carried
            goal = np.concatenate([shares[k] * w[:3], by_goal[k].T @ w[3:]])
            carried = np.concatenate([(1.0 - shares[k]) * w[:3], by_here[k].T @ w[3:]])
            out[left[k]] += np.concatenate([(1.0 - mix[k]) * goal[:3], by_left[k].T @ goal[3:]])
            out[right[k]] += np.concatenate([mix[k] * goal[:3], by_right[k].T @ goal[3:]])
        return out


def _share(dt: float, tau: float) -> float:
    """Share of the way to the goal that is made in ``dt`` [s]."""
    return 1.0 if tau == 0.0 else float(-np.expm1(-dt / tau))


def _towards(start: Frame, goal: Frame, share: float) -> Frame:
    from sim_core.geometry.turns import geodesic

    return start[0] + share * (goal[0] - start[0]), geodesic(start[1], goal[1], share)


def _interpolated(commands: tuple[tuple[float, Frame], ...], at: float) -> Frame:
    """Commanded pose at a time, linear and along geodesics between instants, at rest before the first."""
    times = [t for t, _ in commands]
    if at <= times[0]:
        return commands[0][1]
    k = int(np.searchsorted(times, at, side="right")) - 1
    (start, one), (end, other) = commands[k], commands[min(k + 1, len(commands) - 1)]
    if end == start:
        return one
    share = (at - start) / (end - start)
    return _towards(one, other, share)


def _delayed(since: np.ndarray, delay: float) -> tuple[np.ndarray, np.ndarray]:
    """Between which instants a delayed command is: the earlier one ``(n,)``, and the share of the later one."""
    at = np.maximum(since - delay, 0.0)
    left = np.clip(np.searchsorted(since, at, side="right") - 1, 0, len(since) - 1)
    width = since[np.minimum(left + 1, len(since) - 1)] - since[left]
    return left, np.where(width > 0.0, (at - since[left]) / np.where(width > 0.0, width, 1.0), 0.0)
