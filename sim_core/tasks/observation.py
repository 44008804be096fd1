"""What is seen of a task between two decisions: the state of the bodies, or what the sensors of the rig read.

Numbers are of order one. ``state``, which only a simulation has:

* of each sheet 16 nodes far apart, and of each affine body its four control nodes: displacement since the start by the
  way that the hands can go in a quarter of the episode, velocity by the greatest speed of the hands;
* of each finger the force by the force at which the task ends.

``sensors``, as a robot has them, each with the noise that the rig declares, drawn anew at each decision:

* forces by :data:`FORCE_N` and torques by :data:`TORQUE_NM` of wrench sensors;
* displacements of markers by :data:`MARKER_M`, and of camera tracks by :data:`TRACK_PX`, from where they are at the
  start on the rig as its file has it, so that they tell of other materials from the start on; 0 where out of sight.

Both have the displacement and turn of each finger since the start (by the same length, and by the turn that goes with
it), and the share of the decisions that are made.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Affine, MarkerSensor, Sheet, WrenchSensor
from sim_core.scene.scene import Frame
from sim_core.tasks.measure import FORCE
from sim_core.tasks.rollout import TaskRollouts

Kind = Literal["state", "sensors"]

SEEN_NODES = 16
"""Nodes of a sheet that are observed."""

FORCE_N, TORQUE_NM, MARKER_M, TRACK_PX = 1.0, 0.01, 1e-3, 50.0
"""Scales of readings: those of a finger that presses paper."""


class Observer:
    """Observes the episode of ``rollouts``, which has the sensors of its rig where ``kind`` is ``sensors``. ``size`` of
    an observation; ``length`` [m], ``turn`` [rad], ``speed`` [m/s]: scales of the hands' motion."""

    def __init__(self, rollouts: TaskRollouts, kind: Kind, length: float, turn: float, speed: float) -> None:
        self._rollouts, self._kind = rollouts, kind
        self._length, self._turn, self._speed = length, turn, speed
        rig = rollouts.made.rig
        self._nodes = np.concatenate(
            [_seen_nodes(rollouts, name) for name, body in rig.bodies.items() if isinstance(body, Sheet | Affine)]
        )
        self._scales: dict[str, np.ndarray] = {}
        self._noise: dict[str, np.ndarray] = {}
        self._nominal: dict[str, np.ndarray] = {}
        if kind == "sensors":
            for name, sensor in rig.sensors.items():
                if isinstance(sensor, WrenchSensor):
                    self._scales[name] = np.repeat([FORCE_N, TORQUE_NM], 3)
                    self._noise[name] = np.repeat([sensor.noise.force_n, sensor.noise.torque_nm], 3)
                elif isinstance(sensor, MarkerSensor):
                    self._scales[name], self._noise[name] = np.array(MARKER_M), np.array(sensor.noise.position_m)
            for name, camera in rig.cameras.items():
                self._scales[name], self._noise[name] = np.array(TRACK_PX), np.array(camera.noise.position_px)

    def take_nominal(self) -> None:
        """Take the start of the present episode, on the rig as its file has it, for where markers are nominally."""
        reading = self._rollouts.episode.readings[-1]
        self._nominal = {
            name: np.zeros(6) if len(self._scales[name].shape) else reading[name].copy() for name in self._scales
        }

    def noise(self) -> np.ndarray:
        """Standard deviation of the noise in each entry of an observation ``(size,)``, 0 where there is none."""
        poses = np.zeros(6 * len(self._rollouts.fingers))
        if self._kind == "state":
            return np.concatenate([poses, *(np.zeros(part.size) for part in self._known()), [0.0]])
        reading = self._rollouts.episode.readings[-1]
        each = [np.broadcast_to(self._noise[n] / s, reading[n].shape).ravel() for n, s in self._scales.items()]
        return np.concatenate([poses, *each, [0.0]])

    def begin(self) -> None:
        """Take the present state of the episode for its start."""
        self._start = self._rollouts.episode.simulation.state.x[self._nodes].copy()
        self._begun = self._frames()

    def observation(self, done: float, rng: np.random.Generator) -> np.ndarray:
        """Of the present state ``(size,)``. ``done``: share of the decisions that are made; ``rng`` draws noise."""
        parts = []
        for finger, (position, turn) in self._frames().items():
            origin, before = self._begun[finger]
            parts += [(position - origin) / self._length, (turn * before.inv()).as_rotvec() / self._turn]
        parts += self._sensed(rng) if self._kind == "sensors" else self._known()
        return np.concatenate([*parts, [done]])

    def _known(self) -> list[np.ndarray]:
        episode, most = self._rollouts.episode, self._rollouts.made.stop.most_force_n
        state, reading = episode.simulation.state, episode.readings[-1]
        forces = [reading[f"{FORCE}{finger}"][:3] / most for finger in self._rollouts.fingers]
        moved = (state.x[self._nodes] - self._start).ravel() / self._length
        return [moved, state.v[self._nodes].ravel() / self._speed, *forces]

    def _sensed(self, rng: np.random.Generator) -> list[np.ndarray]:
        reading, parts = self._rollouts.episode.readings[-1], []
        for name, scale in self._scales.items():
            noise = self._noise[name] * rng.standard_normal(reading[name].shape)
            parts.append(np.nan_to_num((reading[name] + noise - self._nominal[name]) / scale).ravel())
        return parts

    def _frames(self) -> dict[str, Frame]:
        frames: dict[str, tuple[np.ndarray, Rotation]] = self._rollouts.episode.simulation.frames
        return {finger: frames[finger] for finger in self._rollouts.fingers}


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
