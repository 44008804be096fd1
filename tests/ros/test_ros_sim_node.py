"""The simulator node as a process of its own, over loopback."""

import math
import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_live import REST_HEIGHT_M, RIG, START_S, Client, NodeProcess, is_alive

from sim_core.errors import ConfigError
from thinshell_ros.clouds import MARKER_POINT, TRACK_POINT

pytestmark = pytest.mark.ros

WRENCH = "tactile/left/wrench"
MARKERS = "tactile/left/markers"
REST = "tactile/left/markers_rest"


def stamps_ns(messages: list[Any]) -> list[int]:
    return [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]


def points(message: Any, kind: Any) -> Any:
    return np.frombuffer(message.data, dtype=kind)


def test_a_press_is_felt(client: Client) -> None:
    client.spin(0.3)
    free = client.heard[WRENCH][-1].wrench.force.z
    client.go(REST_HEIGHT_M, REST_HEIGHT_M - 0.0012, 1.0)
    client.spin(0.3)
    wrench, markers = client.heard[WRENCH], client.heard[MARKERS]
    forces = np.array([[m.wrench.force.x, m.wrench.force.y, m.wrench.force.z] for m in wrench])
    assert np.isfinite(forces).all()
    assert abs(free) < 0.02
    assert forces[-1, 2] < -0.2, "the ball pushes the sensor down"
    assert np.abs(forces[-1, :2]).max() < 0.05 * abs(forces[-1, 2])

    last = points(markers[-1], MARKER_POINT)
    assert markers[-1].header.frame_id == wrench[-1].header.frame_id == "tactile_left_gel"
    assert (markers[-1].width, markers[-1].point_step, markers[-1].is_dense) == (16, 40, False)
    assert [f.name for f in markers[-1].fields] == list(MARKER_POINT.names or ())
    assert last["id"].tolist() == list(range(16))
    assert last["dz"].min() < -1e-4
    rest = points(client.heard[REST][-1], MARKER_POINT)
    np.testing.assert_allclose(last["z"] - last["dz"], rest["z"], atol=1e-8)

    tracks, info = client.heard["side/marker_tracks"][-1], client.heard["side/camera_info"][-1]
    seen = points(tracks, TRACK_POINT)
    assert ((seen["u"] > 0) & (seen["u"] < 640) & (seen["v"] > 0) & (seen["v"] < 480)).all()
    assert tracks.header.frame_id == info.header.frame_id == "side_optical_frame"
    assert (info.width, info.height, info.k[0], info.distortion_model) == (640, 480, 1400.0, "plumb_bob")


def test_stamps_are_regular_simulated_time(client: Client) -> None:
    client.spin(1.0)
    for topic, period in (("current_pose", 10), (WRENCH, 10), (MARKERS, 20), ("side/marker_tracks", 40)):
        stamps = np.array(stamps_ns(client.heard[topic]))
        assert len(stamps) > 5
        np.testing.assert_allclose(np.diff(stamps) / 1e6, period, atol=1e-3, err_msg=topic)
    assert abs(time.time_ns() - stamps[-1]) < 600e9, "they start at the wall clock"


def test_diagnostics_say_how_the_simulation_is_doing(client: Client) -> None:
    client.go(REST_HEIGHT_M, REST_HEIGHT_M - 0.0002, 0.2)
    client.diagnosis("physics", lambda s: "real_time_factor" in {v.key for v in s.values})
    physics = client.diagnosis("physics", lambda s: s.level != b"\x02")
    values = {v.key: v.value for v in physics.values}
    assert physics.name == "/thinshell_sim: physics"
    assert physics.hardware_id == "press_gel"
    assert 0.05 < float(values["real_time_factor"]) < 1.5
    assert int(values["newton_iterations"]) >= 1
    assert float(values["residual_n"]) < 1e-3
    assert values["nan_count"] == "0"
    commands = client.diagnosis("commands", lambda s: s.message == "following targets")
    assert 0.0 <= float({v.key: v.value for v in commands.values}["command_age_s"]) < 30.0


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        ({"z": REST_HEIGHT_M, "frame": "world"}, "expected 'base_link'"),
        ({"z": math.nan}, "not finite"),
        ({"z": REST_HEIGHT_M, "qw": 0.5}, "length 0.5"),
        ({"z": REST_HEIGHT_M + 0.2}, "max_jump_m"),
        ({"z": REST_HEIGHT_M, "qw": 0.0, "qx": 1.0}, "max_jump_rad"),
    ],
)
def test_bad_targets_are_rejected_and_reported(client: Client, target: dict[str, Any], reason: str) -> None:
    client.aim(**target)
    status = client.diagnosis("commands", lambda s: reason in s.message)
    assert status.level == b"\x01"
    assert client.heard["current_pose"][-1].pose.position.z == REST_HEIGHT_M


