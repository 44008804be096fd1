"""A trajectory as a whole against limits and against a rig, before anything moves.

Speeds and accelerations are those of the curve that is replayed, not of the samples alone: it is evaluated at intervals
of at most ``FINE_S``. A jerk is the change of the acceleration within :data:`sim_core.rigs.limits.JERK_S` over that
time. The end effector is at rest before the first sample and after the last one. The ways to the first pose and back
are checked likewise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig
from sim_core.rigs.digest import rig_sha256
from sim_core.rigs.limits import JERK_S, Limits
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.trajectories.expected import spread_factor
from sim_core.trajectories.model import Trajectory
from sim_core.trajectories.passages import waiting_pose

FINE_S = 0.002
"""Longest interval [s] at which the curve between samples is evaluated."""

MAX_POINTS = 4_000_000
"""Most points of a curve that are evaluated; the interval is longer for what takes longer."""

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
    extra = Limits() if limits is None else limits
    figures: list[Figure] = []
    errors: list[str] = []
    for part, poses in _parts(trajectory):
        for name, path in poses.items():
            bound = trajectory.limits_of(name).stricter(extra)
            errors += outside(name + part, path, bound)
            figures += motion_figures(name + part, path, bound, speed_scale)
    force_bound = trajectory.limits.stricter(extra)
    figures += _forces(trajectory, force_bound)
    for figure in figures:
        if figure.exceeded:
            errors.append(
                f"{figure}. {_REMEDY.get(figure.unit, 'Plan it again within the limit, or raise the limit.')}"
            )
    warnings = [] if trajectory.predicted.wrenches else _unpredicted(force_bound)
    if not np.isfinite(spread_factor(trajectory.predicted)):
        warnings.append(
            f"The standard deviations of the prediction are from {trajectory.predicted.draws} draws of "
            f"{trajectory.predicted.open_parameters} parameters, which do not bound readings. "
            "Take more draws than parameters."
        )
    errors += _joints(trajectory)
    if rig is not None:
        wrong, odd = _against_rig(trajectory, rig)
        errors, warnings = [*wrong, *errors], [*odd, *warnings]
    return Review(tuple(figures), tuple(errors), tuple(warnings))


def _parts(trajectory: Trajectory) -> Iterator[tuple[str, dict[str, PoseTrajectory]]]:
    """The motion, and the ways to it and back, with what is added to the names of end effectors."""
    yield "", trajectory.poses()
    for words, passage in ((" on its way to the start", trajectory.approach), (" on its way back", trajectory.retract)):
        if passage is not None:
            yield words, passage.poses()


def _joints(trajectory: Trajectory) -> Iterator[str]:
    """Where the ways to the start and back do not meet the motion."""
    for passage, words, row, end in (
        (trajectory.approach, "The way to the start ends", 0, -1),
        (trajectory.retract, "The way back begins", -1, 0),
    ):
        if passage is None:
            continue
        for name, path in trajectory.end_effectors.items():
            other = passage.end_effectors[name]
            away = float(np.linalg.norm(path.positions_m[row] - other.positions_m[end]))
            turn = Rotation.from_quat(path.quaternions_xyzw[row]).inv() * Rotation.from_quat(
                other.quaternions_xyzw[end]
            )
            if away > START_M or float(turn.magnitude()) > START_RAD:
                yield (
                    f"{words} {away:.4g} m and {float(turn.magnitude()):.4g} rad from the motion of {name}. "
                    "Plan it again, so that the two meet."
                )


_REMEDY = {
    "m/s": "Replay it with a smaller speed scale, or plan it slower.",
    "rad/s": "Replay it with a smaller speed scale, or plan it slower.",
    "m/s^2": "Replay it with a smaller speed scale, or plan it without sudden changes of velocity.",
    "rad/s^2": "Replay it with a smaller speed scale, or plan it without sudden changes of velocity.",
    "m/s^3": "Replay it with a smaller speed scale, or plan it with smoother changes of velocity.",
    "rad/s^3": "Replay it with a smaller speed scale, or plan it with smoother changes of velocity.",
}


def outside(name: str, path: PoseTrajectory, bound: Limits) -> Iterator[str]:
    """The farthest point of a path outside the workspace box, for each side, in words."""
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


def motion_figures(name: str, path: PoseTrajectory, bound: Limits, scale: float) -> Iterator[Figure]:
    """Largest speed, acceleration and jerk of a path that is followed at a share ``scale`` of its speed."""
    times = _fine_times(path)
    steps = np.diff(times)
    positions, quaternions = path.sample(times)
    rotations = Rotation.from_quat(quaternions)
    turns = (rotations[1:] * rotations[:-1].inv()).as_rotvec() / steps[:, None]
    middles = 0.5 * (times[:-1] + times[1:])
    for kind, unit, rates, limits in (
        (
            "",
            "m",
            np.diff(positions, axis=0) / steps[:, None],
            (bound.max_speed_m_s, bound.max_acceleration_m_s2, bound.max_jerk_m_s3),
        ),
        (
            "angular ",
            "rad",
            turns,
            (bound.max_angular_speed_rad_s, bound.max_angular_acceleration_rad_s2, bound.max_angular_jerk_rad_s3),
        ),
    ):
        # From rest to the mean velocity of an interval within half of it, and so on to the next.
        still = np.zeros((1, 3))
        changes = np.diff(np.concatenate([still, rates, still]), axis=0)
        spans = 0.5 * (np.append(0.0, steps) + np.append(steps, 0.0))
        accelerations = changes / spans[:, None]
        at, jerks = _jerks(times, accelerations, JERK_S * scale)
        for what, values, when, power, limit in (
            ("speed", rates, middles, 1, limits[0]),
            ("acceleration", accelerations, times, 2, limits[1]),
            ("jerk", jerks / JERK_S, at, 2, limits[2]),
        ):
            sizes = np.linalg.norm(values, axis=1) * scale**power
            row = int(np.argmax(sizes))
            units = unit + ("/s" if what == "speed" else "/s^2" if what == "acceleration" else "/s^3")
            yield Figure(f"The {kind}{what} of {name}", float(sizes[row]), units, float(when[row]), limit)


def _jerks(times: np.ndarray, accelerations: np.ndarray, span: float) -> tuple[np.ndarray, np.ndarray]:
    """Changes of the acceleration within a span [s] of the trajectory's time, from before its start to after its
    end."""
    starts = np.concatenate([times - span, times])

    def at(when: np.ndarray) -> np.ndarray:
        columns = [np.interp(when, times, column, left=0.0, right=0.0) for column in accelerations.T]
        return np.column_stack(columns)

    return np.clip(starts, times[0], times[-1]), at(starts + span) - at(starts)


def _forces(trajectory: Trajectory, bound: Limits) -> Iterator[Figure]:
    factor = spread_factor(trajectory.predicted)
    for name, wrench in trajectory.predicted.wrenches.items():
        own = bound.stricter(Limits(max_force_n=wrench.max_force_n, max_torque_nm=wrench.max_torque_nm))
        for what, values, sds, unit, limit in (
            ("force", wrench.forces_n, wrench.force_sds_n, "N", own.max_force_n),
            ("torque", wrench.torques_nm, wrench.torque_sds_nm, "N m", own.max_torque_nm),
        ):
            sizes = np.linalg.norm(values, axis=1)
            words = f"The predicted {what} on {name}"
            if sds is not None and np.isfinite(factor):
                sizes = sizes + factor * np.linalg.norm(sds, axis=1)
                words += f" with {factor:.3g} standard deviations"
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
        first = path if trajectory.approach is None else trajectory.approach.end_effectors[name]
        position, facing = waiting_pose(effector)
        shift = float(np.linalg.norm(first.positions_m[0] - position))
        turn = float((Rotation.from_quat(facing).inv() * Rotation.from_quat(first.quaternions_xyzw[0])).magnitude())
        if shift > START_M or turn > START_RAD:
            warnings.append(
                f"{name} begins {shift:.4g} m and {turn:.4g} rad from where it waits in the rig. "
                "Bring it there before the replay."
            )
    return errors, warnings
