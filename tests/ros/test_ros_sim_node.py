"""The simulator node as a process of its own, over loopback."""

import math
import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_live import REST_HEIGHT_M, RIG, START_S, WAIT_S, Client, NodeProcess, is_alive

from sim_core.errors import ConfigError
from thinshell_ros.clouds import MARKER_POINT, TRACK_POINT

pytestmark = pytest.mark.ros

WRENCH = "tactile/left/wrench"
MARKERS = "tactile/left/markers"
REST = "tactile/left/markers_rest"


def stamps_ns(messages: list[Any]) -> list[int]:
    return [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]


def event_names(client: Client) -> list[str]:
    return [s.name.rpartition(" ")[2] for m in client.heard["events"] for s in m.status]


def points(message: Any, kind: Any) -> Any:
    return np.frombuffer(message.data, dtype=kind)


def test_a_press_is_felt(client: Client) -> None:
    client.simulate(0.3)
    free = client.heard[WRENCH][-1].wrench.force.z
    client.go(REST_HEIGHT_M, REST_HEIGHT_M - 0.0012, 1.0)
    client.simulate(0.3)
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
    before = {topic: len(messages) for topic, messages in client.heard.items()}
    client.simulate(1.0)
    now = time.time_ns()
    skips = sum(s.name.endswith("skip") for m in client.heard["events"][before["events"] :] for s in m.status)
    for topic, period in (("current_pose", 10), (WRENCH, 10), (MARKERS, 20), ("side/marker_tracks", 40)):
        stamps = np.array(stamps_ns(client.heard[topic][before[topic] :]))
        assert len(stamps) > 5
        odd = np.abs(np.diff(stamps) / 1e6 - period) > 1e-3
        assert odd.sum() <= skips, topic
        assert now - 60e9 < stamps[-1] < now, "they are the wall clock's, and not in the future"


def test_diagnostics_say_how_the_simulation_is_doing(client: Client) -> None:
    client.go(REST_HEIGHT_M, REST_HEIGHT_M - 0.0002, 0.2)
    client.diagnosis("physics", lambda s: "real_time_factor" in {v.key for v in s.values})
    physics = client.diagnosis("physics", lambda s: s.level != b"\x02")
    values = {v.key: v.value for v in physics.values}
    assert physics.name == "/thinshell_sim: physics"
    assert physics.hardware_id == "press_gel"
    assert 0.0 < float(values["real_time_factor"]) < 1.5
    assert int(values["newton_iterations"]) >= 1
    assert float(values["residual_n"]) < 1e-3
    assert values["nan_count"] == "0"
    seen = len(client.heard["/diagnostics"])

    def followed() -> Any:
        client.aim(REST_HEIGHT_M)
        statuses = (s for m in client.heard["/diagnostics"][seen:] for s in m.status)
        return next((s for s in statuses if s.message == "following targets"), None)

    commands = client.wait(followed, "it does not say that it follows")
    assert 0.0 <= float({v.key: v.value for v in commands.values}["command_age_s"]) < 0.5
    stale = client.diagnosis("commands", lambda s: "no target of probe for" in s.message)
    assert stale.level == b"\x01"
    alone = client.diagnosis("topics", lambda s: True)
    assert alone.level == b"\x00"


def test_another_publisher_of_its_topics_is_said(client: Client) -> None:
    from geometry_msgs.msg import PoseStamped

    other = client.node.create_publisher(PoseStamped, "current_pose", 1)
    try:
        status = client.diagnosis("topics", lambda s: s.level == b"\x02")
        assert status.message.startswith("/client also publishes on /current_pose.")
    finally:
        client.node.destroy_publisher(other)


