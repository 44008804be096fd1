"""A trajectory that a node has been configured with: its check, its topics, its recording, and its replays."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNode

from sim_core.errors import ConfigError
from sim_core.rigs import load_rig
from sim_core.trajectories import bounded, read_trajectory
from thinshell_ros import graph, messages
from thinshell_ros.health import Report
from thinshell_ros.qos import EVENTS
from thinshell_ros.replay.messages import from_message
from thinshell_ros.replay.recording import Recording
from thinshell_ros.replay.session import Session, checked
from thinshell_ros.replay.streams import Instant
from thinshell_ros.replay.topics import Topics, marker_topics, wrench_topics
from thinshell_ros.replay.watch import Alarm
from thinshell_ros.replay_parameters import ReplayParameters
from thinshell_ros.streams import EVENT_TOPIC


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
        offered_one = read_trajectory(given.trajectory_uri) if given.trajectory_uri else from_message(offered)
        trajectory = bounded(offered_one, self._rig)
        review = checked(trajectory, given.guard, given.speed_scale, self._rig)
        wrenches = wrench_topics(trajectory, self._rig) if given.guard_wrench else {}
        markers = marker_topics(trajectory) if given.guard_markers else {}
        step_s = None if self._rig is None else self._rig.solver.dt_s
        self.session = Session(
            trajectory, given.guard, list(wrenches), given.speed_scale, list(markers), given.watch_aborts, step_s
        )
        self.end_effectors = ", ".join(trajectory.end_effectors)
        self._moves = given.guard.moves
        self._topics = Topics(node, trajectory, self.session, wrenches, markers, self._now)
        self._recording: Recording | None = None
        self._timer: Any = None
        self._events = node.create_publisher(DiagnosticArray, EVENT_TOPIC, EVENTS)
        self._alarmed = False
        self._parted: Alarm | None = None
        for text in (*review.warnings, *self.session.watch.notes()):
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
        if recording is None:
            return ""
        recorded = recording.stop()
        if self._parted is not None and self._given.rig:
            command = f"thinshell diagnose {self._given.rig} {recording.bag} --out {recording.bag.name}_diagnosis"
            recorded += f" A replay in it parted from its prediction. To find out why: {command}"
        return recorded

    def destroy(self) -> None:
        """Take its topics away."""
        self._topics.destroy()
        self._node.destroy_publisher(self._events)

    def _on_period(self) -> None:
        if self.session.moving and self._moves and (others := self._others()):
            self.abort(others)
            return
        before = self.session.state
        commanded = self.session.tick(self._now())
        if commanded is not None:
            self._topics.command(commanded, self.session.setpoints.closings(self.session.time_s))
        alarm = self.session.watch.alarm
        if alarm is not None and not self._alarmed:
            self._alarmed = True
            self._node.get_logger().warning(alarm.text)
            self._on_end()
        if self.session.state != before:
            self._ended()

    def _ended(self) -> None:
        state = self.session.state
        if state in ("succeeded", "retracted"):
            done = "The replay succeeded." if state == "succeeded" else "The end effectors are back where they wait."
            self._node.get_logger().info(done)
        else:
            self._node.get_logger().error(f"The replay was aborted: {self.session.reason}")
        alarm = self.session.watch.alarm
        if alarm is not None and alarm != self._parted:
            self._tell_window(alarm)
        self._on_end()

    def _tell_window(self, alarm: Alarm) -> None:
        """An event for the recording: where readings were not as predicted."""
        self._parted, name = alarm, self._node.get_fully_qualified_name()
        values = {"lasts_s": f"{alarm.until_s - alarm.stamp_s:.6f}", "sensor": alarm.sensor}
        stamp = round(1e9 * alarm.stamp_s)
        self._events.publish(messages.event(stamp, name, self.end_effectors, "parted", alarm.text, values))

    def execute(self) -> tuple[bool, str]:
        """Begin a replay; returns whether it has begun, and what is happening or why not."""
        if reason := self._unready():
            return False, reason
        if reason := self.session.execute(self._now()):
            return False, reason
        self._alarmed = False
        return True, "moving" if self._moves else "dry run: nothing is commanded; set dry_run to false to move"

    def retract(self) -> tuple[bool, str]:
        """Begin to go back; returns whether it has begun, and what is happening or why not."""
        reason = self._unready() or self.session.retract(self._now())
        return (False, reason) if reason else (True, "going back")

    def _unready(self) -> str:
        """Why nothing may be commanded, '' if it may."""
        if self._timer is None:
            return "The node is not active: activate it first."
        if self._moves and (others := self._others()):
            return f"{others} Stop it first."
        recorder = "" if self._recording is None else self._recording.name
        if self._moves and (unheard := self._topics.unheard(recorder)):
            return f"Nobody listens to {', '.join(unheard)}. Start the controller, or remap the topic."
        if recorder and (unrecorded := self._topics.unrecorded(recorder)):
            return f"Not recorded yet: {', '.join(unrecorded)}. Wait a moment, or set record to false."
        return ""

    def abort(self, reason: str) -> bool:
        """Hold now and not in the next period; returns whether a replay was running."""
        if not self.session.abort(self._now(), reason):
            return False
        self._topics.command(self.session.commanded, {})
        self._ended()
        return True

    def watch(self) -> list[Report]:
        """Abort where the simulation has ended; returns the state and that of the recording."""
        clock = self._node.resolve_topic_name("/clock")
        if self.session.moving and self._given.guard.simulated_time and not self._node.count_publishers(clock):
            self.abort(f"Nobody publishes {clock} any more: the simulation has ended.")
        reports = [self.session.report()]
        if self._recording is not None and (fault := self._recording.fault()):
            reports.append(Report("recording", "error", fault))
        return reports

    def _others(self) -> str:
        """Who else commands the same end effectors, in words."""
        others = graph.other_publishers(self._node, list(self._topics.targets.values()))
        return " ".join(f"{', '.join(nodes)} also publishes on {topic}." for topic, nodes in others.items())
