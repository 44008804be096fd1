"""The physics of the simulator node: targets, failures, resets. Needs no ROS."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sim_core.rigs import load_rig, with_parameters
from thinshell_ros.physics import Physics
from thinshell_ros.poses import Pose
from thinshell_ros.protocol import Settings, Target, Velocity
from thinshell_ros.streams import channels_of

RIG = Path(__file__).parent / "data" / "press_gel.yaml"


TROUBLE = "The step did not converge."


def settings(**changes: Any) -> Settings:
    rig = load_rig(RIG)
    values: dict[str, Any] = {"seed": None, "max_speed_m_s": 0.1, "max_turn_rate_rad_s": 1.0, **changes}
    return Settings(rig, channels_of(rig, 50.0), **values)


@pytest.fixture(scope="module")
def physics() -> Physics:
    return Physics(settings())


def press(physics: Physics, z: float, steps: int) -> dict[str, np.ndarray]:
    """Last readings after going to a height [m]."""
    physics.aim(Target("probe", Pose(np.array([0.0, 0.0, z]), np.array([0.0, 0.0, 0.0, 1.0]))))
    last = {}
    for _ in range(steps):
        last.update({r.channel: r.values for r in physics.step()[0]})
    return last


def test_the_end_effector_goes_to_its_target_no_faster_than_allowed(physics: Physics) -> None:
    physics.reset()
    start = physics.rest["probe"]
    readings = press(physics, 0.0065, 1)
    np.testing.assert_allclose(readings["probe"][2], start[2] - 0.1 * physics.dt, atol=1e-12)
    np.testing.assert_allclose(press(physics, 0.0095, 3)["probe"][2], 0.0095, atol=1e-12)


def test_pressing_pushes_the_sensor_down_and_letting_go_relieves_it(physics: Physics) -> None:
    physics.reset()
    touching = press(physics, 0.0092, 30)
    assert touching["pad_wrench"][2] < -0.1
    assert touching["pad_markers"][:, 2].min() < physics.rest["pad_markers"][:, 2].min() - 1e-5
    relieved = press(physics, 0.0105, 30)
    np.testing.assert_allclose(relieved["pad_wrench"], physics.rest["pad_wrench"], atol=1e-6)


def test_a_failed_step_leaves_the_state_untouched(physics: Physics, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of which the core makes a part, and finds no end: the probe is to go through the block within it."""
    physics.reset()
    press(physics, 0.0095, 20)
    before = physics._read()
    simulation = physics._simulation
    plain = simulation.step

    def too_far(frames: Any, dt: float) -> Any:
        origin, rotation = simulation.frames["probe"]
        return plain({**frames, "probe": (origin - [0.0, 0.0, 0.02], rotation)}, dt)

    with monkeypatch.context() as patch:
        patch.setattr(simulation, "step", too_far)
        with pytest.raises(ConvergenceError):
            press(physics, 0.0094, 1)
    after = physics._read()
    assert all((before[name] == after[name]).all() for name in before)


def test_where_a_step_fails_the_end_effector_is_held_until_the_command_retreats(
    physics: Physics, monkeypatch: pytest.MonkeyPatch
) -> None:
    physics.reset()
    press(physics, 0.0095, 20)
    simulation, real, wall, tried = physics._simulation, physics._simulation.step, [0.0], []

    def too_deep(frames: Any, dt: float) -> Any:
        depth = frames["probe"][0][2]
        if depth < 0.0094:
            tried.append(depth)
            wall[0] += 1.0
            raise ConvergenceError(TROUBLE)
        return real(frames, dt)

    monkeypatch.setattr(simulation, "step", too_deep)
    monkeypatch.setattr(physics, "_clock", lambda: wall[0])
    before = physics.time
    held = press(physics, 0.0080, 10)["probe"][2]
    assert held == pytest.approx(0.0095), "the first step of 2 mm fails"
    assert physics.time == pytest.approx(before + 10 * physics.dt), "time goes on"
    assert physics.failure is not None
    assert TROUBLE in physics.failure.words
    assert len(tried) == 1, "a command that stays is not tried again"
    press(physics, 0.0079, 5)
    assert len(tried) == 1, "nor at once is one that goes farther"
    wall[0] += 10.0
    press(physics, 0.0079, 1)
    assert len(tried) == 2, "but it is after a while"
    assert press(physics, 0.0100, 5)["probe"][2] == pytest.approx(0.0100), "a retreat is followed at once"
    assert physics.failure is None


