"""The next experiment as a motion: that of the recording in which most is left, slowly with holds, then at its speed.

In between it goes back the same way. What depends on rate, on time under load, and on the path alone comes apart in the
passes. The path goes straight between the corners of the recorded one (Ramer, Comput. Graph. Image Process. 1, 1972;
Douglas & Peucker, 1973), so that it goes nowhere where the recording has not been, but for a small share of its extent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig
from sim_core.rigs.fields import Pose
from sim_core.rigs.motion import Experiment, Waypoints
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.diagnosis.residual_analysis import excess
from sysid.diagnosis.result import NamedParameter
from sysid.noise.estimate import undeclared
from sysid.noise.stillness import moving
from sysid.observations.observations import Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

MOTION_FILE = "next_experiment.yaml"
"""Where the motion is written."""


def proposed(rig: Rig, problem: Problem, baseline: Fitted, named: Sequence[NamedParameter]) -> Experiment | None:
    """The motion of the recording that the baseline misses most. ``named``: parameters of the effects of the answer, by
    whose time constants the holds are long."""
    if not problem.runs:
        return None
    missed = [excess(problem, baseline, i) for i in range(len(problem.runs))]
    slow = [DIAGNOSIS.hold_over_time_constant * p.value for p in named if p.unit == "s"]
    hold = min(DIAGNOSIS.most_hold_s, max([DIAGNOSIS.least_hold_s, *slow]))
    return next_motion(rig, problem.runs[int(np.argmax(missed))], float(f"{hold:.2g}"))


def in_words(rig: Rig, experiment: Experiment, named: Sequence[NamedParameter]) -> str:
    """Where the motion is, and the commands that draw it and tell what it would determine: the latter of a rig that
    declares the noise of its sensors alone."""
    files = f"amended_rig.yaml {MOTION_FILE}"
    text = f"As a motion, {MOTION_FILE}: {experiment.description} 'thinshell show {files}' draws it"
    asked = "" if undeclared(rig) else ",".join(p.name for p in named)
    return f"{text}, 'thinshell plan {files} --params {asked}' tells what it would determine." if asked else f"{text}."


def next_motion(rig: Rig, run: Run, hold_s: float) -> Experiment | None:
    """A motion along the path of a recording; None where several end effectors move, or none. ``hold_s`` [s]: how long
    the first pass rests in each corner."""
    busy = {name: poses for name, poses in run.poses.items() if moving(poses)}
    if len(busy) != 1:
        return None
    ((name, poses),) = busy.items()
    start = rig.end_effectors[name].start
    corners = _corners(_path(poses))
    goals = [
        _relative(poses.positions[k], Rotation.from_quat(poses.quaternions[k]), start.position(), start.rotation())
        for k in corners
    ]
    speed, turn = _speeds(poses)

    def along(poses: Sequence[Pose], slower: float, rest_s: float) -> Waypoints:
        return Waypoints(
            type="waypoints",
            poses=tuple(poses),
            hold_s=rest_s,
            speed_m_s=max(DIAGNOSIS.least_speed, speed / slower),
            speed_deg_s=float(np.rad2deg(max(DIAGNOSIS.least_speed, turn / slower))),
        )

    back = [] if goals[-1] == goals[0] else [along(goals[-2::-1], 1.0, 0.0)]
    return Experiment(
        name="next",
        description=f"The path of {run.name}: at half its speed with holds of {hold_s:.3g} s, then at its speed.",
        begin={name: goals[0]},
        motions={name: (along(goals[1:], DIAGNOSIS.slower_factor, hold_s), *back, along(goals[1:], 1.0, 0.0))},
    )


def experiment_to_yaml(experiment: Experiment) -> str:
    """The file of an experiment."""
    return str(yaml.safe_dump(experiment.model_dump(mode="json", exclude_defaults=True), sort_keys=False))


def _path(poses: PoseTrajectory) -> np.ndarray:
    """Shifts [m] and turns, times ``DIAGNOSIS.turn_arm_m``, since the first pose ``(n, 6)``."""
    turns = (Rotation.from_quat(poses.quaternions) * Rotation.from_quat(poses.quaternions[0]).inv()).as_rotvec()
    return np.concatenate([poses.positions - poses.positions[0], DIAGNOSIS.turn_arm_m * turns], axis=1)


def _corners(path: np.ndarray) -> list[int]:
    """Samples of a path ``(n, d)`` between which it is straight."""
    limit = DIAGNOSIS.path_margin_share * float(np.ptp(path, axis=0).max())
    kept, open_spans = {0, len(path) - 1}, [(0, len(path) - 1)]
    while open_spans:
        a, b = open_spans.pop()
        if b - a < 2:
            continue
        along = path[b] - path[a]
        inner = path[a + 1 : b] - path[a]
        length = float(along @ along)
        share = np.clip(inner @ along / length, 0.0, 1.0) if length > 0.0 else np.zeros(len(inner))
        away = np.linalg.norm(inner - share[:, None] * along, axis=1)
        worst = int(np.argmax(away))
        if away[worst] > limit:
            middle = a + 1 + worst
            kept.add(middle)
            open_spans += [(a, middle), (middle, b)]
    return sorted(kept)


def _relative(position: np.ndarray, turn: Rotation, origin: np.ndarray, facing: Rotation) -> Pose:
    """A pose relative to the start of the rig, along the axes of the base frame."""
    x, y, z, w = (float(q) for q in (turn * facing.inv()).as_quat())
    shift_x, shift_y, shift_z = (float(c) for c in position - origin)
    return Pose(position_m=(shift_x, shift_y, shift_z), quaternion_xyzw=(x, y, z, w))


def _speeds(poses: PoseTrajectory) -> tuple[float, float]:
    """Speed [m/s] and turning speed [rad/s] of a recorded motion, each over spans as long as noise of poses needs."""
    stride = max(1, round(0.1 / float(np.median(np.diff(poses.times)))))
    t, path = poses.times[::stride], _path(poses)[::stride]
    if len(t) < 2:
        return 0.0, 0.0
    rate = np.diff(path, axis=0) / np.diff(t)[:, None]
    shift, turn = np.linalg.norm(rate[:, :3], axis=1), np.linalg.norm(rate[:, 3:], axis=1) / DIAGNOSIS.turn_arm_m
    return float(np.quantile(shift, DIAGNOSIS.speed_quantile)), float(np.quantile(turn, DIAGNOSIS.speed_quantile))