def test_a_commander_that_outruns_the_speed_limit_is_followed_and_reported(client: Client) -> None:
    """Three turns of 0.45 rad, each at once, where the limit is 3 rad/s and a step 0.02 s."""
    poses, reports = client.heard["current_pose"], client.heard["/diagnostics"]
    seen, still = len(reports), len(poses)

    def said() -> list[str]:
        return [s.message for m in reports[seen:] for s in m.status if s.name.endswith("commands")]

    for turn in (0.45, 0.9, 1.35):
        client.aim(REST_HEIGHT_M, qz=math.sin(turn / 2.0), qw=math.cos(turn / 2.0))
        before = math.sin((turn - 0.45) / 2.0)
        client.wait(lambda before=before: poses[-1].pose.orientation.z > before + 1e-6, "it does not turn")  # type: ignore[misc]
    limited = "limited to max_speed_m_s and max_turn_rate_rad_s"
    client.wait(lambda: any(limited in message for message in said()), "it does not tell that it is limited")
    end = math.sin(0.675)
    client.wait(lambda: abs(poses[-1].pose.orientation.z - end) < 1e-6, "it does not get there")
    turned = 2.0 * np.arcsin([m.pose.orientation.z for m in poses[still:]])
    rates = np.diff(turned) / (np.diff(stamps_ns(poses[still:])) * 1e-9)
    assert rates.max() < 3.0 * 1.01, "no faster than the limit"


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
    client.simulate(0.5)
    assert client.heard[WRENCH][-1].wrench.force.z < -0.2
    rests = len(client.heard[REST])
    assert client.call(Trigger, "thinshell_sim/zero", Trigger.Request()).success
    client.wait(lambda: len(client.heard[REST]) > rests, "the new rest state is not published")
    client.simulate(0.3)
    assert abs(client.heard[WRENCH][-1].wrench.force.z) < 0.02
    assert np.abs(points(client.heard[MARKERS][-1], MARKER_POINT)["dz"]).max() < 1e-5
    tare = next(s for m in client.heard["events"] for s in m.status if s.name.endswith("tare"))
    offsets = {v.key: [float(word) for word in v.value.split()] for v in tare.values}
    assert offsets["/tactile/left/wrench"][2] < -0.2


def test_reset_goes_back_to_the_start(client: Client) -> None:
    from std_srvs.srv import Trigger

    client.go(REST_HEIGHT_M, REST_HEIGHT_M - 0.0012, 0.5)
    response = client.call(Trigger, "thinshell_sim/reset", Trigger.Request())
    assert response.success, response.message
    poses = client.heard["current_pose"]
    client.wait(lambda: abs(poses[-1].pose.position.z - REST_HEIGHT_M) < 1e-12, "it is not back")
    client.simulate(0.3)
    assert abs(client.heard[WRENCH][-1].wrench.force.z) < 0.02
    assert (np.diff(stamps_ns(client.heard[WRENCH])) > 0).all(), "time goes on"
    assert "reset" in event_names(client)


def test_pause_stops_time(client: Client) -> None:
    from std_srvs.srv import SetBool

    assert client.call(SetBool, "thinshell_sim/pause", SetBool.Request(data=True)).message == "paused"
    client.spin(0.3)
    before = len(client.heard[WRENCH])
    client.diagnosis("physics", lambda s: s.message == "paused")
    assert len(client.heard[WRENCH]) == before
    assert client.call(SetBool, "thinshell_sim/pause", SetBool.Request(data=False)).message == "running"
    client.wait(lambda: len(client.heard[WRENCH]) > before + 10, "it does not go on")
    assert time.time_ns() - stamps_ns(client.heard[WRENCH])[-1] < 60e9, "stamps are the wall clock's again"
    client.wait(lambda: "skip" in event_names(client), "the pause is not reported")


def test_a_rig_that_is_not_there_is_said_with_code_2(ros: None, tmp_path: Path) -> None:
    node = NodeProcess("sim_node", tmp_path / "output", rig="card_pres")
    try:
        assert node.process.wait(WAIT_S) == 2
        assert "Did you mean 'card_press'?" in node.output
        assert "Traceback" not in node.output
    finally:
        node.kill()


def test_a_scene_that_cannot_be_built_is_logged(ros: None, tmp_path: Path) -> None:
    """On the console too, not in the diagnostics alone."""
    rig = tmp_path / "inside.yaml"
    rig.write_text(RIG.read_text().replace(f"{REST_HEIGHT_M:g}", f"{REST_HEIGHT_M - 0.001:g}"))
    node = NodeProcess("sim_node", tmp_path / "output", "/inside", rig=rig)
    try:
        end = time.monotonic() + START_S
        while "starts inside" not in node.output:
            assert time.monotonic() < end, node.output
            time.sleep(0.1)
        assert "Call ~/reset to start it again" in node.output
        assert "Traceback" not in node.output
        assert node.stop() == 0
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


