"""Replays by a real ``replay_node`` on the plant of the guards' tests, in lockstep of simulated time, with one fault
each: a control period is 10 ms of /clock, and the next one comes when the node has commanded in this one. So it does
not matter how busy the machine is, and what the node could know in which period is known exactly.
"""

from __future__ import annotations

import math
import os
import random
import re
import signal
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from replay_plant import (
    CAUSES,
    FAULTS,
    PERIOD_S,
    SETTINGS,
    STEP_S,
    TRAJECTORY,
    Fault,
    Hand,
    Log,
    first_violation,
    height,
)
from ros_live import START_S, NodeProcess, is_alive
from ros_replayer import NODE, Replayer, execute
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from sim_core.errors import RecordingError
from sim_core.trajectories import write_trajectory
from sysid.recording import read_recording

PLACE = "/faults"
ANSWER_S = 3.0
"""Wall time that a command may take, on a machine that may be busy: where none comes, the node is silent."""
LIMITS = SETTINGS.limits
assert LIMITS.workspace_min_m is not None and LIMITS.workspace_max_m is not None
GIVEN = {
    "use_sim_time": "true", "dry_run": "false", "pose_timeout_s": SETTINGS.pose_timeout_s,
    "wrench_timeout_s": SETTINGS.wrench_timeout_s, "marker_timeout_s": SETTINGS.marker_timeout_s,
    "clock_tolerance_s": SETTINGS.clock_tolerance_s, "max_speed_m_s": LIMITS.max_speed_m_s,
    "max_force_n": LIMITS.max_force_n, "workspace_min_m": list(LIMITS.workspace_min_m),
    "workspace_max_m": list(LIMITS.workspace_max_m),
}  # fmt: skip

SIGNALS = {"sigint": signal.SIGINT, "sigterm": signal.SIGTERM, "sigkill": signal.SIGKILL}
ENDED = r"the node was asked to end"
KINDS = {
    **{kind: CAUSES.get(kind, "") for kind in FAULTS if kind not in ("clock_jump", "loop_stall", "commander_killed")},
    "pose_late": r"last reading of the pose of hand|stamp of the pose of hand|follows its commands",
    "clock_back": r"ROS clock jumped by -",
    "clock_ahead": r"ROS clock jumped by \d",
    "clock_gone": r"Nobody publishes /clock any more",
    "two_commanders": r"/intruder also publishes on /faults/target_pose",
    "sigint": ENDED,
    "sigterm": ENDED,
    "sigkill": "",
    "recorder_killed": "",
}
"""Kinds of faults, and what the sentence has to say where one ends a replay."""

UNSEEN = ("clock_gone", "two_commanders", *SIGNALS)
"""Faults of which the control periods do not tell when they can be known."""


def drawn(number: int, seed: int) -> tuple[Fault, random.Random]:
    """The fault of a number: all kinds in turn, from harmless to grave, at any time of the replay."""
    rng = random.Random(1_000_003 * seed + number)
    kind = list(KINDS)[number % len(KINDS)]
    fault = Fault.drawn(kind, rng)
    if kind == "pose_late":
        fault.size = rng.uniform(0.0, 0.3)
    elif kind == "clock_back":
        fault.size = -rng.uniform(0.02, 5.0)
    elif kind == "clock_ahead":
        fault.size = rng.uniform(600.0, 6000.0)  # it may catch up with the wall clock what it is behind
    elif kind in ("clock_gone", "two_commanders"):
        fault.at *= 0.3
    return fault, rng


@dataclass(frozen=True)
class Ended:
    """How a replay ended: with which ``state``, after how many commands that went on although a limit was
    ``exceeded``, whether it ended ``early``, whether its sentence ``names`` the cause, and what its recording lacks."""

    fault: Fault
    state: str
    reason: str
    exceeded: int
    early: bool
    names: bool
    lacks: str


