"""A trajectory as a whole against limits and against a rig, before anything moves.

Speeds and accelerations are those of the curve that is replayed, not of the samples alone: it is evaluated at intervals
of at most ``FINE_S``. The end effector is at rest before the first sample and after the last one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig
from sim_core.rigs.digest import rig_sha256
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.trajectories.model import Limits, Trajectory

FINE_S = 0.002
"""Longest interval [s] at which the curve between samples is evaluated."""

MAX_POINTS = 4_000_000
"""Most points of a curve that are evaluated; the interval is longer for what takes longer."""

PREDICTION_SDS = 2.0
"""Standard deviations that are added to a predicted force before it is compared with its limit."""

START_M, START_RAD = 1e-4, 1e-3
"""Distance [m] and turn [rad] of the first pose from the rig's start pose that are worth a word."""


@dataclass(frozen=True)
class Figure:
    """The largest value of one quantity: ``value`` in ``unit`` at ``time_s`` [s], and its limit if there is one."""

    what: str
    value: float
    unit: str
    time_s: float
    limit: float | None = None

    @property
    def exceeded(self) -> bool:
        """Whether the value is above its limit; round-off of the file is not."""
        return self.limit is not None and not self.value <= self.limit * (1.0 + 1e-9)

    def __str__(self) -> str:
        limit = "no limit" if self.limit is None else f"at most {self.limit:.6g} {self.unit}"
        return f"{self.what} is {self.value:.6g} {self.unit} at {self.time_s:.3f} s ({limit})"


@dataclass(frozen=True)
class Review:
    """What the check found. ``errors``: reasons not to replay it; ``warnings``: what a person should know."""

    figures: tuple[Figure, ...]
    errors: tuple[str, ...]
    warnings: tuple[str, ...]


def check_trajectory(
    trajectory: Trajectory, limits: Limits | None = None, rig: Rig | None = None, speed_scale: float = 1.0
) -> Review:
    """Check every sample and the curve between them.

    ``limits``: in addition to those of the file, the stricter one counts; ``rig``: what it is to be replayed on;
    ``speed_scale``: speeds are multiplied by it, accelerations by its square.
    """
    bound = trajectory.limits if limits is None else trajectory.limits.stricter(limits)
    figures: list[Figure] = []
    errors: list[str] = []
    for name, path in trajectory.poses().items():
        errors += _outside(name, path, bound)
        figures += _motion(name, path, bound, speed_scale)
    figures += _forces(trajectory, bound)
    for figure in figures:
        if figure.exceeded:
            errors.append(
                f"{figure}. {_REMEDY.get(figure.unit, 'Plan it again within the limit, or raise the limit.')}"
            )
    warnings = [] if trajectory.predicted.wrenches else _unpredicted(bound)
    if rig is not None:
        wrong, odd = _against_rig(trajectory, rig)
        errors, warnings = [*wrong, *errors], [*odd, *warnings]
    return Review(tuple(figures), tuple(errors), tuple(warnings))


_REMEDY = {
    "m/s": "Replay it with a smaller speed scale, or plan it slower.",
    "rad/s": "Replay it with a smaller speed scale, or plan it slower.",
    "m/s^2": "Replay it with a smaller speed scale, or plan it without sudden changes of velocity.",
}


def _outside(name: str, path: PoseTrajectory, bound: Limits) -> Iterator[str]:
    """The farthest point outside the workspace box, for each side."""
    times = _fine_times(path)
    positions = path.sample(times)[0]
    for corner, sign, words in ((bound.workspace_min_m, -1.0, "below"), (bound.workspace_max_m, 1.0, "above")):
        if corner is None:
            continue
        beyond = sign * (positions - np.array(corner))
        row, axis = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        if beyond[row, axis] > 1e-9:
            yield (
                f"{name} leaves the workspace: {'xyz'[axis]} is {positions[row, axis]:.6g} m at {times[row]:.3f} s, "
                f"{words} {corner[axis]:.6g} m. Plan it within the box, or enlarge the box."
            )


def _fine_times(path: PoseTrajectory) -> np.ndarray:
    """Times [s] of all samples and of enough points between them."""
    fine = max(FINE_S, path.duration / MAX_POINTS)
    parts = np.maximum(np.ceil(np.diff(path.times) / fine - 1e-9), 1.0).astype(int)
    first = np.repeat(np.cumsum(parts) - parts, parts)
    share = (np.arange(parts.sum()) - first) / np.repeat(parts, parts)
    times = np.repeat(path.times[:-1], parts) + share * np.repeat(np.diff(path.times), parts)
    return np.append(times, path.times[-1])


