"""The check of a trajectory as a whole, against closed forms of its motion."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from sim_core.rigs import HandLimits, Rig
from sim_core.rigs.trajectory import MINIMUM_JERK_PEAK, minimum_jerk
from sim_core.rigs.yamlfile import validate
from sim_core.trajectories import (
    Figure,
    Limits,
    Trajectory,
    bounded,
    check_trajectory,
    make_trajectory,
    write_trajectory,
)
from sysid.cli import app

WAY_M = 0.06
TURN_RAD = 0.5
TIME_S = 1.5


def motion(rate_hz: float = 100.0, **parts: Any) -> Trajectory:
    """A minimum-jerk move along y with a turn about x."""
    times = np.arange(round(TIME_S * rate_hz) + 1) / rate_hz
    share = minimum_jerk(times / TIME_S)
    path = {
        "frame_id": "base_link",
        "positions_m": np.outer(share, [0.0, WAY_M, 0.0]),
        "quaternions_xyzw": Rotation.from_rotvec(np.outer(share, [TURN_RAD, 0.0, 0.0])).as_quat(),
    }
    return validate(Trajectory, {"times_s": times, "end_effectors": {"hand": path}, **parts}, "made")


def figure(trajectory: Trajectory, what: str, **given: Any) -> Figure:
    return next(f for f in check_trajectory(trajectory, **given).figures if f.what.startswith(f"The {what} "))


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 400.0])
def test_speeds_and_accelerations_are_those_of_the_motion(rate_hz: float) -> None:
    """Peaks of a minimum-jerk move: 15/8 d/T at its middle, 10/sqrt(3) d/T^2 (Flash & Hogan 1985)."""
    trajectory = motion(rate_hz)
    speed, turn = figure(trajectory, "speed"), figure(trajectory, "angular speed")
    acceleration = figure(trajectory, "acceleration")
    assert speed.value == pytest.approx(MINIMUM_JERK_PEAK * WAY_M / TIME_S, rel=1e-3)
    assert speed.time_s == pytest.approx(TIME_S / 2.0, abs=0.05)
    assert turn.value == pytest.approx(MINIMUM_JERK_PEAK * TURN_RAD / TIME_S, rel=1e-3)
    assert acceleration.value == pytest.approx(10.0 / np.sqrt(3.0) * WAY_M / TIME_S**2, rel=2e-2)


def test_the_jerk_is_that_of_the_motion() -> None:
    """Of a minimum-jerk move it is largest at its ends, 60 d/T^3, where it falls to 0 from there within some T / 5:
    taken over 10 ms it is less by 3 shares of 10 ms in T (Flash & Hogan 1985), and since accelerations are means over
    2 ms, by up to a fifth of 2 ms in 10 ms. With a turn likewise."""
    for what, size in (("jerk", WAY_M), ("angular jerk", TURN_RAD)):
        exact = 60.0 * size / TIME_S**3
        assert figure(motion(), what).value == pytest.approx(exact * (1.0 - 3.0 * 0.01 / TIME_S), rel=4e-2)
    scaled = figure(motion(), "jerk", speed_scale=0.5).value
    assert scaled == pytest.approx(0.125 * 60.0 * WAY_M / TIME_S**3 * (1.0 - 1.5 * 0.01 / TIME_S), rel=8e-2)


@pytest.mark.parametrize("backwards", [False, True])
def test_a_sudden_acceleration_from_rest_or_to_rest_is_a_jerk(backwards: bool) -> None:
    """The way 6 u^2 - 8 u^3 + 3 u^4, u = t / T, begins with the acceleration 12 d/T^2 at once, and ends smoothly."""
    u = np.linspace(0.0, 1.0, round(TIME_S * 100.0) + 1)
    share = 6.0 * u**2 - 8.0 * u**3 + 3.0 * u**4
    data = motion().model_dump()
    data["end_effectors"]["hand"]["positions_m"] = np.outer(share[::-1] if backwards else share, [0.0, WAY_M, 0.0])
    jerk = figure(validate(Trajectory, data, "made"), "jerk")
    assert jerk.value == pytest.approx(12.0 * WAY_M / TIME_S**2 / 0.01, rel=5e-2)
    assert jerk.time_s == pytest.approx(TIME_S if backwards else 0.0, abs=0.02)


def test_a_hand_of_its_own_is_limited_by_its_own_and_by_the_rig() -> None:
    """The stricter of the limits of the trajectory, of the end effector in it, and of the rig's hand."""
    edited = motion().model_dump()
    edited["end_effectors"]["hand"]["limits"] = {"max_speed_m_s": 0.07}
    (error,) = check_trajectory(validate(Trajectory, edited, "made")).errors
    assert "The speed of hand is 0.07499" in error and "at most 0.07 m/s" in error
    free = bounded(motion())
    assert free.limits_of("hand") == HandLimits().limits(), "of which nothing is said: those of a common lab arm"
    own = bounded(validate(Trajectory, edited, "made"))
    assert own.limits_of("hand").max_speed_m_s == 0.07
    assert own.limits_of("hand").max_acceleration_m_s2 is None, "what is said is all that is meant"