SLOW_START = """
import sys, time
from thinshell_ros import sim_node

create_timer = sim_node.SimNode.create_timer

def slowly(self, *args, **kwargs):
    time.sleep(1.0)
    return create_timer(self, *args, **kwargs)

if __name__ == "__main__":
    sim_node.SimNode.create_timer = slowly
    sys.exit(sim_node.main())
"""
"""A node that is interrupted in its constructor, after the physics process was started."""


@pytest.mark.parametrize("slowly", [False, True])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_cleanly_while_it_still_builds_its_scene(ros: None, tmp_path: Path, number: int, slowly: bool) -> None:
    script = tmp_path / "slow_start.py"
    script.write_text(SLOW_START)
    node = NodeProcess(str(script) if slowly else "sim_node", tmp_path / "output", rig=RIG)
    try:
        end = time.monotonic() + WAIT_S
        while not (physics := node.spawned()):
            assert time.monotonic() < end
            time.sleep(0.05)
        node.process.send_signal(number)
        time.sleep(0.05)
        node.process.send_signal(number)
        assert node.process.wait(WAIT_S) == 0, node.output
        assert not is_alive(physics)
    finally:
        node.kill()


def seconds(clock: list[Any]) -> np.ndarray:
    return np.array([m.clock.sec + 1e-9 * m.clock.nanosec for m in clock])


@pytest.mark.slow
def test_simulated_time_steps_on_demand_and_a_physics_process_that_hangs(ros: None, tmp_path: Path) -> None:
    """One node through all of it, since every start builds a scene."""
    from diagnostic_msgs.msg import DiagnosticArray
    from rosgraph_msgs.msg import Clock
    from std_srvs.srv import SetBool, Trigger

    given = {"rig": RIG, "publish_clock": "true", "step_duration_s": 0.1, "watchdog_s": 1.0}
    node = NodeProcess("sim_node", tmp_path / "output", "/other", **given)
    client = Client("client")

    def call(service: str, on: bool | None = None) -> Any:
        kind = Trigger if on is None else SetBool
        request = Trigger.Request() if on is None else SetBool.Request(data=on)
        return client.call(kind, f"/other/thinshell_sim/{service}", request)

    try:
        client.listen(DiagnosticArray, "/diagnostics")
        clock = client.listen(Clock, "/clock")
        client.wait(lambda: clock, f"no clock: {node.output}", START_S)
        begin, count = time.monotonic(), len(clock)
        client.spin(1.0)
        assert (len(clock) - count) / (time.monotonic() - begin) > 100.0
        assert (np.diff(seconds(clock)) > 0.0).all()

        assert not call("step").success, "not while it runs"
        assert call("pause", True).success
        client.spin(0.1)
        at = seconds(clock)[-1]
        responses = [call("step") for _ in range(3)]
        assert all(a.success and "5 steps of 0.02 s" in a.message for a in responses), responses
        client.spin(0.1)
        assert seconds(clock)[-1] - at == pytest.approx(0.3, abs=0.021)
        assert call("pause", False).success

        os.kill(node.spawned(), signal.SIGSTOP)
        begin = time.monotonic()
        assert "has not answered" in call("pause", True).message
        assert time.monotonic() - begin < 4.0
        status = client.diagnosis("/other/thinshell_sim: physics", lambda s: "has not answered for" in s.message)
        assert status.level == b"\x02"
        last = seconds(clock)[-1]
        response = call("reset")
        assert response.success
        assert "started again" in response.message
        count = len(clock)
        client.wait(lambda: len(clock) > count, f"it did not start again: {node.output}", START_S)
        assert seconds(clock)[-1] > last

        os.kill(node.spawned(), signal.SIGKILL)
        client.diagnosis("/other/thinshell_sim: physics", lambda s: "ended with code -9" in s.message)
        assert call("reset").success
        count = len(clock)
        client.wait(lambda: len(clock) > count, f"it did not start again: {node.output}", START_S)
        assert node.stop(signal.SIGTERM) == 0, node.output
    finally:
        client.node.destroy_node()
        node.kill()
