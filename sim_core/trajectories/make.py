"""Trajectories from what the simulator works with: a rig, poses of its end effectors, and traces of rollouts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from sim_core.errors import ConfigError
from sim_core.rigs import MarkerSensor, Rig, WrenchSensor
from sim_core.rigs.digest import rig_sha256
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.rigs.yamlfile import validate
from sim_core.trajectories.model import Limits, Prediction, RigReference, Trajectory

if TYPE_CHECKING:
    from sim_core.simulate import Trace


def make_trajectory(
    rig: Rig,
    poses: Mapping[str, PoseTrajectory],
    times_s: ArrayLike | None = None,
    *,
    gripper_closing_m: Mapping[str, ArrayLike] | None = None,
    limits: Limits | None = None,
    traces: Sequence[Trace] = (),
    name: str = "",
    description: str = "",
    provenance: Mapping[str, str] | None = None,
) -> Trajectory:
    """A trajectory of a rig's end effectors.

    Args:
        rig: what it is for; frames and topics are taken from it.
        poses: of one or more of its end effectors, sampled at ``times_s``.
        times_s: time [s] of each sample, from 0, ``(n,)``; by default those of the poses, which must then agree.
        gripper_closing_m: closing [m] of grippers by end effector, each ``(n,)``.
        limits: none by default.
        traces: rollouts along the poses, of which :func:`predict` makes the prediction; by default there is none.
        name: of the trajectory, for people.
        description: one sentence.
        provenance: where it is from, by key.

    Raises:
        ConfigError: an end effector is not one of the rig, or something does not fit.
    """
    if unknown := [name for name in (*poses, *(gripper_closing_m or {})) if name not in rig.end_effectors]:
        known = ", ".join(rig.end_effectors) or "none"
        raise ConfigError(f"The rig {rig.name!r} has no end effector {unknown[0]!r}.", f"It has {known}.")
    if not poses:
        raise ConfigError("A trajectory needs poses of an end effector.", f"The rig {rig.name!r} is moved by them.")
    times = _common_times(poses) if times_s is None else np.asarray(times_s, dtype=np.float64)
    effectors = {}
    for effector, path in poses.items():
        positions, quaternions = path.sample(times)
        told = rig.end_effectors[effector]
        effectors[effector] = {
            "frame_id": told.base_frame,
            "positions_m": positions,
            "quaternions_xyzw": quaternions,
            "gripper_closing_m": (gripper_closing_m or {}).get(effector),
            "target_topic": told.topics.target_pose,
            "current_topic": told.topics.current_pose,
        }
    data: dict[str, Any] = {
        "name": name,
        "description": description,
        "rig": RigReference(name=rig.name, sha256=rig_sha256(rig)),
        "limits": limits or Limits(),
        "times_s": times,
        "end_effectors": effectors,
        "predicted": predict(rig, traces, times) if traces else Prediction(),
        "provenance": dict(provenance or {}),
    }
    return validate(Trajectory, data, "The trajectory")


def _common_times(poses: Mapping[str, PoseTrajectory]) -> np.ndarray:
    first, *others = poses.values()
    if any(not np.array_equal(first.times, other.times) for other in others):
        raise ConfigError("The end effectors have poses at different times.", "Give times_s.")
    return first.times


def predict(rig: Rig, traces: Sequence[Trace], times_s: np.ndarray) -> Prediction:
    """What the sensors of a rig will read at times [s] ``(n,)``: the mean of the rollouts, and with two or more of
    them, such as draws of parameters that are not known, their standard deviation."""
    wrenches, markers = {}, {}
    for name, sensor in rig.sensors.items():
        readings = np.stack([trace.at(name, times_s) for trace in traces])
        mean = readings.mean(axis=0)
        sds = readings.std(axis=0, ddof=1) if len(traces) > 1 else None
        common = {"frame_id": sensor.frame_id or name, "topic": sensor.topic}
        if isinstance(sensor, WrenchSensor):
            spread = {} if sds is None else {"force_sds_n": sds[:, :3], "torque_sds_nm": sds[:, 3:]}
            wrenches[name] = {**common, "forces_n": mean[:, :3], "torques_nm": mean[:, 3:], **spread}
        elif isinstance(sensor, MarkerSensor):
            ids = traces[0].ids[name]
            markers[name] = {**common, "ids": ids, "positions_m": mean, "position_sds_m": sds}
    return validate(Prediction, {"wrenches": wrenches, "markers": markers}, "The prediction")


def rollout(
    rig: Rig,
    poses: Mapping[str, PoseTrajectory],
    on_step: Callable[[int, int], None] | None = None,
) -> Trace:
    """Drive a rig along poses with its own time step, for :func:`predict`.

    Raises:
        ConvergenceError: a step does not converge.
    """
    # Imported only now: who reads and checks trajectories needs no simulator, which takes seconds to import.
    from sim_core.scene import build_scene
    from sim_core.simulate import simulate, step_times

    end = max(float(path.times[-1]) for path in poses.values())
    return simulate(build_scene(rig), poses, step_times(0.0, end, rig.solver.dt_s), on_step)
