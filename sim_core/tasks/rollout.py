"""Rollouts of a task: the reward of an action, whether it is a success, and the exact gradient by the action."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim_core.errors import ConfigError, ConvergenceError, nearest_match
from sim_core.gradients.adjoint import Backward
from sim_core.gradients.tape import Tape
from sim_core.postprocess import lay_out, surfaces
from sim_core.rigs import Rig, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import Scene, build_scene
from sim_core.simulate import Simulation, Trace, run
from sim_core.solve.state import State
from sim_core.tasks.actions import ActionSpace
from sim_core.tasks.episode import EarlyStop, Episode, Watch, frames_at
from sim_core.tasks.load import MadeTask
from sim_core.tasks.measure import Measure, Reward, Scored, Seen, instrumented
from sim_core.tasks.rest import resting_state
from sim_core.trajectories import planned_path

STOPPED = -1e9
"""Fitness of a rollout that ended at once; it rises with the steps that were made, and is below that of all others."""

DRAWS = 20
"""Motions that are drawn for a target at most."""


@dataclass(frozen=True)
class Outcome:
    """What became of an action. ``reward``: NaN where the rollout ended early, after the share ``completed`` of its
    steps, for the reason ``stopped``; ``force_n``: largest force on a finger [N]; ``cpu_s``: processor time [s];
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


