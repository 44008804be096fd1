"""The node that replays, as a process of its own, over loopback: on a plant in this process, and on ``sim_node``."""

from __future__ import annotations

import random
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_live import REST_HEIGHT_M, RIG, START_S, Client, NodeProcess
from ros_replayer import NODE, PATIENT, SLOW_PLANT, Replayer, execute

from sim_core.rigs import load_rig, rig_to_yaml, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory, minimum_jerk
from sim_core.trajectories import Limits, Trajectory, make_trajectory, rollout, write_trajectory
from sysid.model.load import load_run
from sysid.observations.rig_topics import topics_of
from sysid.recording import read_recording

pytestmark = pytest.mark.ros

DEPTH_M = 0.0012
PLACE = "/guarded"
"""Namespace of the node of the module: a ``sim_node`` of other tests may publish next to it."""
BOX = Limits(workspace_min_m=(-0.01, -0.01, REST_HEIGHT_M - 0.002), workspace_max_m=(0.01, 0.01, 0.05))
STIFFNESS_N_PER_M = 2000.0
CONTACT_M = REST_HEIGHT_M - 0.0005


def press(rest_s: float = 0.5, down_s: float = 1.0) -> Trajectory:
    """Down by 1.2 mm, a rest, and up again."""
    end = 2.0 * down_s + rest_s
    times = np.linspace(0.0, end, round(100.0 * end) + 1)
    up = minimum_jerk(np.clip((times - down_s - rest_s) / down_s, 0.0, 1.0))
    share = minimum_jerk(np.clip(times / down_s, 0.0, 1.0)) - up
    positions = [0.0, 0.0, REST_HEIGHT_M] - np.outer(share, [0.0, 0.0, DEPTH_M])
    poses = {"probe": PoseTrajectory(times, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1)))}
    return make_trajectory(load_rig(RIG), poses, limits=BOX)


class Plant:
    """A pad on the topics of the rig: follows its target at once and responds with a spring. Faults are attributes."""

    def __init__(self, client: Client, namespace: str = "", pose_topic: str = "/current_pose") -> None:
        from geometry_msgs.msg import PoseStamped, WrenchStamped

        self._clock = client.node.get_clock()
        self._pose_publisher = client.node.create_publisher(PoseStamped, pose_topic, 5)
        self._wrench_publisher = client.node.create_publisher(WrenchStamped, f"{namespace}/tactile/left/wrench", 5)
        client.node.create_subscription(PoseStamped, f"{namespace}/target_pose", self._follow, 1000)
        client.node.create_timer(0.02, self._publish)
        self.repair()

    def repair(self) -> None:
        """Back to the start, without a fault."""
        self.z = self.deepest = REST_HEIGHT_M
        self.silent: set[str] = set()
        self.stuck = False
        self.offset_m = self.late_s = self.extra_n = 0.0

    def _follow(self, message: Any) -> None:
        if not self.stuck:
            self.z = message.pose.position.z
            self.deepest = min(self.deepest, self.z)

    def _publish(self) -> None:
        from geometry_msgs.msg import PoseStamped, WrenchStamped
        from rclpy.duration import Duration

        stamp = (self._clock.now() - Duration(nanoseconds=round(1e9 * self.late_s))).to_msg()
        if "pose" not in self.silent:
            pose = PoseStamped()
            pose.header.frame_id, pose.header.stamp = "base_link", stamp
            pose.pose.position.z = self.z + self.offset_m
            self._pose_publisher.publish(pose)
        if "wrench" not in self.silent:
            wrench = WrenchStamped()
            wrench.header.frame_id, wrench.header.stamp = "tactile_left_gel", stamp
            wrench.wrench.force.z = -STIFFNESS_N_PER_M * max(CONTACT_M - self.z, 0.0) - self.extra_n
            self._wrench_publisher.publish(wrench)


