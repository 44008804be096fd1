"""Rollouts of a task: the reward of an action, whether it is a success, and the exact gradient by the action."""

from __future__ import annotations

import importlib
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.errors import ConfigError, ConvergenceError, nearest_match
from sim_core.gradients.adjoint import Backward
from sim_core.gradients.tape import Tape
from sim_core.rigs import Rig, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import Scene, build_scene
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation, Trace, run
from sim_core.tasks.actions import ActionSpace
from sim_core.tasks.load import MadeTask
from sim_core.tasks.measure import FORCE, Measure, Reward, Seen, instrumented
from sim_core.tasks.schema import Stop

STOPPED = -1e9
"""Fitness of a rollout that ended at once; it rises with the steps that were made, and is below that of all others."""


MOST_HALVINGS = 12
"""Steps that do not converge at once and are halved, in one rollout: what goes on so is violent, and slow."""


@dataclass(frozen=True)
class Outcome:
    """What became of an action. ``reward``: NaN where the rollout ended early, after the share ``completed`` of its
    steps, for the reason ``stopped``; ``force_n``: largest force on a finger [N]; ``cpu_s``: process time [s];
    ``folds`` [rad]; ``gradient`` of the reward ``(size,)``, where it was asked for."""

    reward: float
    success: bool
    completed: float
    stopped: str
    force_n: float
    steps: int
    cpu_s: float
    gradient: np.ndarray | None = None

    @property
    def fitness(self) -> float:
        """The reward, or, where the rollout ended early, less than any reward, and more the later that was."""
        return self.reward if not self.stopped else STOPPED * (2.0 - self.completed)


def reward_of(name: str) -> Reward:
    """The reward function in ``sim_core.tasks.rewards``."""
    try:
        module = importlib.import_module(f"sim_core.tasks.rewards.{name}")
    except ModuleNotFoundError:
        import pkgutil

        import sim_core.tasks.rewards as package

        known = [m.name for m in pkgutil.iter_modules(package.__path__)]
        raise ConfigError(f"There is no reward {name!r}.", nearest_match(name, known)) from None
    function: Reward = module.reward
    return function


class EarlyStop(Exception):
    """A rollout ends before its time."""


class _Watch:
    """Ends a rollout that does not count. ``steps``: so many were made; ``force_n``: largest force on a finger [N]."""

    def __init__(self, stop: Stop, fingers: list[str], times: np.ndarray, touching: range) -> None:
        self._stop, self._fingers, self._times, self._touching = stop, fingers, times, touching
        self.steps, self.force_n = 0, 0.0

    def __call__(self, step: int, reading: Mapping[str, np.ndarray], halvings: int) -> None:
        self.steps = step
        now = max(float(np.linalg.norm(reading[f"{FORCE}{f}"][:3])) for f in self._fingers)
        self.force_n = max(self.force_n, now)
        at = f"at {self._times[step]:.3f} s"
        if not np.isfinite(now):
            raise EarlyStop(f"a force is not finite {at}")
        if now > self._stop.most_force_n:
            raise EarlyStop(f"a finger bears {now:.3g} N {at}, more than {self._stop.most_force_n:g}")
        if step in self._touching and now < self._stop.least_force_n:
            raise EarlyStop(f"no finger bears {self._stop.least_force_n:g} N {at}")
        if halvings > MOST_HALVINGS:
            raise EarlyStop(f"more than {MOST_HALVINGS} steps were halved {at}")


