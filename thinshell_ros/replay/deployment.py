"""A trajectory that a node has been configured with: its check, its topics, its recording, and its replays."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNode

from sim_core.errors import ConfigError
from sim_core.rigs import load_rig
from sim_core.trajectories import read_trajectory
from thinshell_ros import graph
from thinshell_ros.health import Report
from thinshell_ros.replay.guard import Instant
from thinshell_ros.replay.messages import from_message
from thinshell_ros.replay.recording import Recording
from thinshell_ros.replay.session import Session, checked
from thinshell_ros.replay.topics import Topics, wrench_topics
from thinshell_ros.replay_parameters import ReplayParameters


class Deployment:
    """Made by configure. ``on_end``: called when a replay has ended, before the next command."""

    def __init__(self, node: LifecycleNode, offered: Any, on_end: Callable[[], object]) -> None:
        """``offered``: the last message on ``~/trajectory``, for where no file is named.

        Raises:
            ThinshellError: there is no trajectory, or it must not be replayed.
        """
        self._node, self._on_end = node, on_end
        self._given = given = ReplayParameters.read(node)
        self._rig = load_rig(given.rig) if given.rig else None
        if not given.trajectory_uri and offered is None:
            raise ConfigError("There is no trajectory.", "Set trajectory_uri, or publish one on ~/trajectory.")
        trajectory = read_trajectory(given.trajectory_uri) if given.trajectory_uri else from_message(offered)
        review = checked(trajectory, given.guard, given.speed_scale, self._rig)
        sensors = wrench_topics(trajectory, self._rig) if given.guard_wrench else {}
        self.session = Session(trajectory, given.guard, list(sensors), given.speed_scale)
        self.end_effectors = ", ".join(trajectory.end_effectors)
        self._moves = given.guard.moves
        self._topics = Topics(node, trajectory, self.session.guard, sensors, self._now)
        self._recording: Recording | None = None
        self._timer: Any = None
        for text in review.warnings:
            node.get_logger().warning(text)
        node.get_logger().info(f"The trajectory may be replayed. {'; '.join(map(str, review.figures))}.")

    def _now(self) -> Instant:
        return Instant(time.monotonic(), self._node.get_clock().now().nanoseconds * 1e-9)

    def activate(self) -> None:
        """Begin to record and to run the control loop. Raises ``ConfigError`` where the bag exists."""
        if self._given.record:
            topics, rig = self._topics.recorded(self._rig), self._given.rig
            self._recording = Recording(self._node, topics, rig, self._given.record_uri)
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self._node.create_timer(self._given.guard.period_s, self._on_period, clock=wall)

    def deactivate(self, reason: str) -> str:
        """Hold if it moves, and finish the recording; returns what became of that."""
        self.abort(reason)
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
        recording, self._recording = self._recording, None
        return "" if recording is None else recording.stop()

    def destroy(self) -> None:
        """Take its topics away."""
        self._topics.destroy()

    def _on_period(self) -> None:
        before = self.session.state
        commanded = self.session.tick(self._now())
        if commanded is not None:
            self._topics.command(commanded, self.session.setpoints.closings(self.session.time_s))
        if self.session.state != before:
            self._ended()

    def _ended(self) -> None:
        if self.session.state == "succeeded":
            self._node.get_logger().info("The replay succeeded.")
        else:
            self._node.get_logger().error(f"The replay was aborted: {self.session.reason}")
        self._on_end()

    def execute(self) -> tuple[bool, str]:
        """Begin a replay; returns whether it has begun, and what is happening or why not."""
        if self._timer is None:
            return False, "The node is not active: activate it first."
        if self._moves and (others := self._others()):
            return False, f"{others} Stop it first."
        recorder = "" if self._recording is None else self._recording.name
        if self._moves and (unheard := self._topics.unheard(recorder)):
            return False, f"Nobody listens to {', '.join(unheard)}. Start the controller, or remap the topic."
        if recorder and (unrecorded := self._topics.unrecorded(recorder)):
            return False, f"Not recorded yet: {', '.join(unrecorded)}. Wait a moment, or set record to false."
        if reason := self.session.execute(self._now()):
            return False, reason
        return True, "moving" if self._moves else "dry run: nothing is commanded; set dry_run to false to move"

    def abort(self, reason: str) -> bool:
        """Hold now and not in the next period; returns whether a replay was running."""
        if not self.session.abort(self._now(), reason):
            return False
        self._topics.command(self.session.commanded, {})
        self._ended()
        return True

    def watch(self) -> list[Report]:
        """Abort where somebody else commands the end effectors too; returns the state and that of the recording."""
        if self.session.state == "running" and self._moves and (others := self._others()):
            self.abort(others)
        reports = [self.session.report()]
        if self._recording is not None and (fault := self._recording.fault()):
            reports.append(Report("recording", "error", fault))
        return reports

    def _others(self) -> str:
        """Who else commands the same end effectors, in words."""
        others = graph.other_publishers(self._node, list(self._topics.targets.values()))
        return " ".join(f"{', '.join(nodes)} also publishes on {topic}." for topic, nodes in others.items())