class Lockstep:
    """The plant, on topics. A context manager, which ends its node."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._count = 0
        self._ros = 1000.0
        self._node: NodeProcess | None = None
        self._client: Replayer | None = None
        self._intruder: Any = None
        self._publish: dict[str, Any] = {}
        write_trajectory(folder / "press.json", TRAJECTORY)

    def __enter__(self) -> Lockstep:
        return self

    def __exit__(self, *_: object) -> None:
        self._end_node()

    def _end_node(self) -> None:
        if self._node is not None:
            self._node.kill()
        if self._client is not None:
            self._client.node.destroy_node()
        self._node = self._client = None

    def _begin_node(self) -> Replayer:
        if self._client is not None:
            return self._client
        given: dict[str, Any] = {**GIVEN, "trajectory_uri": self._folder / "press.json"}
        self._node = NodeProcess("replay_node", self._folder / f"output_{self._count}", PLACE, **given)
        self._client = client = Replayer(self._node, PLACE, PLACE, PLACE)
        from geometry_msgs.msg import PoseStamped, WrenchStamped
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import PointCloud2

        kinds = {"current_pose": PoseStamped, "wrench": WrenchStamped, "markers": PointCloud2, "/clock": Clock}
        self._publish = {topic: client.node.create_publisher(kind, topic, 20) for topic, kind in kinds.items()}
        client.wait(lambda: client.statuses, f"no status: {self._node.output}", START_S)
        return client

    def _give(self, kind: str, stamp_s: float, value: Any) -> None:
        """Publish a reading."""
        from thinshell_ros import clouds, messages
        from thinshell_ros.poses import Pose

        stamp = round(1e9 * stamp_s)
        if kind == "pose":
            pose = Pose(np.array([0.0, 0.0, value]), np.array([0.0, 0.0, 0.0, 1.0]))
            self._publish["current_pose"].publish(messages.pose(stamp, "base_link", pose))
        elif kind == "wrench":
            force, frame, _ = value
            self._publish["wrench"].publish(messages.wrench(stamp, frame, np.array([*force, 0.0, 0.0, 0.0])))
        else:
            left, places = value
            rest = TRAJECTORY.predicted.markers["gel"].positions_m[0]
            points = clouds.marker_points(places[:left], rest[:left], np.arange(left))
            self._publish["markers"].publish(messages.cloud(stamp, "pad", points))

    def _tell_time(self, ros_s: float) -> None:
        from rosgraph_msgs.msg import Clock

        stamp = Clock()
        stamp.clock.sec, stamp.clock.nanosec = divmod(round(1e9 * ros_s), 1_000_000_000)
        self._publish["/clock"].publish(stamp)
        self._ros = max(self._ros, ros_s)

    def replay(self, fault: Fault, rng: random.Random) -> Ended:
        """Replay the press with a fault, and look at what was commanded, said and recorded."""
        client, log = self._begin_node(), Log(fault.kind)
        assert self._node is not None
        hand, bag = Hand(fault, rng, log), self._folder / f"bag_{self._count}"
        log.latency = 0.0
        self._count += 1
        self._said = len(self._node.output)
        client.set(record_uri=str(bag))
        assert client.change("configure") and client.change("activate"), self._node.output
        base = self._ros + 1.0
        for number in range(-200, 0):
            hand.move(number * STEP_S)
            for kind, stamp, value in hand.sense(number * STEP_S, number * STEP_S):
                hand.note(stamp, kind, stamp, value)
                self._give(kind, base + stamp, value)
            if number % 10 == 0:
                self._tell_time(base + number * STEP_S)
                client.spin(0.005)
        self._tell_time(base)
        client.targets.clear()
        begun = len(client.statuses)
        self._execute(client, base)
        log.ticks.append((0.0, 0.0, 0.0, 0.0))
        self._go(client, hand, base, begun)
        return self._judged(client, hand, bag)

    def _execute(self, client: Replayer, base: float) -> None:
        """Begin, as soon as the recorder listens. Until then time stands still."""
        for _ in range(3):  # readings that came before the topics were known
            self._tell_time(base)
            client.spin(0.02)
        execute(client)

    def _go(self, client: Replayer, hand: Hand, base: float, begun: int) -> None:
        fault, log = hand.fault, hand.log
        late: list[tuple[float, tuple[str, float, Any]]] = []
        jump, ended_at = 0.0, math.inf
        for number in range(1, round(1.8 / PERIOD_S)):
            now = number * PERIOD_S
            if now > ended_at + 0.1:
                break
            if now >= fault.at:
                jump = fault.size if fault.kind in ("clock_back", "clock_ahead") else 0.0
                self._strike(fault, client)
            due = []
            for step in range(10):
                at = now - PERIOD_S + (step + 1) * STEP_S
                hand.move(at)
                late += [
                    (at + (fault.size if fault.kind == "pose_late" and r[0] == "pose" and fault.acts(at) else 0.0), r)
                    for r in hand.sense(at, at + jump)
                ]
            due = [reading for when, reading in late if when <= now]
            late = [one for one in late if one[0] > now]
            if not (fault.kind == "clock_gone" and now >= fault.at):
                self._tell_time(base + now + jump)
            for kind, stamp, value in due:
                hand.note(now + 0.1 * STEP_S, kind, stamp, value)
                self._give(kind, base + stamp, value)
            stamp = base + now + jump
            answered = self._answer(client, stamp, begun)
            if answered is not None:
                hand.command(now, answered)
            log.ticks.append((now + 0.2 * STEP_S, now + jump, answered, min(now, 1.0)))
            if math.isinf(ended_at):
                over = self._over(client, begun)
                moved_off = answered is not None and abs(answered - float(height(min(now, 1.0)))) > 1e-7
                if over or moved_off or (answered is None and fault.kind in SIGNALS):
                    ended_at = log.ended = log.ticks[-1][0]

    @staticmethod
    def _over(client: Replayer, begun: int) -> bool:
        return any(status.message in ("succeeded", "aborted") for status in client.statuses[begun:])

    def _answer(self, client: Replayer, stamp_s: float, begun: int) -> float | None:
        """What is commanded at a time or later; None where the node is silent, or has ended the replay."""
        end = time.monotonic() + ANSWER_S
        while time.monotonic() < end:
            if client.targets:
                last = client.targets[-1]
                at = last.header.stamp.sec + 1e-9 * last.header.stamp.nanosec
                if abs(at - stamp_s) < 1e-6 or any(
                    s.message in ("succeeded", "aborted") for s in client.statuses[begun:]
                ):
                    return float(last.pose.position.z)
            if self._node is not None and self._node.process.poll() is not None:
                return None
            client.spin(0.002)
        return None

    def _strike(self, fault: Fault, client: Replayer) -> None:
        """What a fault does besides the plant, once."""
        if fault.kind in SIGNALS and self._node is not None and self._node.process.poll() is None:
            self._node.process.send_signal(SIGNALS[fault.kind])
            self._node.process.wait(START_S)
        if fault.kind == "two_commanders" and self._intruder is None:
            import rclpy
            from geometry_msgs.msg import PoseStamped

            self._intruder = rclpy.create_node("intruder", namespace=PLACE)
            self._intruder.create_publisher(PoseStamped, "target_pose", 1)
        if fault.kind == "clock_gone" and "/clock" in self._publish:
            client.node.destroy_publisher(self._publish.pop("/clock"))
        if fault.kind == "recorder_killed" and self._node is not None:
            recorder = self._node.spawned()
            if recorder and is_alive(recorder):
                os.kill(recorder, signal.SIGKILL)

    def _judged(self, client: Replayer, hand: Hand, bag: Path) -> Ended:
        fault, log, node = hand.fault, hand.log, self._node
        assert node is not None
        if fault.kind in ("clock_gone", "two_commanders"):
            client.wait(lambda: client.statuses[-1].message in ("succeeded", "aborted"), node.output, START_S)
        if fault.kind in SIGNALS:
            found = re.search(r"The replay was aborted: (.*)", node.output[self._said :])
            state, reason = "aborted", found[1] if found else ""
        else:
            last = client.statuses[-1]
            state, reason = last.message, {pair.key: pair.value for pair in last.values}["detail"]
        heard = len(client.targets)
        if fault.kind in SIGNALS or fault.kind == "clock_gone":
            assert node.process.poll() is not None or node.stop() == 0, node.output
            client.wait(lambda: (bag / "metadata.yaml").exists(), f"no recording: {node.output}", START_S)
        else:
            assert client.change("deactivate") and client.change("cleanup"), node.output
        if self._intruder is not None:
            self._intruder.destroy_node()
            self._intruder = None
        assert "Traceback" not in node.output, node.output
        if fault.kind in SIGNALS or fault.kind in ("clock_gone", "recorder_killed"):
            self._end_node()
        names = state != "aborted" or re.search(KINDS[fault.kind] or "^$", reason) is not None
        return Ended(
            fault, state, reason, *_periods(log, fault, state), names, _lacks(bag, fault, heard, state, reason)
        )


def _periods(log: Log, fault: Fault, state: str) -> tuple[int, bool]:
    """How many commands went on with the plan after a limit was exceeded; whether it ended before one was.

    The clock and the readings of a period may be taken in either order: by one period a reading may look older.
    """
    if fault.kind in UNSEEN:
        return 0, False
    surely = perhaps = fault.at
    if fault.kind not in ("clock_back", "clock_ahead"):
        sooner = {f"{name}_timeout_s": getattr(SETTINGS, f"{name}_timeout_s") for name in ("pose", "wrench", "marker")}
        strict = replace(SETTINGS, **{name: value - PERIOD_S for name, value in sooner.items()})
        surely, perhaps = first_violation(log, SETTINGS, 0.03), first_violation(log, strict, -0.03)
    planned = [float(height(np.array(min(t, 1.0)))) for *_, t in log.ticks]
    went_on = [
        abs(plan - before) > 1e-7 and commanded is not None and abs(commanded - plan) < 1e-7
        for before, plan, (_, _, commanded, _) in zip(planned, planned[1:], log.ticks[1:], strict=False)
    ]
    after = sum(moved for moved, (t, *_) in zip(went_on, log.ticks[1:], strict=True) if t > surely)
    return after, state == "aborted" and log.ended < perhaps


def _lacks(bag: Path, fault: Fault, commands: int, state: str, reason: str) -> str:
    """What the recording lacks of what it should hold, '' if nothing."""
    if fault.kind == "recorder_killed":  # what was on disk by then, which it is every second, can be read
        try:
            read_recording(bag)
        except RecordingError as error:
            return "" if "holds no measurement" in str(error) else str(error)
        return ""
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        found = sum(c.msgcount for c in reader.connections if c.topic == f"{PLACE}/target_pose")
        status = [c for c in reader.connections if c.topic == f"{PLACE}/{NODE}/status"]
        messages = (reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(connections=status))
        values = {pair.value for message in messages for pair in message.values}
    if found < 0.98 * commands:
        return f"{commands - found} of {commands} commands"
    return "why it was aborted" if state == "aborted" and reason and reason not in values else ""


def table(ends: list[Ended]) -> str:
    """One line for each kind."""
    lines = [
        "| fault | replays | aborted | periods late, at most | sentence names the cause | recording kept |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for kind in KINDS:
        those = [end for end in ends if end.fault.kind == kind]
        if those:
            aborted = [end for end in those if end.state == "aborted"]
            named = f"{sum(end.names for end in aborted)} of {len(aborted)}" if aborted and KINDS[kind] else ""
            late, kept = max(end.exceeded for end in those), sum(not end.lacks for end in those)
            lines.append(f"| {kind} | {len(those)} | {len(aborted)} | {late} | {named} | {kept} |")
    return "\n".join(lines)