def test_zero_makes_the_present_state_the_rest(client: Client) -> None:
    from std_srvs.srv import Trigger

    client.go(REST_HEIGHT_M, REST_HEIGHT_M - 0.0012, 0.5)
    client.spin(0.5)
    assert client.heard[WRENCH][-1].wrench.force.z < -0.2
    rests = len(client.heard[REST])
    assert client.call(Trigger, "thinshell_sim/zero", Trigger.Request()).success
    client.wait(lambda: len(client.heard[REST]) > rests, "the new rest state is not published")
    client.spin(0.3)
    assert abs(client.heard[WRENCH][-1].wrench.force.z) < 0.02
    assert np.abs(points(client.heard[MARKERS][-1], MARKER_POINT)["dz"]).max() < 1e-5


def test_reset_goes_back_to_the_start(client: Client) -> None:
    from std_srvs.srv import Trigger

    client.go(REST_HEIGHT_M, REST_HEIGHT_M - 0.0012, 0.5)
    response = client.call(Trigger, "thinshell_sim/reset", Trigger.Request())
    assert response.success, response.message
    poses = client.heard["current_pose"]
    client.wait(lambda: abs(poses[-1].pose.position.z - REST_HEIGHT_M) < 1e-12, "it is not back")
    client.spin(0.3)
    assert abs(client.heard[WRENCH][-1].wrench.force.z) < 0.02
    assert (np.diff(stamps_ns(client.heard[WRENCH])) > 0).all(), "time goes on"


def test_pause_stops_time(client: Client) -> None:
    from std_srvs.srv import SetBool

    assert client.call(SetBool, "thinshell_sim/pause", SetBool.Request(data=True)).message == "paused"
    client.spin(0.3)
    before = len(client.heard[WRENCH])
    client.diagnosis("physics", lambda s: s.message == "paused")
    assert len(client.heard[WRENCH]) == before
    assert client.call(SetBool, "thinshell_sim/pause", SetBool.Request(data=False)).message == "running"
    client.wait(lambda: len(client.heard[WRENCH]) > before + 10, "it does not go on")
    assert np.diff(stamps_ns(client.heard[WRENCH])).max() < 15e6, "no time is lost to the pause"


def test_a_rig_that_is_not_there_is_said_with_code_2(ros: None, tmp_path: Path) -> None:
    node = NodeProcess("sim_node", tmp_path / "output", rig="card_pres")
    try:
        assert node.process.wait(30.0) == 2
        assert "Did you mean 'card_press'?" in node.output
        assert "Traceback" not in node.output
    finally:
        node.kill()


@pytest.mark.parametrize(
    ("default", "given", "said"),
    [
        (100.0, 5, "Write a decimal point"),
        (100.0, 300.0, "from 1 to 250"),
        (100.0, math.nan, "from 1 to 250"),
        (100, 0, "from 1 to 250"),
        (True, 1.0, "of type bool"),
    ],
)
def test_a_parameter_that_does_not_fit_is_said(ros: None, default: Any, given: Any, said: str) -> None:
    import rclpy
    from rclpy.parameter import Parameter

    from thinshell_ros.parameters import declare

    node = rclpy.create_node("parameters", parameter_overrides=[Parameter("x", value=given)])
    bounds = None if isinstance(default, bool) else (1.0, 250.0)
    try:
        with pytest.raises(ConfigError, match=said):
            declare(node, "x", default, "a number", bounds=bounds)
    finally:
        node.destroy_node()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_cleanly_while_it_still_builds_its_scene(ros: None, tmp_path: Path, number: int) -> None:
    node = NodeProcess("sim_node", tmp_path / "output", rig=RIG)
    try:
        end = time.monotonic() + 30.0
        while not (physics := node.spawned()):
            assert time.monotonic() < end
            time.sleep(0.05)
        node.process.send_signal(number)
        time.sleep(0.05)
        node.process.send_signal(number)
        assert node.process.wait(20.0) == 0, node.output
        assert not is_alive(physics)
    finally:
        node.kill()


@pytest.mark.slow
def test_a_lost_physics_process_is_said_and_a_reset_starts_it_again(ros: None, tmp_path: Path) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from rosgraph_msgs.msg import Clock
    from std_srvs.srv import Trigger

    node = NodeProcess("sim_node", tmp_path / "output", "/other", rig=RIG, publish_clock="true")
    client = Client("client")
    try:
        client.listen(DiagnosticArray, "/diagnostics")
        clock = client.listen(Clock, "/clock")
        client.wait(lambda: clock, f"no clock: {node.output}", START_S)
        os.kill(node.spawned(), signal.SIGKILL)
        client.diagnosis("/other/thinshell_sim: physics", lambda s: "ended with code -9" in s.message)
        last = clock[-1].clock.sec + 1e-9 * clock[-1].clock.nanosec
        assert client.call(Trigger, "/other/thinshell_sim/reset", Trigger.Request()).success
        count = len(clock)
        client.wait(lambda: len(clock) > count, f"it did not start again: {node.output}", START_S)
        assert clock[-1].clock.sec + 1e-9 * clock[-1].clock.nanosec > last
        assert node.stop(signal.SIGTERM) == 0, node.output
    finally:
        client.node.destroy_node()
        node.kill()