def test_a_gel_that_is_pressed_too_far_is_reported_by_name_and_a_retreat_is_followed(physics: Physics) -> None:
    """To the mount that the gel of 4 mm is glued to, and back; the force that guards look at never falls on the way."""
    physics.reset()
    forces = []
    for _ in range(40):
        readings = press(physics, 0.0035, 5)
        forces.append(-readings["pad_wrench"][2])
        if physics.failure is not None:
            break
    assert physics.failure is not None
    assert "pad would turn inside out near x = " in physics.failure.words
    assert forces[-1] > 10.0 and (np.diff(forces) >= -1e-3 * max(forces)).all()
    press(physics, 0.0105, 60)
    assert physics.failure is None
    physics.reset()


def test_what_follows_a_snapshot_is_the_same_again_bit_for_bit_after_a_reset_too(physics: Physics) -> None:
    physics.reset()
    press(physics, 0.0094, 20)
    physics.keep()
    at, here = physics.time, physics._read()
    press(physics, 0.0092, 15)
    first = physics._read()
    for reset in (False, True):
        if reset:
            physics.reset()
        before = physics.time
        assert physics.restore() == at and physics.time == before
        again = physics._read()
        assert all((again[name] == here[name]).all() for name in here)
        press(physics, 0.0092, 15)
        second = physics._read()
        assert all((second[name] == first[name]).all() for name in first)
    assert Physics(settings()).restore() is None


def test_an_end_effector_moves_with_a_velocity_for_as_long_as_it_is_said_and_then_holds(physics: Physics) -> None:
    physics.reset()
    start = physics.rest["probe"]
    linear, angular = np.array([0.0, 0.01, 0.02]), np.array([0.0, 0.0, 0.5])
    physics.aim(Velocity("probe", linear, angular, 6 * physics.dt))
    for steps in (6, 9):
        physics.step()
        for _ in range(steps - 1):
            physics.step()
        pose, moved_s = physics._poses["probe"], 6 * physics.dt
        np.testing.assert_allclose(pose.position, start[:3] + moved_s * linear, atol=1e-12)
        np.testing.assert_allclose(pose.rotation().as_rotvec(), moved_s * angular, atol=1e-9)
    physics.aim(Velocity("probe", linear, angular, 1.0))
    assert press(physics, 0.0105, 30)["probe"][2] == pytest.approx(0.0105, abs=1e-12), "a pose takes its place"


def test_time_goes_on_over_a_reset(physics: Physics) -> None:
    before = physics.time
    physics.reset()
    readings = physics.step()[0]
    assert all(r.stamp_s > before for r in readings)


def test_poses_are_published_without_the_offset_of_the_end_effector() -> None:
    """The probe is 1 mm higher than it says: the pose that goes out is that of the command, and stays so at rest."""
    plain = settings()
    off = replace(plain, rig=with_parameters(plain.rig, {"probe.offset_z_m": 1e-3}))
    physics = Physics(off)
    np.testing.assert_array_equal(physics.rest["probe"], Physics(plain).rest["probe"])
    high = physics._simulation.frames["probe"][0] - plain.rig.end_effectors["probe"].start.position()
    np.testing.assert_allclose(np.linalg.norm(high), 1e-3, rtol=1e-9)
    physics.step()
    np.testing.assert_allclose(physics._simulation.frames["probe"][0], high + physics.rest["probe"][:3], atol=1e-12)
