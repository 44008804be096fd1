"""Trajectories from what the simulator works with: a rig, poses of its end effectors, and traces of rollouts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from sim_core.errors import ConfigError
from sim_core.rigs import MarkerSensor, Rig, WrenchSensor
from sim_core.rigs.digest import rig_sha256
from sim_core.rigs.limits import HandLimits, Limits
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.rigs.yamlfile import validate
from sim_core.trajectories.expected import (
    force_limits,
    noise_factor,
    path_tolerances,
    spread_factor,
    values_in_a_replay,
)
from sim_core.trajectories.model import Prediction, RigReference, Trajectory
from sim_core.trajectories.passages import approach, retract

if TYPE_CHECKING:
    from sim_core.simulate import Trace


LATENCY_SDS = 3.0
"""A reading may be older than its stamp by the latency that the rig states and so many of its standard deviations."""


def make_trajectory(
    rig: Rig,
    poses: Mapping[str, PoseTrajectory],
    times_s: ArrayLike | None = None,
    *,
    gripper_closing_m: Mapping[str, ArrayLike] | None = None,
    limits: Limits | None = None,
    traces: Sequence[Trace] = (),
    open_parameters: int | None = None,
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
        limits: besides those of the rig's hands.
        traces: rollouts along the poses, of which :func:`predict` makes the prediction; by default there is none.
        open_parameters: how many parameters of the rig were drawn for the traces.
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
    prediction = predict(rig, traces, times, open_parameters) if traces else Prediction()
    planned = {effector: planned_path(times, path) for effector, path in poses.items()}
    hands = {effector: rig.end_effectors[effector].limits for effector in poses}
    came = approach(rig, planned, hands)
    back = retract(planned, times, came)
    effectors = {}
    for effector, path in planned.items():
        effector_of_rig, hand = rig.end_effectors[effector], hands[effector]
        accuracy = hand.accuracy_m, hand.accuracy_rad
        near, turn = path_tolerances(path, list(prediction.wrenches.values()), accuracy)
        ways = [path.positions, *(p["end_effectors"][effector]["positions_m"] for p in (came, back) if p is not None)]
        effectors[effector] = {
            "frame_id": effector_of_rig.base_frame,
            "positions_m": path.positions,
            "quaternions_xyzw": path.quaternions,
            "gripper_closing_m": (gripper_closing_m or {}).get(effector),
            "target_topic": effector_of_rig.topics.target_pose,
            "current_topic": effector_of_rig.topics.current_pose,
            "limits": _of_a_hand(hand, np.vstack(ways), near, limits or Limits()),
            "tolerance_m": near,
            "tolerance_rad": turn,
            "max_lag_s": hand.max_lag_s,
        }
    data: dict[str, Any] = {
        "name": name,
        "description": description,
        "interpolation": "spline",
        "rig": RigReference(name=rig.name, sha256=rig_sha256(rig)),
        "limits": _of_sensors(rig).stricter(limits or Limits()),
        "times_s": times,
        "end_effectors": effectors,
        "approach": came,
        "retract": back,
        "predicted": prediction,
        "provenance": dict(provenance or {}),
    }
    return validate(Trajectory, data, "The trajectory")


def planned_path(times_s: np.ndarray, path: PoseTrajectory) -> PoseTrajectory:
    """A planned motion, sampled at times [s] ``(n,)``: one smooth curve through the samples, as a replay follows it."""
    return PoseTrajectory.from_samples(times_s, *path.sample(times_s), planned=True)


def bounded(trajectory: Trajectory, rig: Rig | None = None) -> Trajectory:
    """The trajectory with the limits of the hands that are to execute it: those of a rig besides its own; without a
    rig, those of a common lab arm for end effectors of which the trajectory says nothing."""
    usual = HandLimits()
    effectors, limits = {}, trajectory.limits
    for name, path in trajectory.end_effectors.items():
        of_rig = None if rig is None or name not in rig.end_effectors else rig.end_effectors[name].limits
        hand = of_rig or (usual if path.limits == Limits() else None)
        if hand is None:
            effectors[name] = path
            continue
        own = hand.limits().model_copy(update={"max_force_n": None, "max_torque_nm": None})
        stricter = {"limits": path.limits.stricter(own), "max_lag_s": path.max_lag_s or hand.max_lag_s}
        effectors[name] = path.model_copy(update=stricter)
        carried = Limits(max_force_n=hand.max_force_n, max_torque_nm=hand.max_torque_nm)
        limits = limits.stricter(carried)
    return trajectory.model_copy(update={"end_effectors": effectors, "limits": limits})


def _of_a_hand(hand: HandLimits, ways: np.ndarray, near: float, given: Limits) -> Limits:
    """The limits of a hand without those of the sensors that it carries. Where neither it nor the ``given`` limits have
    a workspace, that is the box around all of its ways ``(n, 3)``, larger by twice the tolerance on each side."""
    boxed = any(x is not None for own in (hand, given) for x in (own.workspace_min_m, own.workspace_max_m))
    low, high = ways.min(axis=0) - 2.0 * near, ways.max(axis=0) + 2.0 * near
    box = {} if boxed else {"workspace_min_m": tuple(low.tolist()), "workspace_max_m": tuple(high.tolist())}
    return hand.limits().model_copy(update={**box, "max_force_n": None, "max_torque_nm": None})


def _of_sensors(rig: Rig) -> Limits:
    """Limits of force and torque at sensors: the least of the rig's hands, whichever of them carries a sensor."""
    hands = [effector.limits for effector in rig.end_effectors.values()] or [HandLimits()]
    return Limits(
        max_force_n=min(hand.max_force_n for hand in hands), max_torque_nm=min(hand.max_torque_nm for hand in hands)
    )