class TaskRollouts:
    """Makes rollouts of one task, one after the other, in one scene. What a rollout gives does not depend on those
    before. ``coarse``: with the cells of searches."""

    def __init__(self, made: MadeTask, coarse: bool = False) -> None:
        self.made = made
        self.space = ActionSpace(made)
        self._reward = reward_of(made.task.reward)
        self.rig: Rig = instrumented(made, made.coarse_rig if coarse else made.rig)
        self.scene: Scene = build_scene(self.rig)
        _take_weight(self.scene, made.variant.weightless)
        self._simulation = Simulation(self.scene)
        self._fingers = [f for hand in made.actions.hands.values() for f in hand.fingers]
        self._target = self._make_target()
        self._measure = Measure(made, self.scene, self.space.first, self._target)

    def _make_target(self) -> dict[str, np.ndarray]:
        """Points at the end of a motion drawn at random, for tasks that are to reach a shape: with the setting
        ``target_seed``."""
        if "target_seed" not in self.made.settings:
            return {}
        rng = np.random.default_rng(int(self.made.settings["target_seed"]))
        scale = float(self.made.settings.get("target_scale", 0.5))
        outputs = None
        for _ in range(20):
            action = np.clip(scale * rng.standard_normal(self.space.size), -1.0, 1.0)
            outputs, reason, _, _ = self._forward(self.space.poses(action))
            if not reason:
                break
        if outputs is None or reason:
            raise ConfigError(
                f"No motion drawn for the target of {self.made.name} comes to an end without an early stop.",
                "Choose another target_seed, or a smaller target_scale.",
            )
        measure = Measure(self.made, self.scene, self.space.first, {})
        seen = measure.seen(self.space.times, outputs, self._simulation.state.internals)
        return {name: p[-1] for name, p in seen.points.items()}

    def _forward(self, poses: dict[str, PoseTrajectory]) -> tuple[dict[str, np.ndarray] | None, str, int, float]:
        """Readings, why the rollout ended early (empty where it did not), steps made, and the largest force [N]."""
        times = self.space.times
        tracks = {name: (p.positions, p.quaternions) for name, p in poses.items()}
        frames = [{n: frame_of(p[k], q[k]) for n, (p, q) in tracks.items()} for k in range(len(times))]
        simulation, watch = self._simulation, self._watch()
        self.scene.system.forget()
        simulation.reset(frames[0])
        readings = [simulation.read()]
        k = 0
        try:
            for k in range(1, len(times)):
                simulation.step(frames[k], float(times[k] - times[k - 1]))
                readings.append(simulation.read())
                watch(k, readings[-1], simulation.halvings)
        except ConvergenceError as error:
            return None, f"the step at {times[k]:.3f} s did not converge: {error.problem}", k - 1, watch.force_n
        except EarlyStop as stop:
            return None, str(stop), k, watch.force_n
        return {c: np.stack([r[c] for r in readings]) for c in readings[0]}, "", len(times) - 1, watch.force_n

    def _watch(self) -> _Watch:
        stop, first = self.made.stop, self.space.first
        return _Watch(stop, self._fingers, self.space.times, range(first + stop.touching_from, self.space.last + 1))

    def use(self, parameters: Mapping[str, float]) -> None:
        """Take values of named parameters of the rig, in place of those that it has."""
        self.scene.use(with_parameters(self.rig, parameters))
        self.scene.system.loads[:] = 0.0
        _take_weight(self.scene, self.made.variant.weightless)

    def outcome(self, action: np.ndarray) -> Outcome:
        """Of one action ``(size,)``."""
        began = time.process_time()
        outputs, reason, steps, most = self._forward(self.space.poses(action))
        if outputs is None:
            return self._early(reason, steps, most, began)
        scored = self._reward(self._measure.seen(self.space.times, outputs, self._simulation.state.internals))
        return self._whole(scored.reward, most, began, None)

    def gradient(self, action: np.ndarray) -> Outcome:
        """The outcome of an action with the gradient of its reward; without it where the rollout ends early."""
        began, watch = time.process_time(), self._watch()
        try:
            tape = Tape(self.scene, self.space.poses(action), self.space.times, watch=watch)
        except ConvergenceError as error:
            return self._early(f"a step did not converge: {error.problem}", watch.steps, watch.force_n, began)
        except EarlyStop as stop:
            return self._early(str(stop), watch.steps, watch.force_n, began)
        scored = self._reward(self._measure.seen(self.space.times, tape.trace.outputs, tape.end.internals))
        readings, memory = self._measure.back(scored)
        found = Backward(tape, []).gradient(scored.reward, readings, memory)
        return self._whole(scored.reward, watch.force_n, began, self.space.pull(action, found.poses))

    def _early(self, reason: str, steps: int, most: float, began: float) -> Outcome:
        share = steps / (len(self.space.times) - 1)
        return Outcome(float("nan"), False, share, reason, most, steps, time.process_time() - began)

    def _whole(self, reward: float, most: float, began: float, slope: np.ndarray | None) -> Outcome:
        success, steps = reward >= self.made.variant.success, len(self.space.times) - 1
        return Outcome(reward, success, 1.0, "", most, steps, time.process_time() - began, slope)

    def seen(self, action: np.ndarray) -> tuple[Seen, float]:
        """What the reward of an action is made of, and the reward. Raises ``ConvergenceError`` where it stops early."""
        outputs, reason, _, _ = self._forward(self.space.poses(action))
        if outputs is None:
            raise ConvergenceError(f"The rollout of {self.made.name} ended early: {reason}.", "Choose another action.")
        seen = self._measure.seen(self.space.times, outputs, self._simulation.state.internals)
        return seen, self._reward(seen).reward

    def trace(self, action: np.ndarray) -> Trace:
        """The rollout of an action with its states, on the rig with its own sensors and cameras, weights included."""
        scene = build_scene(self.made.rig)
        _take_weight(scene, self.made.variant.weightless)
        return run(Simulation(scene), self.space.poses(action), self.space.times, keep_states=True)


def _take_weight(scene: Scene, bodies: tuple[str, ...]) -> None:
    """Let gravity not act on some bodies: loads that cancel their weight."""
    if not bodies:
        return
    mass = np.asarray(scene.system.mass.sum(axis=1)).ravel()
    for name in bodies:
        nodes = scene.bodies[name].nodes
        scene.system.loads[nodes] -= mass[nodes, None] * scene.system.gravity