class TaskRollouts:
    """Makes rollouts of one task, one after the other, in one scene. What a rollout gives does not depend on those
    before. ``coarse``: with the cells of searches; ``finer``: number of steps in each of the task, with as many cells
    in the place of each; ``target``: positions to be reached, by default those that the task draws; ``sensors``: with
    those of the rig and its cameras besides. ``episode``: the rollout that is being made, or was made last without a
    gradient; ``times`` [s] of its steps; ``fingers``: end effectors that the hands move."""

    def __init__(
        self,
        made: MadeTask,
        coarse: bool = False,
        *,
        finer: int = 1,
        target: Mapping[str, np.ndarray] | None = None,
        sensors: bool = False,
    ) -> None:
        self.made, self._finer = made, finer
        self.space = ActionSpace(made)
        self._reward = reward_of(made.task.reward)
        self.rig: Rig = instrumented(made, made.coarse_rig if coarse else made.rig, sensors)
        self.scene: Scene = build_scene(self.rig, finer)
        _take_weight(self.scene, made.variant.weightless)
        self.times: np.ndarray = np.linspace(0.0, self.space.times[-1], finer * (len(self.space.times) - 1) + 1)
        self.fingers = [f for hand in made.actions.hands.values() for f in hand.fingers]
        self._limits = {f: self.rig.end_effectors[f].limits for f in self.fingers}
        self._tops = {body: _box_around(self.rig, body) for body in made.stop.over.values()}
        self._rests: dict[tuple[tuple[str, float], ...], State | None] = {}
        self._rest = self._resting({})
        self.episode = Episode(Simulation(self.scene, begin=self._rest), self.times)
        self._measure = Measure(made, self.scene, self.space.first, {})
        self.target = self._make_target() if target is None else target
        """Positions of observed points at the end that are to be reached, by name, where the task has some."""
        self._measure = Measure(made, self.scene, self.space.first, self.target)

    def _resting(self, parameters: Mapping[str, float]) -> State | None:
        """The state at rest in which rollouts with these parameters begin; None where the scene settles by itself."""
        space, held = self.space, self.made.task.begins == "held"
        if self.scene.all_held and not held:
            return None
        key = tuple(sorted(parameters.items()))
        if key not in self._rests:
            begin = space.grip if held else space.poses(np.zeros(space.size))
            count = len(next(iter(begin.values())).times) if held else 1
            frames = [frames_at(begin, k) for k in range(count)]
            self._rests[key] = resting_state(self.scene, frames[0], self.made.task.step_s, frames[1:])
        return self._rests[key]

    def _make_target(self) -> dict[str, np.ndarray]:
        """Points at the end of a motion drawn at random, for tasks that are to reach a shape: with the setting
        ``target_seed``. Entries of the motion are normal with the standard deviations ``target_scale``, one for each
        component (or one for all), and motions are drawn until one brings the points ``target_least_m`` (root mean
        square) away from where they are without any."""
        settings = self.made.settings
        if "target_seed" not in settings:
            return {}
        if self.made.target_rig is not None:
            return dict(TaskRollouts(replace(self.made, rig=self.made.target_rig, target_rig=None)).target)
        rng = np.random.default_rng(int(settings["target_seed"]))
        given = np.atleast_1d(np.asarray(settings["target_scale"], dtype=float))
        scale = (np.full(7, given[0]) if len(given) == 1 else np.append(given, np.zeros(7))[:7])[self.space.components]
        least = float(settings["target_least_m"])
        still = self._end(np.zeros(self.space.size))
        for _ in range(DRAWS):
            drawn = self._end(np.clip(scale * rng.standard_normal(self.space.size), -1.0, 1.0))
            if still and drawn and _distance(drawn, still) >= least:
                return drawn
        raise ConfigError(
            f"None of {DRAWS} motions drawn for the target of {self.made.name} comes to an end {1e3 * least:g} mm away "
            "from where doing nothing leads.",
            "Choose another target_seed, another target_scale or a smaller target_least_m.",
        )

    def _end(self, action: np.ndarray) -> dict[str, np.ndarray]:
        """Positions of the observed points at the end; none where the rollout ends early."""
        if self._forward(self.poses(action)):
            return {}
        seen = self.episode.seen(self._measure, self._finer)
        return {name: p[-1] for name, p in seen.points.items()}

    def _forward(self, poses: Mapping[str, PoseTrajectory]) -> str:
        """Make a whole rollout as the :attr:`episode`. Gives why it ended early; empty where it did not."""
        self.begin(poses)
        return self.advance(poses, len(self.times) - 1)

    def begin(self, poses: Mapping[str, PoseTrajectory]) -> None:
        """Begin an :attr:`episode`, at rest."""
        self.episode.begin(poses, self._watch())

    def advance(
        self, poses: Mapping[str, PoseTrajectory], to: int, look: Callable[[int], None] = lambda k: None
    ) -> str:
        """Go on with the :attr:`episode` to a step, and ``look`` after each with its number. Gives why it ended early;
        empty where it did not."""
        try:
            self.episode.advance(poses, to, look)
        except ConvergenceError as error:
            at = self.times[self.episode.at + 1]
            return f"the step at {at:.3f} s did not converge: {error.problem}"
        except EarlyStop as stop:
            return str(stop)
        return ""

    def scored(self) -> Scored:
        """The reward of the :attr:`episode` as if it ended now."""
        return self._reward(self.episode.seen(self._measure, self._finer))

    def successful(self, scored: Scored) -> bool:
        """Whether a rollout with this reward is a success, as far as that can be decided without
        :class:`sim_core.tasks.check.Checker`."""
        return scored.reward >= self.made.variant.success and scored.holds

    def _watch(self) -> Watch:
        stop, fine, measure = self.made.stop, self._finer, self._measure
        touching = range(fine * (self.space.first + stop.touching_from), fine * self.space.last + 1)
        return Watch(stop, self._limits, self.times, touching, measure.middle, self._tops)

    def use(self, parameters: Mapping[str, float]) -> None:
        """Take values of named parameters of the rig, in place of those that it has."""
        self.scene.use(with_parameters(self.rig, parameters))
        self.scene.system.loads[:] = 0.0
        _take_weight(self.scene, self.made.variant.weightless)
        self._rest = self._resting(parameters)
        self.episode.simulation.begin = self._rest

    def poses(self, action: np.ndarray) -> dict[str, PoseTrajectory]:
        """Poses of all end effectors at :attr:`times` as they are executed for an action ``(size,)``, within the limits
        of the hands."""
        poses = self.space.poses(self.space.executable(action))
        if self._finer == 1:
            return poses
        curves = {name: planned_path(self.space.times, pose) for name, pose in poses.items()}
        return {n: PoseTrajectory.from_samples(self.times, *c.sample(self.times), source=n) for n, c in curves.items()}

    def outcome(self, action: np.ndarray) -> Outcome:
        """Of one action ``(size,)``."""
        began = time.thread_time()
        reason = self._forward(self.poses(action))
        episode = self.episode
        if reason:
            return self._early(reason, episode.at, episode.watch.force_n, began)
        return self._whole(self.scored(), episode.watch.force_n, began, None)

    def gradient(self, action: np.ndarray) -> Outcome:
        """The outcome of an action with the gradient of its reward; without it where the rollout ends early. Not of
        rollouts with finer steps."""
        began, watch = time.thread_time(), self._watch()
        try:
            tape = Tape(self.scene, self.poses(action), self.times, watch=watch, begin=self._rest)
        except ConvergenceError as error:
            return self._early(f"a step did not converge: {error.problem}", watch.steps, watch.force_n, began)
        except EarlyStop as stop:
            return self._early(str(stop), watch.steps, watch.force_n, began)
        scored = self._reward(self._measure.seen(self.times, tape.trace.outputs, tape.end.internals))
        readings, memory = self._measure.back(scored)
        found = Backward(tape, []).gradient(scored.reward, readings, memory)
        slope = self.space.pull(self.space.executable(action), found.poses)
        return self._whole(scored, watch.force_n, began, self.space.pull_executable(action, slope))

    def _early(self, reason: str, steps: int, most: float, began: float) -> Outcome:
        share = steps / (len(self.times) - 1)
        return Outcome(float("nan"), False, share, reason, most, steps, time.thread_time() - began)

    def _whole(self, scored: Scored, most: float, began: float, slope: np.ndarray | None) -> Outcome:
        steps = len(self.times) - 1
        return Outcome(scored.reward, self.successful(scored), 1.0, "", most, steps, time.thread_time() - began, slope)

    def seen(self, action: np.ndarray) -> tuple[Seen, float]:
        """What the reward of an action is made of, and the reward. Raises ``ConvergenceError`` where it stops early."""
        reason = self._forward(self.poses(action))
        if reason:
            raise ConvergenceError(f"The rollout of {self.made.name} ended early: {reason}.", "Choose another action.")
        seen = self.episode.seen(self._measure, self._finer)
        return seen, self._reward(seen).reward

    def sought(self) -> dict[str, np.ndarray]:
        """Where observed points are to be at the end of the :attr:`episode` [m] ``(k, 3)``, by name, where the reward
        says it."""
        return dict(self.scored().sought)

    def trace(self, action: np.ndarray, parameters: Mapping[str, float] | None = None) -> Trace:
        """The rollout of an action with its states, on the rig with its own sensors and cameras, weights included.

        ``parameters``: of the rig, in place of those that it has.
        """
        scene = build_scene(with_parameters(self.made.rig, parameters or {}))
        _take_weight(scene, self.made.variant.weightless)
        self.use(parameters or {})
        return run(Simulation(scene, begin=self._rest), self.poses(action), self.space.times, keep_states=True)


def _distance(one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]) -> float:
    """Root mean square distance of points [m]."""
    squares = np.concatenate([((one[name] - other[name]) ** 2).sum(axis=1) for name in one])
    return float(np.sqrt(squares.mean()))


def _box_around(rig: Rig, body: str) -> np.ndarray:
    """Lower and upper corner of the box around a body at the start [m] ``(2, 3)``."""
    layout = lay_out(rig)
    surface = next(s for s in surfaces(layout) if s.body == body)
    vertices = surface.vertices(layout, layout.rest, layout.start)
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


def _take_weight(scene: Scene, bodies: tuple[str, ...]) -> None:
    """Let gravity not act on some bodies: loads that cancel their weight."""
    if not bodies:
        return
    mass = np.asarray(scene.system.mass.sum(axis=1)).ravel()
    for name in bodies:
        nodes = scene.bodies[name].nodes
        scene.system.loads[nodes] -= mass[nodes, None] * scene.system.gravity