def test_a_smaller_speed_scale_slows_down_and_softens() -> None:
    trajectory = motion()
    for what, power in (("speed", 1), ("angular speed", 1), ("acceleration", 2)):
        whole, part = figure(trajectory, what), figure(trajectory, what, speed_scale=0.4)
        assert part.value == pytest.approx(0.4**power * whole.value, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "peak", "said"),
    [
        ("max_speed_m_s", MINIMUM_JERK_PEAK * WAY_M / TIME_S, "The speed of hand"),
        ("max_angular_speed_rad_s", MINIMUM_JERK_PEAK * TURN_RAD / TIME_S, "The angular speed of hand"),
        ("max_acceleration_m_s2", 10.0 / np.sqrt(3.0) * WAY_M / TIME_S**2, "The acceleration of hand"),
    ],
)
def test_a_limit_is_exceeded_or_not(name: str, peak: float, said: str) -> None:
    assert not check_trajectory(motion(), Limits(**{name: 1.03 * peak})).errors
    (error,) = check_trajectory(motion(), Limits(**{name: 0.97 * peak})).errors
    assert error.startswith(said)
    assert f"{0.97 * peak:.6g}" in error
    (same,) = check_trajectory(motion(limits={name: 0.97 * peak})).errors
    assert same == error, "whether the file or the one who checks it limits it"


def test_a_start_at_full_speed_is_a_sudden_change() -> None:
    """From rest to v between two points h apart takes 2 v / h."""
    times = np.arange(101) / 100.0
    path = {
        "frame_id": "base_link",
        "positions_m": np.outer(times, [0.1, 0.0, 0.0]),
        "quaternions_xyzw": np.tile([0.0, 0.0, 0.0, 1.0], (101, 1)),
    }
    trajectory = validate(Trajectory, {"times_s": times, "end_effectors": {"hand": path}}, "made")
    assert figure(trajectory, "speed").value == pytest.approx(0.1, rel=1e-9)
    assert figure(trajectory, "acceleration").value == pytest.approx(2.0 * 0.1 / 0.002, rel=1e-6)


def test_the_workspace_box_is_that_of_the_curve() -> None:
    inside = Limits(workspace_min_m=(-0.01, -0.01, -0.01), workspace_max_m=(0.01, WAY_M, 0.01))
    assert not check_trajectory(motion(), inside).errors
    (error,) = check_trajectory(motion(), Limits(workspace_max_m=(0.01, 0.05, 0.01))).errors
    assert "y is 0.06 m at" in error
    assert "above 0.05 m" in error
    (error,) = check_trajectory(motion(), Limits(workspace_min_m=(-0.01, 0.01, -0.01))).errors
    assert "y is 0 m at 0.000 s, below 0.01 m" in error


