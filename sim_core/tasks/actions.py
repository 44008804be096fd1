"""From actions to poses of end effectors, and back from derivatives by poses to those by actions.

An action is a vector of numbers in [-1, 1], one for each knot and each component of each hand that has a bound. With
the weights B of the knots in the steps, a hand's motion in step t is the translation, turn and closing

    d_t = bound * (B a)_t,      p_t = p_{t-1} + dp_t,    Q_t = exp(dphi_t) Q_{t-1},    s_t = s_{t-1} + ds_t

and its finger e, at o_e of the hand's centre c when the hand begins to act, is at c + p_t + Q_t (o_e + s_t n_e), turned
by Q_t, with n_e = -o_e / |o_e|. Small turns w_t of the hand in the base frame follow

    w_t = J(dphi_t) d(dphi_t) + exp(dphi_t) w_{t-1},      J(phi) the left Jacobian of the exponential map,

which is gone through backwards. The poses are exact at the steps, so these derivatives are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.rigs.motion import Experiment, compile_experiment
from sim_core.rigs.trajectory import PoseTrajectory, minimum_jerk
from sim_core.tasks.executable import ExecutableActions, HandSpan
from sim_core.tasks.load import MadeTask
from sim_core.tasks.schema import Actions

STRAIGHT, OUT_AND_BACK = "straight motions", "motions out and back"
"""Kinds of motions that a search may try before it knows anything (:meth:`ActionSpace.generic`)."""


def knot_weights(actions: Actions) -> np.ndarray:
    """Share of each knot's velocity in each step, ``(steps, knots)``; rows sum to at most 1."""
    steps, knots = actions.steps, actions.knots
    if actions.profile == "constant":
        return np.asarray(np.eye(knots)[np.arange(steps) * knots // steps])
    middle = (np.arange(steps) + 0.5) / steps * (knots + 1)
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(middle[:, None] - np.arange(1, knots + 1)[None])))


def left_jacobian(turn: np.ndarray) -> np.ndarray:
    """J with exp(phi + d) = exp(J d) exp(phi) to first order, ``(3, 3)``: 1 + (1 - cos a)/a^2 K + (a - sin a)/a^3 K^2,
    K the cross-product matrix of ``turn`` [rad] and a its length."""
    angle = float(np.linalg.norm(turn))
    k = np.array([[0.0, -turn[2], turn[1]], [turn[2], 0.0, -turn[0]], [-turn[1], turn[0], 0.0]])
    if angle < 1e-4:
        return np.asarray(np.eye(3) + 0.5 * k + k @ k / 6.0)
    return np.asarray(np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * k + (angle - np.sin(angle)) / angle**3 * k @ k)


def _ends(poses: Mapping[str, PoseTrajectory]) -> dict[str, PoseTrajectory]:
    """The last poses alone."""
    return {
        name: PoseTrajectory.from_samples(np.zeros(1), p.positions[-1:], p.quaternions[-1:], source=name)
        for name, p in poses.items()
    }


@dataclass(frozen=True)
class _Way:
    """What a hand does over the steps: ``moves``: motions ``(steps, 7)``; ``shift``, ``turn``, ``closed``: their sums
    from the start on, ``(steps + 1, ...)``."""

    moves: np.ndarray
    shift: np.ndarray
    turn: Rotation
    closed: np.ndarray


