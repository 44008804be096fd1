"""The watch of predictions: how often it is wrong, and when it is right. No ROS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom

from sim_core.rigs.yamlfile import validate
from sim_core.trajectories import Trajectory
from sim_core.trajectories.expected import noise_factor, spread_factor
from thinshell_ros.replay.watch import PredictionWatch

TIMES = np.arange(51) / 50.0
RATE_HZ = 50.0
DRAWS = 8


def responses(parameters: int) -> np.ndarray:
    """Derivatives of force and torque by parameters, of all shapes in time: ``(n, 6, p)``, 0 at the start."""
    rng = np.random.default_rng(3)
    waves = [np.sin(np.pi * (k + 1) * TIMES) for k in range(6)]
    shapes = np.einsum("kn,kcp->ncp", np.array(waves), rng.standard_normal((6, 6, parameters)))
    return np.asarray(shapes)


def predicted(draws: np.ndarray, parameters: int, noise: float) -> Trajectory:
    """What rollouts of drawn parameters ``(n, p)`` of a linear model predict."""
    readings = np.einsum("ncp,dp->dnc", responses(parameters), draws)
    mean, sds = readings.mean(axis=0), readings.std(axis=0, ddof=1)
    wrench = {
        "frame_id": "pad",
        "forces_n": mean[:, :3],
        "torques_nm": mean[:, 3:],
        "force_sds_n": sds[:, :3],
        "torque_sds_nm": sds[:, 3:],
        "force_noise_n": noise,
        "torque_noise_nm": noise,
        "rate_hz": RATE_HZ,
    }
    predicted = {"wrenches": {"pad": wrench}, "draws": len(draws), "open_parameters": parameters}
    path = {
        "frame_id": "base_link",
        "positions_m": np.outer(TIMES, [0.0, 0.0, 0.01]),
        "quaternions_xyzw": np.tile([0.0, 0.0, 0.0, 1.0], (len(TIMES), 1)),
    }
    return validate(Trajectory, {"times_s": TIMES, "end_effectors": {"hand": path}, "predicted": predicted}, "made")


def replayed(
    trajectory: Trajectory, readings: np.ndarray, noise: float, rng: np.random.Generator, false_alarm: float
) -> PredictionWatch:
    """A replay in which these true readings ``(n, 6)`` are read with noise."""
    watch = PredictionWatch(trajectory, 0.0, false_alarm=false_alarm)
    for k in range(20):
        watch.take_wrench("pad", -1.0 + k / RATE_HZ, noise * rng.standard_normal(6), None)
    watch.begin()
    for time, values in zip(TIMES, readings, strict=True):
        watch.take_wrench("pad", float(time), values + noise * rng.standard_normal(6), float(time))
    return watch


def alarms(parameters: int, noise: float, count: int, false_alarm: float) -> int:
    """How many of so many replays alarm the watch, when the model is true."""
    rng, found = np.random.default_rng(17), 0
    shapes = responses(parameters)
    for _ in range(count):
        draws = rng.standard_normal((DRAWS, parameters))
        truth = shapes @ rng.standard_normal(parameters)
        watch = replayed(predicted(draws, parameters, noise), truth, noise, rng, false_alarm)
        found += watch.alarm is not None
    return found


@pytest.mark.parametrize("parameters", [1, 3])
def test_what_is_not_known_of_the_rig_alarms_in_the_share_that_is_said(parameters: int) -> None:
    """Half of the false alarms are for that: with one parameter exactly so many (Student's t), with more at most."""
    count, share = 400, 0.1
    found = alarms(parameters, 1e-6, count, share)
    assert found <= binom.ppf(0.999, count, 0.5 * share)
    assert found >= (binom.ppf(0.001, count, 0.5 * share) if parameters == 1 else 1), (
        "a bound that never binds is too wide"
    )


@pytest.mark.parametrize("parameters", [1, 3])
def test_noise_alarms_in_at_most_the_share_that_is_said(parameters: int) -> None:
    count, share = 400, 0.1
    assert alarms(parameters, 0.5, count, share) <= binom.ppf(0.999, count, share)


@pytest.mark.slow
def test_of_two_thousand_replays_as_predicted_about_two_alarm() -> None:
    assert alarms(2, 0.2, 2000, 1e-3) <= binom.ppf(0.999, 2000, 1e-3)


def test_the_bound_of_one_parameter_is_that_of_student_and_that_of_noise_holds_for_all_values_at_once() -> None:
    from scipy.stats import t

    one = predicted(np.random.default_rng(0).standard_normal((DRAWS, 1)), 1, 0.1).predicted
    exact = t.isf(0.25e-3, DRAWS - 1) * np.sqrt(1.0 + 1.0 / DRAWS)
    assert spread_factor(one, 1e-3) == pytest.approx(exact, rel=1e-9)
    assert spread_factor(one.model_copy(update={"open_parameters": DRAWS})) == np.inf
    rng = np.random.default_rng(1)
    largest = np.abs(rng.standard_normal((20000, 100))).max(axis=1)
    assert (largest > noise_factor(100, 0.2)).mean() == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("axis", [2, 4])
def test_what_the_model_does_not_have_alarms_when_it_begins(axis: int) -> None:
    """A contact at 0.6 s that is not predicted: 1.3 times what is allowed for there."""
    rng, noise = np.random.default_rng(5), 0.01
    trajectory = predicted(0.1 * rng.standard_normal((DRAWS, 1)), 1, noise)
    truth = responses(1) @ np.array([0.0])
    wrench = trajectory.predicted.wrenches["pad"]
    assert wrench.force_sds_n is not None and wrench.torque_sds_nm is not None
    sds = np.hstack([wrench.force_sds_n, wrench.torque_sds_nm])[:, axis]
    allowed = spread_factor(trajectory.predicted) * sds.max() + 8.0 * noise
    mean = np.hstack([wrench.forces_n, wrench.torques_nm])[:, axis]
    truth[TIMES >= 0.6, axis] = mean[TIMES >= 0.6] + 1.3 * allowed
    watch = replayed(trajectory, truth, noise, rng, 1e-3)
    assert watch.alarm is not None
    assert watch.alarm.time_s == pytest.approx(0.6, abs=1e-9)
    kind = "z of the force of pad" if axis == 2 else "y of the torque of pad"
    assert watch.alarm.text.startswith(f"At 0.60 s of the trajectory {kind} has changed by ")
    assert "99.9 % of replays" in watch.alarm.text


def test_a_sensor_without_noise_or_with_too_few_draws_is_said_not_to_be_watched() -> None:
    rng = np.random.default_rng(6)
    for trajectory in (
        predicted(rng.standard_normal((DRAWS, 2)), 2, 0.0),
        predicted(rng.standard_normal((2, 3)), 3, 0.1),
    ):
        watch = replayed(trajectory, np.full((len(TIMES), 6), 1e3), 0.0, rng, 1e-3)
        assert watch.alarm is None
        assert "pad is predicted and not watched" in watch.notes()[0]


def test_markers_are_compared_by_their_numbers_and_lost_ones_are_not() -> None:
    trajectory = predicted(np.random.default_rng(0).standard_normal((DRAWS, 1)), 1, 0.1)
    places = np.zeros((len(TIMES), 4, 3))
    places[:, :, 0] = np.arange(4) * 1e-3
    markers: dict[str, Any] = {
        "frame_id": "gel", "ids": [3, 7, 8, 11], "positions_m": places, "position_noise_m": 1e-5, "rate_hz": RATE_HZ,
    }  # fmt: skip
    data = trajectory.model_dump()
    data["predicted"]["markers"]["gel"] = markers
    watch = PredictionWatch(validate(Trajectory, data, "made"), 0.0)
    numbers, order = np.array([3, 7, 8, 11]), np.array([2, 0, 3, 1])
    watch.take_markers("gel", -0.1, numbers, places[0], None)
    watch.begin()
    watch.take_markers("gel", 0.1, numbers[order], places[0][order], 0.1)
    watch.take_markers("gel", 0.2, numbers[:2], places[0][:2], 0.2)
    assert watch.alarm is None
    moved = places[0] + np.array([0.0, 0.0, 2e-4]) * (numbers == 8)[:, None]
    watch.take_markers("gel", 0.3, numbers[order], moved[order], 0.3)
    assert watch.alarm is not None
    assert "z of the marker 8 of gel has changed by 0.0002 m, and 0 m is predicted" in watch.alarm.text


STEP_S = 0.01
"""Step of the simulation that predicts the pad below."""

FORCE_N, SHIFT_M = 4.0, 4e-4
SHARES = np.array([0.4, 0.3, 0.3])
RELAXATION_S = np.array([0.02, 0.1, 0.5])
"""A pad that creeps: shares of its way, and how late each comes."""


def depth(times: np.ndarray) -> np.ndarray:
    """A press of a sheet and its release, over the deepest [1]: it touches at a third, and is held at the bottom."""
    u = np.clip(np.minimum(times / 0.4, (1.0 - times) / 0.4), 0.0, 1.0)
    travel = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    return np.asarray(np.maximum(travel - 1.0 / 3.0, 0.0) / (2.0 / 3.0))


def deeper(times: np.ndarray) -> np.ndarray:
    """A press that goes on until the end."""
    return np.asarray(0.5 * (times + times**2))


def creeping(times: np.ndarray, exact: bool, motion: Callable[[np.ndarray], np.ndarray] = depth) -> np.ndarray:
    """How far the parts of the pad have come at even ``times`` [s]: x' = (u - x) / tau under the depth u, by steps of
    implicit Euler as a simulation makes them, or exactly for depths that are linear in a step: ``(n, 3)``."""
    step, u = times[1] - times[0], motion(times)
    x = np.zeros((len(times), len(SHARES)))
    decay, ratio = np.exp(-step / RELAXATION_S), step / RELAXATION_S
    for k in range(1, len(times)):
        if exact:
            late = (1.0 - decay) / ratio
            x[k] = decay * x[k - 1] + (late - decay) * u[k - 1] + (1.0 - late) * u[k]
        else:
            x[k] = (x[k - 1] + ratio * u[k]) / (1.0 + ratio)
    return x


def pad_replays(
    count: int,
    false_alarm: float,
    lags_s: tuple[float, float],
    scale: float = 1.0,
    follows_s: float = 0.0,
    motion: Callable[[np.ndarray], np.ndarray] = depth,
) -> int:
    """How many replays alarm of robots that press a pad which is the simulated one, of a stiffness that is known to
    0.1 %; the force and a marker that moves along with it are read. 0.1 s of lag are allowed.

    ``lags_s``: least and largest lag of the robots; ``follows_s``: time constant with which they approach their
    commands; ``scale``: of what they do.
    """
    sd, allowed_s = 0.001, 0.1 if lags_s[1] > 0.0 or motion is deeper else 0.0
    rng, found = np.random.default_rng(11), 0
    steps = np.arange(101) * STEP_S
    fine = np.arange(20001) * (steps[-1] / 20000)
    simulated, true = creeping(steps, False, motion) @ SHARES, scale * creeping(fine, True, motion) @ SHARES
    if follows_s:
        kept = np.exp(-fine[1] / follows_s)
        true = lfilter([1.0 - kept], [1.0, -kept], true)
    noise_n, noise_m, rate_hz = 0.01, 1e-6, 60.0
    for _ in range(count):
        factors = np.exp(sd * rng.standard_normal(DRAWS + 1))
        forces = FORCE_N * np.multiply.outer(factors[:-1], simulated)[..., None] * [0.0, 0.0, -1.0]
        places = SHIFT_M * np.multiply.outer(factors[:-1], simulated)[..., None, None] * [0.0, 0.0, 1.0]
        wrench = {
            "frame_id": "pad", "forces_n": forces.mean(axis=0), "torques_nm": np.zeros((101, 3)),
            "force_sds_n": forces.std(axis=0, ddof=1), "force_noise_n": noise_n, "rate_hz": rate_hz,
        }  # fmt: skip
        markers = {
            "frame_id": "pad", "ids": [0], "positions_m": places.mean(axis=0), "rate_hz": rate_hz,
            "position_sds_m": places.std(axis=0, ddof=1), "position_noise_m": noise_m,
        }  # fmt: skip
        predicted = {"wrenches": {"pad": wrench}, "markers": {"gel": markers}, "draws": DRAWS, "open_parameters": 1}
        path = {
            "frame_id": "base_link",
            "positions_m": np.outer(motion(steps), [0.0, 0.0, -0.01]),
            "quaternions_xyzw": np.tile([0.0, 0.0, 0.0, 1.0], (101, 1)),
        }
        data = {"times_s": steps, "end_effectors": {"hand": path}, "predicted": predicted}
        watch = PredictionWatch(validate(Trajectory, data, "made"), allowed_s, 1.0, false_alarm, STEP_S)
        lag, phase = rng.uniform(*lags_s), rng.uniform(0.0, 1.0 / rate_hz)
        for number in range(-20, 60):
            at = phase + number / rate_hz
            if number == 0:
                watch.begin()
            size = factors[-1] * np.interp(at - lag, fine, true)
            force = np.array([0.0, 0.0, -FORCE_N * size, 0.0, 0.0, 0.0])
            force[:3] += noise_n * rng.standard_normal(3)
            place = np.array([[0.0, 0.0, SHIFT_M * size]]) + noise_m * rng.standard_normal((1, 3))
            when = at if number >= 0 else None
            watch.take_wrench("pad", at, force, when)
            watch.take_markers("gel", at, np.array([0]), place, when)
        found += watch.alarm is not None
    return found


def test_a_robot_that_presses_a_pad_with_relaxation_alarms_in_at_most_the_share_that_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without the error of the steps of time, exact robots alarm far more often."""
    count, share = 200, 0.1
    most = binom.ppf(0.999, count, share)
    assert pad_replays(count, share, (0.0, 0.0)) <= most
    assert pad_replays(count, share, (0.0, 0.1)) <= most
    assert pad_replays(count, share, (0.0, 0.05), follows_s=0.01) <= most
    monkeypatch.setattr(
        "thinshell_ros.replay.innovations._off_in_steps", lambda rates, tick_s, step_s: np.zeros((0, *rates.shape))
    )
    assert pad_replays(2 * count, share, (0.0, 0.0)) > binom.ppf(0.999, 2 * count, share)


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [0.0, 0.1])
def test_of_two_thousand_presses_of_a_pad_about_two_alarm(lag_s: float) -> None:
    assert pad_replays(2000, 1e-3, (0.0, lag_s)) <= binom.ppf(0.999, 2000, 1e-3)


@pytest.mark.parametrize(
    ("lags_s", "scale", "motion"),
    [
        ((0.0, 0.1), 0.88, depth),
        ((0.0, 0.1), 1.12, depth),
        ((0.0, 0.0), 0.9, deeper),
        ((0.0, 0.1), 0.0, depth),
        ((0.2, 0.2), 1.0, depth),
        ((0.5, 0.5), 1.0, depth),
    ],
)
def test_a_scale_is_no_lag_and_a_lag_beyond_what_is_allowed_alarms(
    lags_s: tuple[float, float], scale: float, motion: Callable[[np.ndarray], np.ndarray]
) -> None:
    """One lag explains all readings of a replay, and not another one each: 10 % of a press that goes on are at most
    what 0.1 s of lag may make at each time."""
    count = 20
    assert pad_replays(count, 1e-3, lags_s, scale, motion=motion) == count
