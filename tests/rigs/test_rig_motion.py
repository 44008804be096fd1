"""Experiments: speeds, end points, frames and faults."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.rigs import Rig, load_rig
from sim_core.rigs.load import names_in
from sim_core.rigs.motion import Experiment, compile_experiment, load_experiment
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.rigs.yamlfile import validate

RIG = load_rig("card_press")
START = RIG.end_effectors["finger"].start


def run(*motions: dict[str, Any], rig: Rig = RIG, **keys: Any) -> PoseTrajectory:
    data = {"name": "test", "command_rate_hz": 1000.0, "motions": {"finger": list(motions)}, **keys}
    return compile_experiment(validate(Experiment, data, "test.yaml"), rig)["finger"]


@pytest.mark.parametrize("name", names_in("experiments"))
def test_experiments_of_the_package_run_on_a_rig_of_the_package(name: str) -> None:
    experiment = load_experiment(name)
    fitting = [
        rig
        for rig in map(load_rig, names_in("rigs"))
        if {*experiment.motions, *experiment.begin} <= {*rig.end_effectors}
    ]
    assert experiment.name == name
    assert fitting
    for effector, path in compile_experiment(experiment, fitting[0]).items():
        assert path.duration < 60.0
        begun = experiment.begin[effector].position() if effector in experiment.begin else 0.0
        np.testing.assert_allclose(path.positions[0], fitting[0].end_effectors[effector].start.position() + begun)


def test_press_goes_down_holds_and_returns() -> None:
    path = run({"type": "press", "depth_m": 0.004, "speed_m_s": 0.01, "hold_s": 0.5})
    speeds, _ = path.speeds()
    assert path.positions[:, 2].min() == pytest.approx(START.position_m[2] - 0.004)
    np.testing.assert_allclose(path.positions[-1], START.position(), atol=1e-12)
    assert speeds.max() == pytest.approx(0.01, rel=1e-3)
    held = (path.positions[:, 2] < START.position_m[2] - 0.004 + 1e-9).sum()
    assert held == pytest.approx(500, abs=10)


def test_an_experiment_may_begin_elsewhere_and_goes_on_from_there() -> None:
    begin = {"finger": {"position_m": [0.01, 0.0, 0.002], "rpy_deg": [0.0, 0.0, 30.0]}}
    there = np.array(START.position_m) + [0.01, 0.0, 0.002]
    path = run({"type": "slide", "by_m": [0.0, 0.005, 0.0]}, begin=begin)
    np.testing.assert_allclose(path.positions[[0, -1]], [there, there + [0.0, 0.005, 0.0]], atol=1e-12)
    for quaternion in path.quaternions[[0, -1]]:
        turned = Rotation.from_quat(quaternion) * START.rotation().inv()
        np.testing.assert_allclose(turned.as_rotvec(degrees=True), [0.0, 0.0, 30.0], atol=1e-9)
    home = run({"type": "waypoints", "poses": [{}]}, begin=begin)  # relative to the start pose of the rig
    np.testing.assert_allclose(home.positions[[0, -1]], [there, START.position_m], atol=1e-12)
    with pytest.raises(ConfigError, match="finher"):
        run({"type": "wait", "duration_s": 1.0}, begin={"finher": {}})


def test_press_direction_need_not_be_a_unit_vector() -> None:
    path = run({"type": "press", "depth_m": 0.01, "along": [0, 3, -4]})
    lowest = path.positions[np.argmin(path.positions[:, 2])] - START.position()
    np.testing.assert_allclose(lowest, [0, 0.006, -0.008], atol=1e-8)


def test_slide_to_and_fro_comes_back_and_one_way_does_not() -> None:
    back = run({"type": "slide", "by_m": [0.01, 0, 0], "back": True, "times": 3})
    np.testing.assert_allclose(back.positions[-1], START.position(), atol=1e-12)
    crossings = np.diff(np.sign(back.positions[:, 0] - START.position_m[0] - 0.005))
    assert np.count_nonzero(crossings) == 6
    away = run({"type": "slide", "by_m": [0.01, 0, 0]})
    np.testing.assert_allclose(away.positions[-1] - START.position(), [0.01, 0, 0], atol=1e-12)


def test_pull_has_constant_speed_in_the_middle() -> None:
    path = run({"type": "pull", "distance_m": 0.02, "speed_m_s": 0.01, "back": False})
    speeds, _ = path.speeds()
    assert np.count_nonzero(np.abs(speeds - 0.01) < 1e-6) > 0.8 * len(speeds)
    assert path.positions[-1, 0] - START.position_m[0] == pytest.approx(0.02)


def test_drop_gives_way_faster_than_things_fall() -> None:
    path = run({"type": "drop", "distance_m": 0.05, "settle_s": 0.1})
    early = path.times < 0.05
    fall = START.position_m[2] - path.positions[early, 2]
    assert (fall >= 0.5 * 9.81 * path.times[early] ** 2).all()
    assert path.positions[-1, 2] == pytest.approx(START.position_m[2] - 0.05)


@pytest.mark.parametrize("frame", ["base", "own"])
def test_bend_turns_about_the_stated_axes_and_returns(frame: str) -> None:
    data = RIG.model_dump()
    data["end_effectors"]["finger"]["start"] = {"rpy_deg": [0.0, 0.0, 90.0]}
    rig = Rig.model_validate(data)
    start = rig.end_effectors["finger"].start
    path = run(
        {"type": "bend", "turn_rpy_deg": [30, 0, 0], "by_m": [0.01, 0, 0], "hold_s": 0.2, "frame": frame},
        rig=rig,
    )
    _, turning = path.speeds()
    furthest = int(np.argmax(np.linalg.norm(path.positions - start.position(), axis=1)))
    turned = Rotation.from_quat(path.quaternions[furthest])
    turn = (turned * start.rotation().inv()).as_rotvec(degrees=True)
    shift = path.positions[furthest] - start.position()
    # The end effector's own x axis points along y of the base.
    axis = np.array([1, 0, 0] if frame == "base" else [0, 1, 0])
    np.testing.assert_allclose(turn, 30 * axis, atol=1e-6)
    np.testing.assert_allclose(shift, 0.01 * axis, atol=1e-8)
    assert np.degrees(turning.max()) <= 45.001
    np.testing.assert_allclose(path.positions[-1], start.position(), atol=1e-12)
    assert (Rotation.from_quat(path.quaternions[-1]).inv() * start.rotation()).magnitude() < 1e-12


def test_waypoints_are_relative_to_the_start_pose() -> None:
    path = run(
        {"type": "slide", "by_m": [0.0, 0.01, 0.0]},
        {"type": "waypoints", "poses": [{"position_m": [0.02, 0, 0], "rpy_deg": [0, 0, 10]}, {}]},
    )
    np.testing.assert_allclose(path.positions[-1], START.position(), atol=1e-12)
    assert path.positions[:, 0].max() == pytest.approx(START.position_m[0] + 0.02)


def test_who_is_done_first_holds_still() -> None:
    data = RIG.model_dump()
    topics = {"target_pose": "other/target_pose", "current_pose": "other/current_pose"}
    data["end_effectors"]["other"] = {"start": {"position_m": [1, 0, 0]}, "topics": topics}
    rig = Rig.model_validate(data)
    plan = {"name": "test", "motions": {"finger": [{"type": "wait", "duration_s": 2.0}], "other": []}}
    paths = compile_experiment(validate(Experiment, plan, "test"), rig)
    assert paths["finger"].duration == paths["other"].duration == 2.0
    assert not paths["other"].speeds()[0].any()


def test_an_experiment_may_only_watch() -> None:
    plan = validate(Experiment, {"name": "watch", "duration_s": 1.5}, "watch")
    assert compile_experiment(plan, RIG)["finger"].duration == pytest.approx(1.5)


PRESS = {"type": "press", "depth_m": 0.01}
FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "unknown motion": ({"type": "pres", "depth_m": 0.01}, r"Did you mean 'press'"),
    "no depth": ({"type": "press"}, r"depth_m is missing"),
    "depth in mm": ({"type": "press", "depth_mm": 4}, r"write depth_m: 0\.004"),
    "standing speed": ({**PRESS, "speed_m_s": 0.0}, r"greater than 0"),
    "speed in mm": ({**PRESS, "speed_mm_s": 5}, r"write speed_m_s: 0\.005"),
    "no direction": ({**PRESS, "along": [0, 0, 0]}, r"Give a direction"),
    "no way": ({"type": "slide", "by_m": [0, 0, 0]}, r"Give a displacement"),
    "repeat without return": ({"type": "slide", "by_m": [1, 0, 0], "times": 2}, r"Add 'back: true'"),
    "never": ({**PRESS, "times": 0}, r"at least 1"),
    "unknown frame": ({**PRESS, "frame": "tool"}, r"Choose one of: 'base' or 'own'"),
    "acceleration of a smooth motion": ({**PRESS, "acceleration_m_s2": 1.0}, r"profile: trapezoidal"),
    "no waypoints": ({"type": "waypoints", "poses": []}, r"1 or more"),
    "backward time": ({"type": "wait", "duration_s": -1.0}, r"at least 0"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_motion_is_refused(fault: str) -> None:
    motion, pattern = FAULTS[fault]
    with pytest.raises(ConfigError, match=pattern) as caught:
        run(motion)
    assert "motions.finger[0]" in str(caught.value)


def test_an_experiment_for_another_rig_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"moves 'gripper', but the rig 'card_press' has no such end effector"):
        compile_experiment(load_experiment("drop"), RIG)


def test_an_endless_experiment_is_refused() -> None:
    with pytest.raises(ConfigError, match="more than 2000000"):
        run({**PRESS, "speed_m_s": 1e-6, "times": 1000})


def test_an_experiment_without_motion_or_time_is_refused() -> None:
    with pytest.raises(ConfigError, match="neither motions nor duration_s"):
        validate(Experiment, {"name": "nothing"}, "nothing")