class ActionSpace:
    """Actions of a task. ``size``: of the vector; ``names``: of its entries; ``components``: of each entry, 0 to 2 a
    translation along x, y, z, 3 to 5 a turn about them, 6 closing; ``times`` [s]: of all steps, from the approach to
    the end; ``first``, ``last``: step numbers between which the hands act; ``grip``: poses at the steps of an approach
    that is made before."""

    def __init__(self, made: MadeTask) -> None:
        task, self._actions, rig = made.task, made.actions, made.rig
        self._weights = knot_weights(self._actions)
        self._hands = self._actions.hands
        self._active = {name: np.flatnonzero(hand.bounds()) for name, hand in self._hands.items()}
        words = ("x", "y", "z", "turn_x", "turn_y", "turn_z", "close")
        self.names = [
            f"{name}.{words[k]}[{knot}]"
            for name in self._hands
            for knot in range(self._actions.knots)
            for k in self._active[name]
        ]
        self.size = len(self.names)
        self.components: np.ndarray = np.concatenate(
            [np.tile(self._active[name], self._actions.knots) for name in self._hands]
        )
        experiment = Experiment(
            name="approach",
            command_rate_hz=1.0 / task.step_s,
            duration_s=task.step_s if not any(task.approach.values()) else None,
            motions=task.approach,
        )
        self._approach = compile_experiment(experiment, rig)
        count = len(next(iter(self._approach.values())).times) if any(task.approach.values()) else 1
        self.grip: dict[str, PoseTrajectory] = {}
        if task.begins == "held":
            self.grip, self._approach, count = self._approach, _ends(self._approach), 1
        self.first, self._count = count - 1, count
        self.last = self.first + self._actions.steps
        then = task.afterwards
        self._retreat = {name: np.asarray(then.retreat_m.get(name, (0.0, 0.0, 0.0))) for name in self._approach}
        back = round(then.retreat_s / task.step_s)
        rest = np.ones(round(then.rest_s / task.step_s))
        self._drawn: np.ndarray = np.append(minimum_jerk(np.arange(1, back + 1) / max(back, 1)), rest)
        self.times: np.ndarray = np.arange(self.last + len(self._drawn) + 1) * task.step_s
        self._offsets: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        spans: dict[str, HandSpan] = {}
        for name, hand in self._hands.items():
            at = np.array([self._approach[f].positions[self.first] for f in hand.fingers])
            centre = at.mean(axis=0)
            offsets = at - centre
            lengths = np.linalg.norm(offsets, axis=1, keepdims=True)
            limits = [rig.end_effectors[f].limits for f in hand.fingers]
            spans[name] = HandSpan(hand.bounds(), self._active[name], float(lengths.max()), limits)
            if hand.close_m > 0.0 and lengths.min() == 0.0:
                raise ConfigError(
                    f"Fingers of the hand {name!r} are at its centre, so that it cannot close.",
                    "Let them start apart, or leave close_m out.",
                )
            self._offsets[name] = offsets, -offsets / np.where(lengths > 0.0, lengths, 1.0)
        smooth = self._actions.profile == "linear"
        self._executable = ExecutableActions(self._weights, self.times, self.first, spans) if smooth else None

    def executable(self, action: np.ndarray) -> np.ndarray:
        """The action ``(size,)`` that the hands execute where this one is asked for, within their limits
        (:mod:`sim_core.tasks.executable`)."""
        return np.asarray(action, dtype=float) if self._executable is None else self._executable.scaled(action)

    def pull_executable(self, action: np.ndarray, by_executed: np.ndarray) -> np.ndarray:
        """Derivatives of a loss by an action from those by the one that is executed for it, each ``(size,)``."""
        return by_executed if self._executable is None else self._executable.pull(action, by_executed)

    def bounds(self) -> np.ndarray:
        """Largest motion of one step that each entry stands for [m, rad], ``(size,)``."""
        return np.concatenate(
            [np.tile(hand.bounds()[self._active[name]], self._actions.knots) for name, hand in self._hands.items()]
        )

    def generic(self) -> dict[str, np.ndarray]:
        """Motions that a person would try first, by kind, each ``(m, size)`` with the largest entry 1.

        Each kind has every translation of all hands alike, and of each hand against those before it, both ways:
        :data:`STRAIGHT` at a constant share of the bounds, :data:`OUT_AND_BACK` so in the first half of the steps and
        back to where it began in the second half (none with a single knot).
        """
        straight, back = np.ones(self._actions.knots), self._back_and_forth()
        return {STRAIGHT: self._translations(straight), OUT_AND_BACK: self._translations(back)}

    def _back_and_forth(self) -> np.ndarray:
        """Shares of the knots ``(knots,)`` in a motion that is back at its start at the end; a middle knot rests."""
        half, moved = self._actions.knots // 2, self._weights.sum(axis=0)
        shares = np.zeros(self._actions.knots)
        if half:
            shares[:half], shares[-half:] = 1.0 / moved[:half].sum(), -1.0 / moved[-half:].sum()
            shares /= np.abs(shares).max()
        return shares

    def _translations(self, profile: np.ndarray) -> np.ndarray:
        """Translations of hands with shares of their bounds at the knots ``(knots,)``: ``(m, size)``."""
        hands = list(self._hands)
        motions: list[np.ndarray] = []
        for axis in range(3) if profile.any() else ():
            acting = [name for name in hands if axis in self._active[name]]
            for count in range(1, len(acting) + 1):
                # All alike, then the second against the first, the third against the first two, ...
                shares = [1.0] * len(acting) if count == 1 else [1.0] * (count - 1) + [-1.0]
                motion = self._along(dict(zip(acting, shares, strict=False)), axis, profile)
                motions += [motion, -motion]
        return np.array(motions).reshape(len(motions), self.size)

    def _along(self, shares: Mapping[str, float], axis: int, profile: np.ndarray) -> np.ndarray:
        """The action in which hands move along one axis at shares of their bounds times the profile ``(knots,)``."""
        own = np.concatenate(
            [np.repeat(shares.get(name, 0.0) * profile, len(self._active[name])) for name in self._hands]
        )
        return np.where(self.components == axis, own, 0.0)

    def _ways(self, action: np.ndarray) -> dict[str, _Way]:
        action = np.asarray(action, dtype=float)
        if action.shape != (self.size,) or not np.isfinite(action).all():
            raise ConfigError(
                f"An action of this task has {self.size} finite numbers, not an array of shape {action.shape}.",
                f"In this order: {', '.join(self.names[:7])}, ...",
            )
        at, ways = 0, {}
        for name, hand in self._hands.items():
            active = self._active[name]
            entries = action[at : at + self._actions.knots * len(active)].reshape(self._actions.knots, -1)
            at += entries.size
            moves = np.zeros((self._actions.steps, 7))
            moves[:, active] = (self._weights @ entries) * hand.bounds()[active]
            sums = np.vstack([np.zeros(7), np.cumsum(moves, axis=0)])
            turns = [Rotation.identity()]
            for step in Rotation.from_rotvec(moves[:, 3:6]):
                turns.append(step * turns[-1])
            ways[name] = _Way(moves, sums[:, :3], Rotation.concatenate(turns), sums[:, 6])
        return ways

    def poses(self, action: np.ndarray) -> dict[str, PoseTrajectory]:
        """Poses of all end effectors at :attr:`times` for an action ``(size,)``."""
        ways, out = self._ways(action), {}
        acting = slice(self.first, self.last + 1)
        for finger, approach in self._approach.items():
            positions = np.tile(approach.positions[self.first], (len(self.times), 1))
            turns = np.tile(approach.quaternions[self.first], (len(self.times), 1))
            positions[: self._count] = approach.positions[: self._count]
            turns[: self._count] = approach.quaternions[: self._count]
            for name, hand in self._hands.items():
                if finger not in hand.fingers:
                    continue
                way, at = ways[name], hand.fingers.index(finger)
                offset, inward = (part[at] for part in self._offsets[name])
                arms = way.turn.apply(offset + way.closed[:, None] * inward)
                positions[acting] = positions[self.first] - offset + way.shift + arms
                turns[acting] = (way.turn * Rotation.from_quat(turns[self.first])).as_quat()
            positions[self.last + 1 :] = positions[self.last]
            turns[self.last + 1 :] = turns[self.last]
            positions[self.last + 1 :] += self._drawn[:, None] * self._retreat[finger]
            out[finger] = PoseTrajectory.from_samples(self.times, positions, turns, source=finger)
        return out

    def pull(self, action: np.ndarray, by_poses: Mapping[str, np.ndarray]) -> np.ndarray:
        """Derivatives of a loss by the action ``(size,)`` from those by the poses, as
        :attr:`sim_core.gradients.Gradient.poses` has them: ``(n, 6)`` by end effector."""
        poses, ways = self.poses(action), self._ways(action)
        parts = []
        for name, hand in self._hands.items():
            way, steps = ways[name], self._actions.steps
            shift, turn, closed = np.zeros((steps + 1, 3)), np.zeros((steps + 1, 3)), np.zeros(steps + 1)
            for at, finger in enumerate(hand.fingers):
                force, torque = self._of_steps(poses[finger], by_poses[finger])
                offset, inward = (part[at] for part in self._offsets[name])
                arms = way.turn.apply(offset + way.closed[:, None] * inward)
                shift += force
                turn += torque + np.cross(arms, force)
                closed += (force * way.turn.apply(np.tile(inward, (steps + 1, 1)))).sum(axis=1)
            moved = np.zeros((steps, 7))
            moved[:, :3] = np.cumsum(shift[:0:-1], axis=0)[::-1]
            moved[:, 6] = np.cumsum(closed[:0:-1])[::-1]
            later = np.zeros(3)
            for t in range(steps, 0, -1):
                later = turn[t] + later
                phi = way.moves[t - 1, 3:6]
                moved[t - 1, 3:6] = left_jacobian(phi).T @ later
                later = Rotation.from_rotvec(phi).inv().apply(later)
            active = self._active[name]
            parts.append((self._weights.T @ moved[:, active] * hand.bounds()[active]).ravel())
        return np.concatenate(parts)

    def _of_steps(self, pose: PoseTrajectory, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights of a translation and of a turn about the finger's origin in the base frame, at the start and the end
        of each action; what comes later follows the last one."""
        count = min(len(weights), len(self.times))
        rotations = Rotation.from_quat(pose.quaternions[:count])
        world = np.hstack([rotations.apply(weights[:count, :3]), rotations.apply(weights[:count, 3:])])
        out = np.zeros((self.last - self.first + 1, 6))
        acting = world[self.first : self.last + 1]
        out[: len(acting)] = acting
        out[-1] += world[self.last + 1 :].sum(axis=0)
        return out[:, :3], out[:, 3:]
