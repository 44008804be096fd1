"""Whether a person would call a motion a success: conditions besides its reward, a finer mesh and shorter steps.

At the end of a rollout, when the hands have let go and rested (``afterwards`` of the task),

* the reward is that of a success, and no finger bore more than it may;
* bodies rest on what they are to rest on, which bears more than half of their weight, and those that are to be apart do
  not touch;
* at no instant did the surface of one body go through that of another, whether a contact is declared or not.

Then it is rolled out with cells and steps half as large, where the same has to be so: what is a success on one mesh
alone is none.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sim_core.contact.intersection_check import cross
from sim_core.postprocess import Layout, Surface, surfaces
from sim_core.scene.scene import Scene
from sim_core.tasks.load import MadeTask
from sim_core.tasks.rollout import TaskRollouts

FINER = 2
"""Cells and steps in the place of each in the second rollout."""

FINELY = "with cells and steps half as large"


@dataclass(frozen=True)
class Verdict:
    """``failures``: why a motion is no success, in words; ``reward``, and ``refined_reward`` with cells and steps half
    as large, NaN where a rollout ended early or was not made; ``cpu_s``: process time [s]."""

    failures: tuple[str, ...]
    reward: float
    refined_reward: float
    cpu_s: float

    @property
    def passed(self) -> bool:
        """Whether it is a success."""
        return not self.failures


class Checker:
    """Checks motions of one task."""

    def __init__(self, made: MadeTask) -> None:
        self._made, self._plain = made, TaskRollouts(made)
        self._fine: TaskRollouts | None = None

    def check(self, action: np.ndarray) -> Verdict:
        """Whether the motion of an action ``(size,)`` is a success. The second rollout is made where the first one has
        nothing against it."""
        began = time.process_time()
        failures, reward = judged(self._plain, action)
        finer = float("nan")
        if not failures:
            if self._fine is None:
                self._fine = TaskRollouts(self._made, finer=FINER, target=self._plain.target)
            found, finer = judged(self._fine, action)
            failures = [f"{FINELY}, {words}" for words in found]
        return Verdict(tuple(failures), reward, finer, time.process_time() - began)


class Judge:
    """Says of the episode that is being made in ``rollouts`` whether its motion is a success: :meth:`look` after each
    step, :meth:`failures` at the end."""

    def __init__(self, rollouts: TaskRollouts) -> None:
        self._rollouts, self._skins, self._through = rollouts, _Skins(rollouts.scene), ""

    def begin(self) -> None:
        """Another episode begins."""
        self._through = ""

    def look(self, k: int) -> None:
        """At the surfaces of bodies, at the time number ``k``."""
        self._through = self._through or self._skins.through(self._rollouts, k)

    def failures(self, stopped: str) -> tuple[list[str], float]:
        """Why the motion is no success, in words, and its reward. ``stopped``: why the rollout ended early, if so."""
        failures, made = [self._through] if self._through else [], self._rollouts.made
        if stopped:
            return [*failures, f"the rollout ends early: {stopped}"], float("nan")
        scored = self._rollouts.scored()
        if not scored.reward >= made.variant.success:
            failures.append(f"the reward is {scored.reward:.4g} in the end, less than {made.variant.success:g}")
        elif not scored.holds:
            failures.append("what the reward asks for besides does not hold in the end")
        return [*failures, *_unmet(self._rollouts)], scored.reward


def judged(rollouts: TaskRollouts, action: np.ndarray) -> tuple[list[str], float]:
    """Why the motion of an action is no success in these rollouts, in words, and its reward."""
    poses, judge = rollouts.poses(action), Judge(rollouts)
    rollouts.begin(poses)
    return judge.failures(rollouts.advance(poses, len(rollouts.times) - 1, judge.look))


def _unmet(rollouts: TaskRollouts) -> list[str]:
    """Conditions that are not met where a rollout stands, in words."""
    made, scene = rollouts.made, rollouts.scene
    forces, found = rollouts.episode.simulation.contact_forces(), []
    for body, under in made.conditions.rests_on.items():
        contact = rollouts.rig.contact(body, under)
        assert contact is not None
        nodes = scene.bodies[body].nodes
        weight = (scene.system.mass @ np.tile(scene.system.gravity, (scene.system.mass.shape[0], 1)))[nodes].sum(axis=0)
        borne = -float(forces[contact.name][nodes].sum(axis=0) @ weight) / max(float(weight @ weight), 1e-300)
        if not borne > 0.5:
            found.append(f"{under} bears {100.0 * max(0.0, borne):.0f} % of the weight of {body} in the end")
    for one, other in made.conditions.apart:
        contact = rollouts.rig.contact(one, other)
        assert contact is not None
        if np.abs(forces[contact.name]).any():
            found.append(f"{one} and {other} touch in the end")
    return found


class _Skins:
    """Surfaces of all bodies of a scene."""

    def __init__(self, scene: Scene) -> None:
        self._layout = Layout(scene.rig, scene.bodies, scene.start)
        self._pairs = [
            (a, b) for a, b in combinations(surfaces(self._layout), 2) if a.nodes is not None or b.nodes is not None
        ]
        self._edges = {s.body: _edges(s.triangles) for pair in self._pairs for s in pair}

    def through(self, rollouts: TaskRollouts, k: int) -> str:
        """Which of them go through each other at an instant, in words; empty where none do."""
        simulation = rollouts.episode.simulation
        x, frames = simulation.state.x, simulation.frames
        for one, other in self._pairs:
            if self._cross(one, other, [s.vertices(self._layout, x, frames) for s in (one, other)]):
                return f"{one.body} and {other.body} go through each other at {rollouts.times[k]:.3f} s"
        return ""

    def _cross(self, one: Surface, other: Surface, vertices: Sequence[np.ndarray]) -> bool:
        a, b = vertices
        if (a.max(axis=0) < b.min(axis=0)).any() or (b.max(axis=0) < a.min(axis=0)).any():
            return False
        points = np.vstack([a, b])
        ours, theirs = self._edges[one.body], self._edges[other.body] + len(a)
        return cross(points, ours, other.triangles + len(a)) or cross(points, theirs, one.triangles)


def _edges(triangles: np.ndarray) -> np.ndarray:
    return np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