def test_predicted_forces_count_with_their_uncertainty() -> None:
    count = len(motion().times_s)
    forces = np.zeros((count, 3))
    forces[40] = [0.0, 3.0, 4.0]
    wrench = {"frame_id": "pad", "forces_n": forces, "torques_nm": np.zeros((count, 3))}
    sure = motion(predicted={"wrenches": {"pad": wrench}})
    unsure = motion(predicted={"wrenches": {"pad": {**wrench, "force_sds_n": np.full((count, 3), 0.5 / np.sqrt(3))}}})
    assert not check_trajectory(sure, Limits(max_force_n=5.0)).errors
    (error,) = check_trajectory(sure, Limits(max_force_n=4.9)).errors
    assert "The predicted force on pad is 5 N at 0.400 s" in error
    # Of one parameter and a normal distribution: half of one in a thousand replays is beyond, on either side.
    most = 5.0 + 0.5 * float(norm.isf(0.5e-3 / 2.0))
    assert not check_trajectory(unsure, Limits(max_force_n=1.002 * most)).errors
    assert check_trajectory(unsure, Limits(max_force_n=0.998 * most)).errors
    assert check_trajectory(motion(), Limits(max_force_n=1.0)).warnings == (
        "Force and torque are limited, and the trajectory predicts none: only measured ones can stop it.",
    )


@pytest.fixture
def of_small_rig(small_rig: Callable[..., Rig], visit: Callable[..., Any]) -> Trajectory:
    times = np.linspace(0.0, 1.0, 101)
    return make_trajectory(small_rig(), visit(times.tolist(), np.outer(minimum_jerk(times), [0, 0, 0.01]).tolist()))


def test_a_trajectory_fits_the_rig_that_it_was_made_for(
    of_small_rig: Trajectory, small_rig: Callable[..., Rig]
) -> None:
    fits = check_trajectory(of_small_rig, rig=small_rig())
    assert not fits.errors
    unpredicted = "Force and torque are limited, and the trajectory predicts none: only measured ones can stop it."
    assert fits.warnings == (unpredicted,)
    changed = check_trajectory(of_small_rig, rig=small_rig(gravity_m_s2=[0.0, 0.0, 0.0]))
    assert "has changed since" in changed.warnings[0]
    assert not changed.errors
    other = check_trajectory(of_small_rig, rig=small_rig(name="other"))
    assert "made for the rig 'small', not for 'other'" in other.errors[0]
    moved = small_rig(end_effectors={"finger": {"base_frame": "world_2", "start": {"position_m": [0.03, 0.004, 0.06]}}})
    found = check_trajectory(of_small_rig, rig=moved)
    assert "'base_link', and in the rig its base frame is 'world_2'" in found.errors[0]
    assert "begins 0.007433 m and 0 rad from where it waits in the rig" in found.warnings[1]


def test_the_command_checks_a_file(
    tmp_path: Path, of_small_rig: Trajectory, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "t.json"
    write_trajectory(path, of_small_rig)
    assert app.main(["trajectory", "check", str(path)]) == 0
    assert "Nothing speaks against its replay" in capsys.readouterr().out
    assert app.main(["trajectory", "check", str(path), "--rig", "card_press", "--limit", "max_speed_m_s=0.01"]) == 2
    out = capsys.readouterr().out
    assert out.count("error: ") == 3, "another rig, the speed, and that on the way back"
    assert "on its way back is 0.01" in out
    assert app.main(["trajectory", "check", str(path), "--limit", "max_force=1"]) == 2
    assert "Write max_force_n" in capsys.readouterr().err


def test_the_command_makes_a_file_without_a_word_before_rig_and_experiment(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "t.json"
    words = ["card_press", "press_hold_release", "--out", str(path), "--no-prediction", "--limit", "max_force_n=5"]
    assert app.main(["trajectory", *words]) == 0
    assert "406 samples of finger" in capsys.readouterr().out
    data = json.loads(path.read_text())
    assert data["limits"] == {"max_force_n": 5.0, "max_torque_nm": 1.0}, "that of the hand is 10 N and 1 N m"
    assert data["end_effectors"]["finger"]["positions_m"][0] == [0.03, 0.0, 0.056]
    assert app.main(["trajectory", *words]) == 2
    assert "already exists" in capsys.readouterr().err
