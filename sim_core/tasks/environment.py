"""Tasks as Gymnasium environments (Towers et al. 2024), for reinforcement learning with any library that takes those.

    import gymnasium
    env = gymnasium.make("sim_core.tasks.environment:thinshell/folding_l-v0", every=5)
    envs = gymnasium.make_vec("sim_core.tasks.environment:thinshell/folding_l-v0", 8)  # on threads, one a core

An episode is a rollout of the task from the end of its approach on. An action in [-1, 1] is a share of the bound of one
step for each component of each hand; it is held for ``every`` steps. So the actions of an episode, one after the other,
are an action of the same task with the profile ``constant``.

Observations are of order one and clipped to [-10, 10]:

* of each sheet 16 nodes far apart, and of each affine body its four control nodes: displacement since the start by the
  way that the hands can go in a quarter of the episode, velocity by the greatest speed of the hands;
* of each finger displacement and turn since the start (by the same length, and by the turn that goes with it), force by
  the force at which the task ends;
* the share of the time that is over.

The reward of one action is what it adds to the reward R of the task, as if that ended now, by |R_success - R_start|,
so that an episode's return is (R_end - R_start) / |R_success - R_start|, whatever the task. Where a rollout ends early,
the episode ends with the reward :data:`FAILED`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.rigs import Affine, Sheet, list_parameters, resolve_name
from sim_core.tasks.load import DEFAULT_VARIANT, MadeTask, load_task, read_task, task_names
from sim_core.tasks.measure import FORCE
from sim_core.tasks.rollout import TaskRollouts
from sim_core.tasks.schema import Actions

FAILED = -10.0
"""Reward of an action on which the rollout ends early."""

MOST = 10.0
"""Bound of observations."""

SEEN_NODES = 16
"""Nodes of a sheet that are observed."""

Range = tuple[float, float]


class TaskEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One task. ``task``: as :func:`sim_core.tasks.load_task` takes it; ``every``: steps for which an action is held;
    ``vary``: intervals of parameters of the rig, from which each episode draws evenly.

    ``info`` has ``reward``: R, ``success``, ``stopped``: why the rollout ended early, and the ``parameters`` drawn.
    ``action_so_far`` is what was done in the episode, as an action of ``rollouts``.
    """

    def __init__(self, task: str, every: int = 5, vary: Mapping[str, Range] | None = None) -> None:
        made = load_task(task)
        steps = made.actions.steps
        if not 1 <= every <= steps:
            raise ConfigError(
                f"every is {every}, but the hands of {made.name} act in {steps} steps.", f"Choose 1 to {steps}."
            )
        self.made = _with_actions(
            made, made.actions.model_copy(update={"knots": -(-steps // every), "profile": "constant"})
        )
        self._vary = _intervals(self.made, vary or {})
        self.rollouts = TaskRollouts(self.made)
        space = self.rollouts.space
        self._decisions = self.made.actions.knots
        self._ends = space.first + np.searchsorted(
            np.arange(steps) * self._decisions // steps, np.arange(1, self._decisions + 1)
        )
        self._ends[-1] = len(space.times) - 1
        self._each = space.size // self._decisions
        self.action_so_far = np.zeros(space.size)
        self._nodes = np.concatenate([_seen_nodes(self.rollouts, name) for name in _seen_bodies(self.made)])
        hands = self.made.actions.hands.values()
        fastest = max(float(hand.bounds()[:3].max()) for hand in hands) or 1e-3
        turning = max(float(hand.bounds()[3:6].max()) for hand in hands) or 1e-2
        self._length, self._turn = 0.25 * steps * fastest, 0.25 * steps * turning
        self._speed = fastest / self.made.task.step_s
        size = 6 * len(self._nodes) + 9 * len(self.rollouts.fingers) + 1
        self.action_space = Box(-1.0, 1.0, (self._each,), np.float32)
        self.observation_space = Box(-MOST, MOST, (size,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """A new episode. ``options``: ``parameters`` of the rig by name, in place of those drawn."""
        super().reset(seed=seed)
        drawn = {name: float(self.np_random.uniform(low, high)) for name, (low, high) in self._vary.items()}
        given = dict((options or {}).get("parameters", {}))
        self._parameters = {**drawn, **{resolve_name(self.made.rig, n): float(v) for n, v in given.items()}}
        self.rollouts.use(self._parameters)
        self.action_so_far = np.zeros(self.rollouts.space.size)
        self._decision, poses = 0, self.rollouts.space.poses(self.action_so_far)
        self.rollouts.begin(poses)
        stopped = self.rollouts.advance(poses, self.rollouts.space.first)
        if stopped:
            raise ConfigError(
                f"The approach of {self.made.name} ends early: {stopped}.",
                f"Choose other parameters than {self._parameters}." if self._parameters else "Mend the task.",
            )
        state = self.rollouts.episode.simulation.state
        self._start = state.x[self._nodes].copy()
        self._begun = self._frames()
        self._reward = self._first = self.rollouts.scored().reward
        self._scale = abs(self.made.variant.success - self._first) or 1.0
        return self._observation(), self._info("")

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold an action ``(k,)`` for its steps."""
        if self._decision >= self._decisions:
            raise ConfigError("The episode is over.", "Call reset().")
        space = self.rollouts.space
        entries = self._entries(self._decision)
        self.action_so_far[entries] = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        stopped = self.rollouts.advance(space.poses(self.action_so_far), int(self._ends[self._decision]))
        self._decision += 1
        if stopped:
            self._decision = self._decisions
            return self._observation(), FAILED, True, False, self._info(stopped)
        before, self._reward = self._reward, self.rollouts.scored().reward
        gained = (self._reward - before) / self._scale
        return self._observation(), float(gained), self._decision == self._decisions, False, self._info("")

    def _entries(self, decision: int) -> np.ndarray:
        """Of an action of the whole episode, those of one decision: in each hand, knots come first."""
        found, at = [], 0
        for hand in self.made.actions.hands.values():
            count = int(np.count_nonzero(hand.bounds()))
            found.append(at + decision * count + np.arange(count))
            at += self._decisions * count
        return np.concatenate(found)

    def _frames(self) -> dict[str, tuple[np.ndarray, Rotation]]:
        frames = self.rollouts.episode.simulation.frames
        return {finger: frames[finger] for finger in self.rollouts.fingers}

    def _observation(self) -> np.ndarray:
        episode = self.rollouts.episode
        state, reading = episode.simulation.state, episode.readings[-1]
        parts = [
            (state.x[self._nodes] - self._start).ravel() / self._length,
            state.v[self._nodes].ravel() / self._speed,
        ]
        for finger, (position, turn) in self._frames().items():
            origin, before = self._begun[finger]
            parts += [
                (position - origin) / self._length,
                (turn * before.inv()).as_rotvec() / self._turn,
                reading[f"{FORCE}{finger}"][:3] / self.made.stop.most_force_n,
            ]
        parts.append(np.array([self._decision / self._decisions]))
        return np.asarray(np.clip(np.concatenate(parts), -MOST, MOST), dtype=np.float32)

    def _info(self, stopped: str) -> dict[str, Any]:
        over = self._decision == self._decisions
        success = over and not stopped and self.rollouts.successful(self.rollouts.scored())
        return {"reward": self._reward, "success": success, "stopped": stopped, "parameters": dict(self._parameters)}


def _with_actions(made: MadeTask, actions: Actions) -> MadeTask:
    return replace(made, variant=made.variant.model_copy(update={"actions": actions}))


def _intervals(made: MadeTask, vary: Mapping[str, Range]) -> dict[str, Range]:
    """Intervals by full names of parameters. Raises ``ConfigError`` for a parameter that there is not, or an interval
    outside of its bounds."""
    known, found = {p.name: p for p in list_parameters(made.rig)}, {}
    for name, (low, high) in vary.items():
        full = resolve_name(made.rig, name)
        bounds = known[full]
        if not bounds.lower <= low <= high <= bounds.upper:
            raise ConfigError(
                f"vary: {name} is drawn from {low:g} to {high:g}, but may be {bounds.lower:g} to {bounds.upper:g}.",
                "Give the lower end first, both within these bounds.",
            )
        found[full] = (float(low), float(high))
    return found


def _seen_bodies(made: MadeTask) -> list[str]:
    return [name for name, body in made.rig.bodies.items() if isinstance(body, Sheet | Affine)]


def _seen_nodes(rollouts: TaskRollouts, body: str) -> np.ndarray:
    """Nodes of a body that are observed: the first one, then always the one farthest from those before."""
    nodes = np.asarray(rollouts.scene.bodies[body].nodes)
    if len(nodes) <= SEEN_NODES:
        return nodes
    x = rollouts.episode.simulation.state.x[nodes]
    chosen = [0]
    distance = np.linalg.norm(x - x[0], axis=1)
    while len(chosen) < SEEN_NODES:
        chosen.append(int(np.argmax(distance.round(9))))
        distance = np.minimum(distance, np.linalg.norm(x - x[chosen[-1]], axis=1))
    return nodes[chosen]


def register() -> None:
    """Make all tasks of the package known to Gymnasium: ``thinshell/NAME-v0``, and ``thinshell/NAME-VARIANT-v0``."""
    for name in task_names():
        for variant in read_task(name).variants:
            task = name if variant == DEFAULT_VARIANT else f"{name}:{variant}"
            known = f"thinshell/{task.replace(':', '-')}-v0"
            if known not in gymnasium.registry:
                many = "sim_core.tasks.vector_environment:TaskVectorEnv"
                gymnasium.register(known, f"{__name__}:TaskEnv", vector_entry_point=many, kwargs={"task": task})


register()