@pytest.fixture(scope="module")
def replayer(ros: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Replayer]:
    """A node, and a client of it; it must end with code 0 and without a traceback."""
    folder = tmp_path_factory.mktemp("replay")
    process = NodeProcess("replay_node", folder / "output", PLACE, rig=RIG, record="false")
    client = Replayer(process, PLACE, PLACE)
    try:
        client.wait(lambda: client.statuses, f"no status: {process.output}", START_S)
        yield client
        assert process.stop() == 0, process.output
        assert "Traceback" not in process.output, process.output
    finally:
        process.kill()
        client.node.destroy_node()


@pytest.fixture(scope="module")
def plant(replayer: Replayer) -> Plant:
    """What the node of the module moves."""
    return Plant(replayer, PLACE, f"{PLACE}/current_pose")


@pytest.fixture
def unconfigured(replayer: Replayer, plant: Plant) -> Replayer:
    """The node as it is after its start, with a plant at the start pose."""
    for transition in ("deactivate", "cleanup"):
        replayer.change(transition)
    plant.repair()
    normal = {"max_force_n": 0.0, "tracking_tolerance_m": 0.01, "speed_scale": 1.0, "max_speed_m_s": 0.0}
    replayer.set(trajectory_uri="", dry_run=False, record=False, record_uri="", **PATIENT, **normal)
    return replayer


def active(replayer: Replayer, trajectory: Trajectory, folder: Path, **given: Any) -> Replayer:
    """The node, ready to replay a trajectory."""
    write_trajectory(folder / "t.json", trajectory)
    replayer.set(trajectory_uri=str(folder / "t.json"), **given)
    assert replayer.change("configure"), replayer.process.output
    assert replayer.change("activate"), replayer.process.output
    replayer.targets.clear()
    return replayer


def test_a_trajectory_that_must_not_be_replayed_is_refused_when_it_is_configured(
    unconfigured: Replayer, tmp_path: Path
) -> None:
    def refused() -> str:
        assert not unconfigured.change("configure")
        unconfigured.spin(0.2)
        return {pair.key: pair.value for pair in unconfigured.statuses[-1].values}["detail"]

    assert "Set trajectory_uri, or publish one on ~/trajectory" in refused()
    write_trajectory(tmp_path / "t.json", press())
    unconfigured.set(trajectory_uri=str(tmp_path / "t.json"), max_speed_m_s=0.001)
    assert "The speed of probe is 0.00224" in refused()
    unconfigured.set(max_speed_m_s=0.0, trajectory_uri=str(tmp_path / "none.json"))
    assert "does not exist" in refused()
    assert not unconfigured.trigger("execute").success


def test_a_dry_run_commands_nothing(unconfigured: Replayer, plant: Plant, tmp_path: Path) -> None:
    from geometry_msgs.msg import PoseStamped

    shown = unconfigured.listen(PoseStamped, f"{PLACE}/{NODE}/dry_run/target_pose")
    active(unconfigured, press(), tmp_path, dry_run=True)
    execute(unconfigured)
    ended = unconfigured.until("succeeded", "aborted")
    assert ended["state"] == "succeeded", ended
    assert ended["dry_run"] == "true"
    assert not unconfigured.targets
    assert plant.deepest == REST_HEIGHT_M
    assert min(m.pose.position.z for m in shown) == pytest.approx(REST_HEIGHT_M - DEPTH_M, abs=1e-6)