def _motion(name: str, path: PoseTrajectory, bound: Limits, scale: float) -> Iterator[Figure]:
    times = _fine_times(path)
    steps = np.diff(times)
    positions, quaternions = path.sample(times)
    velocities = np.diff(positions, axis=0) / steps[:, None]
    rotations = Rotation.from_quat(quaternions)
    turns = (rotations[:-1].inv() * rotations[1:]).magnitude() / steps
    speeds = np.linalg.norm(velocities, axis=1)
    # From rest to the mean velocity of an interval within half of it, and so on to the next.
    still = np.zeros((1, 3))
    changes = np.diff(np.concatenate([still, velocities, still]), axis=0)
    spans = 0.5 * (np.append(0.0, steps) + np.append(steps, 0.0))
    accelerations = np.linalg.norm(changes, axis=1) / spans
    middles = 0.5 * (times[:-1] + times[1:])
    for what, values, at, unit, limit, power in (
        ("speed", speeds, middles, "m/s", bound.max_speed_m_s, 1),
        ("angular speed", turns, middles, "rad/s", bound.max_angular_speed_rad_s, 1),
        ("acceleration", accelerations, times, "m/s^2", bound.max_acceleration_m_s2, 2),
    ):
        row = int(np.argmax(values))
        yield Figure(f"The {what} of {name}", float(values[row]) * scale**power, unit, float(at[row]), limit)


def _forces(trajectory: Trajectory, bound: Limits) -> Iterator[Figure]:
    for name, wrench in trajectory.predicted.wrenches.items():
        for what, values, sds, unit, limit in (
            ("force", wrench.forces_n, wrench.force_sds_n, "N", bound.max_force_n),
            ("torque", wrench.torques_nm, wrench.torque_sds_nm, "N m", bound.max_torque_nm),
        ):
            sizes = np.linalg.norm(values, axis=1)
            words = f"The predicted {what} on {name}"
            if sds is not None:
                sizes = sizes + PREDICTION_SDS * np.linalg.norm(sds, axis=1)
                words += f" with {PREDICTION_SDS:g} standard deviations"
            row = int(np.argmax(sizes))
            yield Figure(words, float(sizes[row]), unit, float(trajectory.times_s[row]), limit)


def _unpredicted(bound: Limits) -> list[str]:
    if bound.max_force_n is None and bound.max_torque_nm is None:
        return []
    return ["Force and torque are limited, and the trajectory predicts none: only measured ones can stop it."]


def _against_rig(trajectory: Trajectory, rig: Rig) -> tuple[list[str], list[str]]:
    """What does not fit a rig, and what is odd about it."""
    errors, warnings = [], []
    if trajectory.rig is None:
        warnings.append("The trajectory does not say which rig it was made for.")
    elif trajectory.rig.name != rig.name:
        errors.append(
            f"The trajectory was made for the rig {trajectory.rig.name!r}, not for {rig.name!r}. "
            "Name that rig, or make the trajectory again."
        )
    elif trajectory.rig.sha256 != rig_sha256(rig):
        warnings.append(
            f"The rig {rig.name!r} has changed since the trajectory was made: the predicted wrench and markers are "
            "those of the rig as it was. Make the trajectory again if the change matters to them."
        )
    for name, path in trajectory.end_effectors.items():
        effector = rig.end_effectors.get(name)
        if effector is None:
            known = ", ".join(rig.end_effectors) or "none"
            errors.append(f"The rig {rig.name!r} has no end effector {name!r}. It has {known}.")
            continue
        if effector.base_frame != path.frame_id:
            errors.append(
                f"Poses of {name} are in the frame {path.frame_id!r}, and in the rig its base frame is "
                f"{effector.base_frame!r}. Transform the poses, or correct base_frame."
            )
        shift = float(np.linalg.norm(path.positions_m[0] - effector.start.position()))
        turn = float((effector.start.rotation().inv() * Rotation.from_quat(path.quaternions_xyzw[0])).magnitude())
        if shift > START_M or turn > START_RAD:
            warnings.append(
                f"{name} begins {shift:.4g} m and {turn:.4g} rad from its start pose in the rig. "
                "Bring it to the first pose before the replay."
            )
    return errors, warnings
