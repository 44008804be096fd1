"""Tasks as Gymnasium environments (Towers et al. 2024), for reinforcement learning with any library that takes those.

    import gymnasium
    env = gymnasium.make("sim_core.tasks.environment:thinshell/folding_l-v0", decisions=6)
    envs = gymnasium.make_vec("sim_core.tasks.environment:thinshell/folding_l-v0", 8)  # on threads, one a core

An episode is a rollout of the task from the end of its approach on, and what is done in it is an action of the task: a
decision in [-1, 1] is the velocity at its next knot, as a share of the bound of one step for each component of each
hand. Until then the velocity changes linearly (``profile: constant``: at once, and is held). A decision after which the
hands could not come to rest within their limits by the knot after it is scaled down, turns first.

Observations are clipped to [-10, 10] (:mod:`sim_core.tasks.observation`): the state of the bodies, or what the sensors
and cameras of the rig read.

The reward of one decision is what it adds to the progress of the task, as if that ended now. Progress is 0 at the start
and 1 at a success: (R - R_start) / |R_success - R_start| for a reward R, or, where the task has a ``best`` reward, of
what is missing, m = best - R,

    log(m_start / m) / log(m_start / m_success),      m at least :data:`LEAST_MISSING` m_success,

so that halving a distance counts alike far from a target and near it. Where a rollout ends early, the episode ends with
the reward :data:`FAILED`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from sim_core.errors import ConfigError
from sim_core.rigs import list_parameters, resolve_name
from sim_core.tasks.load import DEFAULT_VARIANT, MadeTask, load_task, read_task, task_names
from sim_core.tasks.observation import Kind, Observer
from sim_core.tasks.rollout import TaskRollouts
from sim_core.tasks.schema import Actions

FAILED = -10.0
"""Reward of a decision on which the rollout ends early."""

LEAST_MISSING = 0.01
"""Of what is missing to the best reward at a success: what is closer counts as this."""

MOST = 10.0
"""Bound of observations."""

HALVINGS = 12
"""Of the interval in which the largest share of a decision that is within the limits is sought."""

Range = tuple[float, float]


class TaskEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One task. ``task``: as :func:`sim_core.tasks.load_task` takes it; ``decisions`` of an episode, by default the
    knots of the task; ``vary``: intervals of parameters of the rig, from which each episode draws evenly; ``observe``:
    ``state`` or ``sensors`` (:mod:`sim_core.tasks.observation`).

    ``around``: an action of the task ``(size,)`` with as many knots, about which is decided: a decision d then asks for
    ``around + reach d``, ``reach`` above 0 and at most 1.

    ``info`` has ``reward``: R, ``success``, ``stopped``: why the rollout ended early, and the ``parameters`` drawn.
    ``action_so_far`` is what was done in the episode, as an action of ``rollouts``; ``look`` is called after each step
    with its number; ``noise``: standard deviation of the sensors' noise in each entry of an observation ``(m,)``.
    """

    def __init__(
        self,
        task: str,
        decisions: int | None = None,
        vary: Mapping[str, Range] | None = None,
        observe: Kind = "state",
        around: np.ndarray | None = None,
        reach: float = 1.0,
    ) -> None:
        if not 0.0 < reach <= 1.0:
            raise ConfigError(
                f"reach is {reach:g}, the share of the bounds by which decisions change a motion.",
                "Choose one above 0 and at most 1.",
            )
        made = load_task(task)
        steps = made.actions.steps
        decisions = made.actions.knots if decisions is None else decisions
        if not 1 <= decisions <= steps:
            raise ConfigError(
                f"decisions is {decisions}, but the hands of {made.name} act in {steps} steps.", f"Choose 1 to {steps}."
            )
        self.made = _with_actions(made, made.actions.model_copy(update={"knots": decisions}))
        self._vary = _intervals(self.made, vary or {})
        self.rollouts = TaskRollouts(self.made, sensors=observe == "sensors")
        space = self.rollouts.space
        self._decisions, self._ends = decisions, _ends(self.made, space.first, len(space.times) - 1)
        self._each = space.size // decisions
        self._around, self._reach = np.zeros(space.size), reach
        if around is not None:
            if np.shape(around) != (space.size,):
                raise ConfigError(
                    f"around has the shape {np.shape(around)}, but an action of {self.made.name} with {decisions} "
                    f"decisions has {space.size} numbers.",
                    "Give a motion of the same task, and as many decisions as its actions have knots.",
                )
            self._around = space.executable(around)
        self.action_so_far = np.zeros(space.size)
        hands = self.made.actions.hands.values()
        fastest = max(float(hand.bounds()[:3].max()) for hand in hands) or 1e-3
        turning = max(float(hand.bounds()[3:6].max()) for hand in hands) or 1e-2
        length, turn = 0.25 * steps * fastest, 0.25 * steps * turning
        self._observer = Observer(self.rollouts, observe, length, turn, fastest / self.made.task.step_s)
        self.look: Callable[[int], None] = lambda k: None
        self._parameters: dict[str, float] = {}
        self._begin()
        self._observer.take_nominal()
        self._observer.begin()
        self.noise = self._observer.noise()
        size = len(self.noise)
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
        self._begin()
        self._observer.begin()
        self._reward = self._first = self.rollouts.scored().reward
        return self._observation(), self._info("")

    def _begin(self) -> None:
        """Begin a rollout, and make the approach."""
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

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Carry out a decision ``(k,)``."""
        if self._decision >= self._decisions:
            raise ConfigError("The episode is over.", "Call reset().")
        self._decide(np.clip(np.asarray(action, dtype=float), -1.0, 1.0))
        space = self.rollouts.space
        stopped = self.rollouts.advance(space.poses(self.action_so_far), int(self._ends[self._decision]), self.look)
        self._decision += 1
        if stopped:
            self._decision = self._decisions
            return self._observation(), FAILED, True, False, self._info(stopped)
        before, self._reward = self._progress(self._reward), self.rollouts.scored().reward
        gained = self._progress(self._reward) - before
        return self._observation(), gained, self._decision == self._decisions, False, self._info("")

    def _progress(self, reward: float) -> float:
        """Of the way from the reward at the start to that of a success, as the module describes it."""
        best, success = self.made.task.best, self.made.variant.success
        if best is None:
            return float((reward - self._first) / (abs(success - self._first) or 1.0))
        missing = np.maximum([best - self._first, best - reward], LEAST_MISSING * (best - success))
        return float(np.log(missing[0] / missing[1]) / np.log(max(missing[0] / (best - success), 2.0)))

    def _decide(self, decision: np.ndarray) -> None:
        """Take the decision into the action so far, or the largest share of it with which the hands can still come to
        rest within their limits: of its turns, then of its translations."""
        entries = self._entries(self._decision)
        asked = np.clip(self._around[entries] + self._reach * decision, -1.0, 1.0)
        turns = np.isin(self.rollouts.space.components[entries], (3, 4, 5))
        for chosen in (turns, ~turns):
            self._take_largest_share(entries[chosen], asked[chosen])

    def _take_largest_share(self, entries: np.ndarray, asked: np.ndarray) -> None:
        """Take the largest share of what is asked that is within the limits of the hands: none of it always is, since
        they could come to rest after the decision before."""
        if self._taken(entries, asked):
            return
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._taken(entries, middle * asked) else (low, middle)
        self._taken(entries, low * asked)

    def _taken(self, entries: np.ndarray, values: np.ndarray) -> bool:
        """Take values into the action so far. Gives whether it is within the limits of the hands."""
        self.action_so_far[entries] = values
        return bool(np.array_equal(self.rollouts.space.executable(self.action_so_far), self.action_so_far))

    def _entries(self, decision: int) -> np.ndarray:
        """Of an action of the whole episode, those of one decision: in each hand, knots come first."""
        found, at = [], 0
        for hand in self.made.actions.hands.values():
            count = int(np.count_nonzero(hand.bounds()))
            found.append(at + decision * count + np.arange(count))
            at += self._decisions * count
        return np.concatenate(found)

    def _observation(self) -> np.ndarray:
        seen = self._observer.observation(self._decision / self._decisions, self.np_random)
        return np.asarray(np.clip(seen, -MOST, MOST), dtype=np.float32)

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


def _ends(made: MadeTask, first: int, last: int) -> np.ndarray:
    """Step numbers at which decisions are carried out ``(decisions,)``: the last one with what is done afterwards.
    ``first``: at which the hands begin to act; ``last`` of the rollout."""
    actions = made.actions
    intervals = actions.knots + (actions.profile == "linear")
    places = np.floor((np.arange(actions.steps) + 0.5) / actions.steps * intervals)
    ends = first + np.searchsorted(places, np.arange(1, actions.knots + 1))
    ends[-1] = last
    return np.asarray(ends)


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