def test_a_press_is_replayed_and_recorded(unconfigured: Replayer, plant: Plant, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    assert not unconfigured.trigger("execute").success, "not before it is configured"
    active(unconfigured, press(), tmp_path, record=True, record_uri=str(bag))
    unconfigured.spin(1.0)
    assert not unconfigured.targets, "activation commands nothing"
    execute(unconfigured)
    ended = unconfigured.until("succeeded", "aborted")
    assert ended["state"] == "succeeded", ended
    assert unconfigured.change("deactivate")
    unconfigured.wait(lambda: plant.z == unconfigured.targets[-1].pose.position.z, "the plant does not follow")
    heights = np.array([m.pose.position.z for m in unconfigured.targets])
    assert plant.deepest == pytest.approx(REST_HEIGHT_M - DEPTH_M, abs=1e-9)
    assert heights[-1] == pytest.approx(REST_HEIGHT_M, abs=1e-12)
    assert unconfigured.targets[-1].header.frame_id == "base_link"

    names, _ = topics_of(load_rig(RIG), read_recording(bag).provenance.message_counts)
    recording = read_recording(bag, names)
    recorded = recording.target_poses["probe"].position[:, 2]
    assert recorded.min() == pytest.approx(REST_HEIGHT_M - DEPTH_M, abs=1e-9)
    assert recording.wrenches["pad_wrench"].force[:, 2].min() < -1.0


def test_it_begins_at_the_first_pose_only(unconfigured: Replayer, plant: Plant, tmp_path: Path) -> None:
    active(unconfigured, press(), tmp_path)
    plant.z = REST_HEIGHT_M + 0.003
    unconfigured.spin(0.5)
    answer = unconfigured.trigger("execute")
    assert not answer.success
    assert "probe is 0.003 m away from its first pose, at most 0.002 m" in answer.message
    assert not unconfigured.targets


def test_it_does_not_begin_where_somebody_else_commands(unconfigured: Replayer, plant: Plant, tmp_path: Path) -> None:
    from geometry_msgs.msg import PoseStamped

    active(unconfigured, press(), tmp_path)
    other = unconfigured.node.create_publisher(PoseStamped, f"{PLACE}/target_pose", 1)
    try:
        unconfigured.spin(1.0)
        answer = unconfigured.trigger("execute")
        assert not answer.success
        assert f"/operator also publishes on {PLACE}/target_pose. Stop it first." in answer.message
    finally:
        unconfigured.node.destroy_publisher(other)


FAULTS = {
    "force_step": ("The force on pad_wrench is", 10.5),
    "jump": ("The measured pose of probe jumped by 0.011", 0.011),
    "stop": ("it does not follow, at most 0.0003 m", 0.0),
    "pose_silent": ("The last reading of the pose of probe", 0.0),
    "wrench_silent": ("The last reading of the wrench pad_wrench", 0.0),
    "late": ("The last reading of the", 3.0),  # stamps before those that have come are no new readings
}


def run_into(fault: str, size: float, replayer: Replayer, plant: Plant, after_m: float) -> dict[str, str]:
    """Execute, bring in a fault when the plant is ``after_m`` below the start, and wait for the end."""
    execute(replayer)
    replayer.wait(lambda: plant.z < REST_HEIGHT_M - after_m, "it does not go down")
    if fault.endswith("silent"):
        plant.silent.add(fault.removesuffix("_silent"))
    plant.stuck = fault == "stop"
    plant.extra_n = size if fault == "force_step" else 0.0
    plant.offset_m = size if fault == "jump" else 0.0
    plant.late_s = size if fault == "late" else 0.0
    ended = replayer.until("succeeded", "aborted")
    replayer.spin(0.3)
    return ended


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_plant_aborts_and_holds(
    fault: str, unconfigured: Replayer, plant: Plant, tmp_path: Path
) -> None:
    said, size = FAULTS[fault]
    active(unconfigured, press(10.0, 4.0), tmp_path, tracking_tolerance_m=3e-4 if fault == "stop" else 0.01)
    ended = run_into(fault, size, unconfigured, plant, 0.0002)
    assert ended["state"] == "aborted"
    assert said in ended["detail"]
    held = unconfigured.targets[-1].pose.position.z
    again = [m.pose.position.z for m in unconfigured.targets[-5:]]
    assert again == [held] * 5
    assert held > REST_HEIGHT_M - DEPTH_M - 1e-9
    assert not unconfigured.change("configure"), "it is still active"


def test_on_abort_it_holds_where_the_robot_is(unconfigured: Replayer, plant: Plant, tmp_path: Path) -> None:
    active(unconfigured, press(10.0, 4.0), tmp_path)
    execute(unconfigured)
    unconfigured.wait(lambda: plant.z < REST_HEIGHT_M - 0.0003, "it does not go down")
    assert unconfigured.trigger("abort").success
    assert not unconfigured.trigger("abort").success
    unconfigured.spin(0.5)
    assert unconfigured.targets[-1].pose.position.z == plant.z
    assert plant.deepest > REST_HEIGHT_M - DEPTH_M
    assert unconfigured.statuses[-1].message == "aborted"


def test_a_trajectory_may_come_as_a_message(unconfigured: Replayer, plant: Plant) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from trajectory_msgs.msg import MultiDOFJointTrajectory

    from thinshell_ros.replay.messages import to_message

    quality = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = unconfigured.node.create_publisher(MultiDOFJointTrajectory, f"{PLACE}/{NODE}/trajectory", quality)
    publisher.publish(to_message(press()))
    unconfigured.wait(lambda: "A trajectory has come" in unconfigured.process.output, "it does not come")
    assert not unconfigured.change("configure"), "a message has no workspace box"
    unconfigured.set(workspace_min_m=[-0.01, -0.01, 0.0], workspace_max_m=[0.01, 0.01, 0.02])
    assert unconfigured.change("configure"), unconfigured.process.output
    assert unconfigured.change("activate")
    execute(unconfigured)
    assert unconfigured.until("succeeded", "aborted")["state"] == "succeeded"
    assert plant.deepest == pytest.approx(REST_HEIGHT_M - DEPTH_M, abs=1e-6)
    unconfigured.node.destroy_publisher(publisher)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_commander_that_ends_leaves_the_robot_where_it_is(ros: None, tmp_path: Path, number: int) -> None:
    """In a namespace of its own, with the pose of the robot on another topic; SIGKILL leaves the last command."""
    write_trajectory(tmp_path / "t.json", press(10.0, 4.0))
    given = {"trajectory_uri": tmp_path / "t.json", "rig": RIG, "dry_run": "false", "record": "false", **PATIENT}
    remaps = {"current_pose": "/robot/pose"}
    process = NodeProcess("replay_node", tmp_path / "output", "/alone", remaps=remaps, **given)
    client = Replayer(process, "/alone", "/alone")
    plant = Plant(client, "/alone", "/robot/pose")
    try:
        client.wait(lambda: client.statuses, f"no status: {process.output}", START_S)
        assert client.change("configure"), process.output
        assert client.change("activate")
        execute(client)
        client.wait(lambda: plant.z < REST_HEIGHT_M - 0.0003, "it does not go down")
        process.process.send_signal(number)
        client.wait(lambda: process.process.poll() is not None, "it does not end")
        assert process.process.returncode == (-9 if number == signal.SIGKILL else 0), process.output
        client.spin(0.3)
        assert plant.deepest > REST_HEIGHT_M - DEPTH_M
        if number != signal.SIGKILL:
            assert "The replay was aborted: the node was asked to end" in process.output
            assert client.targets[-1].pose.position.z == plant.z
    finally:
        process.kill()
        client.node.destroy_node()


def test_after_an_abort_it_goes_back_on_request_and_the_recording_is_kept(
    unconfigured: Replayer, plant: Plant, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    active(unconfigured, press(10.0, 4.0), tmp_path, record=True, record_uri=str(bag))
    unconfigured.spin(1.0)
    assert not unconfigured.trigger("retract").success, "there is nothing to come back from"
    execute(unconfigured)
    unconfigured.wait(lambda: plant.z < REST_HEIGHT_M - 0.0006, "it does not go down")
    plant.extra_n = 20.0
    ended = unconfigured.until("succeeded", "aborted")
    assert "The force on pad_wrench is" in ended["detail"]
    deepest = plant.deepest
    assert unconfigured.trigger("retract").success
    back = unconfigured.until("retracted", "aborted")
    assert back["state"] == "retracted", back
    assert plant.z == pytest.approx(REST_HEIGHT_M, abs=1e-7)
    assert plant.deepest >= deepest - 2e-5, "it does not press on"
    assert unconfigured.change("deactivate")
    names, _ = topics_of(load_rig(RIG), read_recording(bag).provenance.message_counts)
    heights = read_recording(bag, names).target_poses["probe"].position[:, 2]
    assert heights.min() < REST_HEIGHT_M - 0.0005 and heights[-1] == pytest.approx(REST_HEIGHT_M, abs=1e-7)


class Between:
    """Passes on what ``sim_node`` reads, with faults."""

    def __init__(self, client: Client) -> None:
        from geometry_msgs.msg import PoseStamped, WrenchStamped

        publish = {
            "pose": client.node.create_publisher(PoseStamped, "/between/pose", 5),
            "wrench": client.node.create_publisher(WrenchStamped, "/between/wrench", 5),
        }
        self.silent: set[str] = set()
        self.offset_m = self.extra_n = 0.0

        def pose(message: Any) -> None:
            if "pose" not in self.silent:
                message.pose.position.z += self.offset_m
                publish["pose"].publish(message)

        def wrench(message: Any) -> None:
            if "wrench" not in self.silent:
                message.wrench.force.z -= self.extra_n
                publish["wrench"].publish(message)

        client.node.create_subscription(PoseStamped, "current_pose", pose, 5)
        client.node.create_subscription(WrenchStamped, "tactile/left/wrench", wrench, 5)


def warm_up(client: Replayer) -> None:
    """Touch the pad once: the physics compiles what it needs for a contact, which takes seconds."""
    client.wait(lambda: client.poses, "no pose", START_S)
    bottom = REST_HEIGHT_M - DEPTH_M
    client.aim(bottom)
    client.wait(lambda: abs(client.poses[-1].pose.position.z - bottom) < 1e-9, "it does not get down", START_S)
    client.spin(1.0)
    client.node.destroy_publisher(client._publishers.pop("target"))


@pytest.mark.slow
def test_random_faults_of_a_rig_simulated_in_a_second_process(simulator: NodeProcess, tmp_path: Path) -> None:
    """Five replays on ``sim_node``; after a fault it stands still, no deeper than it would have gone."""
    from std_srvs.srv import SetBool, Trigger

    given = {"rig": RIG, "dry_run": "false", "record": "false", **SLOW_PLANT}
    remaps = {"current_pose": "/between/pose", "tactile/left/wrench": "/between/wrench", "target_pose": "/target_pose"}
    process = NodeProcess("replay_node", tmp_path / "output", "/second", remaps=remaps, **given)
    client = Replayer(process, "/second")
    between = Between(client)
    write_trajectory(tmp_path / "t.json", press(6.0, 2.0))
    rng = random.Random(1)
    try:
        client.wait(lambda: client.statuses, f"no status: {process.output}", START_S)
        client.set(trajectory_uri=str(tmp_path / "t.json"))
        warm_up(client)
        for case in range(5):
            fault = ("none", "pose", "wrench", "jump", "force_step")[case]
            client.call(SetBool, "thinshell_sim/pause", SetBool.Request(data=False))
            assert client.call(Trigger, "thinshell_sim/reset", Trigger.Request()).success
            between.silent, between.offset_m, between.extra_n = set(), 0.0, 0.0
            client.wait(lambda: abs(client.poses[-1].pose.position.z - REST_HEIGHT_M) < 1e-9, "it is not back", START_S)
            assert client.change("configure"), process.output
            assert client.change("activate")
            client.targets.clear()
            execute(client)
            depth = rng.uniform(0.0001, 0.9 * DEPTH_M)
            below = REST_HEIGHT_M - depth
            client.wait(lambda below=below: client.poses[-1].pose.position.z < below, "no motion", START_S)
            between.silent = {fault} if fault in ("pose", "wrench") else set()
            between.offset_m = rng.choice([-0.02, 0.02]) if fault == "jump" else 0.0
            between.extra_n = rng.uniform(6.0, 20.0) if fault == "force_step" else 0.0
            ended = client.until("succeeded", "aborted")
            assert ended["state"] == ("succeeded" if fault == "none" else "aborted"), (fault, ended["detail"])
            client.spin(0.5)
            heights = [m.pose.position.z for m in client.targets]
            assert REST_HEIGHT_M - DEPTH_M - 1e-9 <= min(heights)
            assert max(heights) <= REST_HEIGHT_M + 1e-9
            if fault != "none":
                held = heights[-1]
                client.wait(lambda at=held: abs(client.poses[-1].pose.position.z - at) < 1e-9, "it moves on", START_S)
            assert client.change("deactivate")
            assert client.change("cleanup")
        assert process.stop() == 0, process.output
    finally:
        process.kill()
        client.node.destroy_node()


@pytest.mark.slow
@pytest.mark.parametrize("stiffer", [1.0, 1.3])
def test_a_simulated_rig_follows_a_predicted_motion_with_default_settings(
    ros: None, tmp_path: Path, stiffer: float
) -> None:
    """In simulated time, which a busy machine makes slow: the replay waits with it. Nothing of the guard is set. Of a
    pad that is stiffer than the predicted one the recording says where they part, and the node how to find out why."""
    rig = load_rig(RIG)
    bare = press(0.3, 0.6)
    trace = rollout(rig, bare.poses())
    trajectory = make_trajectory(rig, bare.poses(), limits=BOX, traces=[trace])
    assert trajectory.predicted.markers and trajectory.predicted.wrenches
    write_trajectory(tmp_path / "t.json", trajectory)
    modulus = stiffer * rig.bodies["pad"].material.E_pa
    (tmp_path / "plant.yaml").write_text(rig_to_yaml(with_parameters(rig, {"pad.E_pa": modulus})))
    place, bag = f"/by_default_{round(10 * stiffer)}", tmp_path / "bag"
    plant = NodeProcess("sim_node", tmp_path / "plant", place, rig=tmp_path / "plant.yaml", publish_clock="true")
    given = {"trajectory_uri": tmp_path / "t.json", "rig": RIG, "dry_run": "false", "record_uri": bag}
    process = NodeProcess("replay_node", tmp_path / "output", place, use_sim_time="true", **given)
    client = Replayer(process, place, place, place)
    try:
        client.wait(lambda: client.statuses, f"no status: {process.output}", START_S)
        client.wait(lambda: client.poses, f"no pose: {plant.output}", START_S)
        assert client.change("configure"), process.output
        assert client.change("activate"), process.output
        client.poses.clear()
        execute(client)
        ended = client.until("succeeded", "aborted")
        assert ended["state"] == "succeeded", ended["detail"]
        heights = np.array([m.pose.position.z for m in client.poses])
        assert heights.min() == pytest.approx(REST_HEIGHT_M - DEPTH_M, abs=5e-4)
        client.spin(0.5)
        assert process.stop() == 0, process.output
        assert plant.stop() == 0, plant.output
    finally:
        process.kill()
        plant.kill()
        client.node.destroy_node()
    run = load_run(rig, bag)
    if stiffer == 1.0:
        assert ended["watch"] == "as predicted" and not run.parted
        return
    ((begin, end),) = run.parted
    assert ended["watch"] != "as predicted"
    # It touches at 0.42 of the way down, and is 30 % too stiff until it is off again.
    lowest = run.poses["probe"].times[np.argmin(run.poses["probe"].positions[:, 2])]
    assert begin < lowest < end and 0.2 < end - begin < 1.5
    assert f"To find out why: thinshell diagnose {RIG} {bag} --out bag_diagnosis" in process.output