def _common_times(poses: Mapping[str, PoseTrajectory]) -> np.ndarray:
    first, *others = poses.values()
    if any(not np.array_equal(first.times, other.times) for other in others):
        raise ConfigError("The end effectors have poses at different times.", "Give times_s.")
    return first.times


def predict(rig: Rig, traces: Sequence[Trace], times_s: np.ndarray, open_parameters: int | None = None) -> Prediction:
    """What the sensors of a rig will read at times [s] ``(n,)``: the mean of the rollouts, and with two or more of
    them, such as draws of parameters that are not known, their standard deviation; the noise that the rig states, and
    the limits of force that follow."""
    wrenches, markers = {}, {}
    for name, sensor in rig.sensors.items():
        readings = np.stack([trace.at(name, times_s) for trace in traces])
        mean = readings.mean(axis=0)
        sds = readings.std(axis=0, ddof=1) if len(traces) > 1 else None
        common = {
            "frame_id": sensor.frame_id or name,
            "topic": sensor.topic,
            "rate_hz": sensor.rate_hz,
            "delay_s": max(sensor.latency_s, 0.0) + LATENCY_SDS * sensor.latency_sd_s,
        }
        if isinstance(sensor, WrenchSensor):
            spread = {} if sds is None else {"force_sds_n": sds[:, :3], "torque_sds_nm": sds[:, 3:]}
            noise = {"force_noise_n": sensor.noise.force_n, "torque_noise_nm": sensor.noise.torque_nm}
            wrenches[name] = {**common, "forces_n": mean[:, :3], "torques_nm": mean[:, 3:], **spread, **noise}
        elif isinstance(sensor, MarkerSensor):
            noise = {"position_noise_m": sensor.noise.position_m}
            ids = traces[0].ids[name]
            markers[name] = {**common, "ids": ids, "positions_m": mean, "position_sds_m": sds, **noise}
    draws = {"draws": len(traces), "open_parameters": open_parameters} if len(traces) > 1 else {}
    found = validate(Prediction, {"wrenches": wrenches, "markers": markers, **draws}, "The prediction")
    factors = spread_factor(found), noise_factor(values_in_a_replay(found, float(times_s[-1])))
    limited = {}
    for name, wrench in found.wrenches.items():
        force, torque = force_limits(wrench, factors, _of_sensors(rig))
        limited[name] = wrench.model_copy(update={"max_force_n": force, "max_torque_nm": torque})
    return found.model_copy(update={"wrenches": limited})


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
