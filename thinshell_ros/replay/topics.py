"""The topics of a replay: readings into the guard, commands out of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from nav_msgs.msg import Path
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64

from sim_core.rigs import Rig, WrenchSensor
from sim_core.trajectories import Trajectory
from thinshell_ros import messages
from thinshell_ros.clouds import marker_positions
from thinshell_ros.graph import subscribers
from thinshell_ros.poses import Pose
from thinshell_ros.qos import LATCHED, LATEST, READINGS, overridable
from thinshell_ros.replay.messages import path_of
from thinshell_ros.replay.session import Session
from thinshell_ros.replay.streams import Instant
from thinshell_ros.replay.tracking import Placed
from thinshell_ros.streams import EVENT_TOPIC, topics_to_record


def wrench_topics(trajectory: Trajectory, rig: Rig | None) -> dict[str, str]:
    """Topics of the wrenches to guard, by sensor: those that the trajectory predicts, or that the rig has, or one."""
    predicted = {name: wrench.topic for name, wrench in trajectory.predicted.wrenches.items()}
    sensors = {} if rig is None else {n: s.topic for n, s in rig.sensors.items() if isinstance(s, WrenchSensor)}
    return predicted or sensors or {"wrench": "wrench"}


def marker_topics(trajectory: Trajectory) -> dict[str, str]:
    """Topics of the markers to guard, by sensor: those that the trajectory predicts."""
    return {name: markers.topic for name, markers in trajectory.predicted.markers.items()}


class Topics:
    """Publishers and subscriptions for one trajectory. ``now``: the time by both clocks."""

    def __init__(
        self,
        node: LifecycleNode,
        trajectory: Trajectory,
        session: Session,
        wrenches: Mapping[str, str],
        markers: Mapping[str, str],
        now: Callable[[], Instant],
    ) -> None:
        """``wrenches``, ``markers``: topics of the sensors that are guarded, by sensor."""
        self._node, self._session, self._now = node, session, now
        self._frames = {name: path.frame_id for name, path in trajectory.end_effectors.items()}
        moves, several = session.guard.settings.moves, len(trajectory.end_effectors) > 1
        self.targets: dict[str, str] = {}
        """Topic of the commanded poses of each end effector; a private one in a dry run."""
        self._publishers: dict[str, Any] = {}
        self._closings: dict[str, Any] = {}
        self._paths: list[Any] = []
        self._subscriptions: list[Any] = []
        self.readings: list[str] = []
        """Topics of what is measured."""

        def publisher(kind: Any, topic: str) -> Any:
            return node.create_lifecycle_publisher(kind, topic, **overridable(LATEST))

        for name, path in trajectory.end_effectors.items():
            apart = f"{name}/" if several else ""
            self.targets[name] = path.target_topic if moves else f"~/dry_run/{apart}target_pose"
            self._publishers[name] = publisher(PoseStamped, self.targets[name])
            if path.gripper_closing_m is not None:
                topic = f"{'' if moves else '~/dry_run/'}{apart}gripper_closing"
                self._closings[name] = publisher(Float64, topic)
            self._subscribe(PoseStamped, path.current_topic, partial(self._on_pose, name))
            shown = node.create_publisher(Path, f"~/{apart}path", LATCHED)
            stamp = node.get_clock().now().nanoseconds
            shown.publish(path_of(stamp, path.frame_id, trajectory.poses()[name]))
            self._paths.append(shown)
        for name, topic in wrenches.items():
            self._subscribe(WrenchStamped, topic, partial(self._on_wrench, name))
        for name, topic in markers.items():
            self._subscribe(PointCloud2, topic, partial(self._on_markers, name))

    def _subscribe(self, kind: Any, topic: str, take: Callable[[Any], None]) -> None:
        self.readings.append(topic)
        heard = self._node.create_subscription(kind, topic, callback=take, **overridable(READINGS))
        self._subscriptions.append(heard)

    def _on_pose(self, name: str, message: PoseStamped) -> None:
        p, q, header = message.pose.position, message.pose.orientation, message.header
        pose = Placed((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
        self._session.take_pose(name, self._now(), _seconds(header.stamp), header.frame_id, pose)

    def _on_wrench(self, name: str, message: WrenchStamped) -> None:
        f, t = message.wrench.force, message.wrench.torque
        stamp = _seconds(message.header.stamp)
        frame = message.header.frame_id
        self._session.take_wrench(name, self._now(), stamp, frame, (f.x, f.y, f.z), (t.x, t.y, t.z))

    def _on_markers(self, name: str, message: PointCloud2) -> None:
        stamp, frame = _seconds(message.header.stamp), message.header.frame_id
        layout = {field.name: (field.offset, field.datatype) for field in message.fields}
        ids, positions = marker_positions(bytes(message.data), message.point_step, layout)
        self._session.take_markers(name, self._now(), stamp, frame, ids, positions)

    def command(self, poses: Mapping[str, Placed], closings: Mapping[str, float]) -> None:
        """Publish what is commanded now."""
        stamp = self._node.get_clock().now().nanoseconds
        for name, pose in poses.items():
            values = Pose(np.array(pose.position), np.array(pose.quaternion))
            self._publishers[name].publish(messages.pose(stamp, self._frames[name], values))
        for name, closing in closings.items():
            self._closings[name].publish(Float64(data=closing))

    def unheard(self, recorder: str) -> list[str]:
        """Topics of commanded poses that nobody listens to but the recorder, a node of that name."""
        topics = list(self.targets.values())
        return [topic for topic in topics if not set(subscribers(self._node, topic)) - {recorder}]

    def unrecorded(self, recorder: str) -> list[str]:
        """Topics of readings that the recorder does not listen to yet."""
        return [topic for topic in self.readings if recorder not in subscribers(self._node, topic)]

    def recorded(self, rig: Rig | None) -> list[str]:
        """Full names of what a recording of a replay holds: commands, what is measured, where it parts from its
        prediction, and what the rig has."""
        own = [
            *self.targets.values(),
            *self.readings,
            *(p.topic_name for p in self._closings.values()),
            "~/status",
            EVENT_TOPIC,
        ]
        others = [] if rig is None else [topic.name for topic in topics_to_record(rig)]
        return [self._node.resolve_topic_name(topic) for topic in (*own, *others)]

    def destroy(self) -> None:
        """Take all of them away."""
        for publisher in (*self._publishers.values(), *self._closings.values()):
            self._node.destroy_lifecycle_publisher(publisher)
        for shown in self._paths:
            self._node.destroy_publisher(shown)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + 1e-9 * stamp.nanosec)
