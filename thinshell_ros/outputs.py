"""The topics that a simulated rig publishes, and the time that their stamps are in."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, PointCloud2

from sim_core.rigs import OrthographicCamera, Rig
from thinshell_ros import clouds, messages, physics
from thinshell_ros.poses import Floats, Pose
from thinshell_ros.qos import LATCHED, LATEST, STREAM
from thinshell_ros.sampling import Reading
from thinshell_ros.streams import Channel, rest_topic
from thinshell_ros.tare import Tare

_TYPES = {"pose": PoseStamped, "wrench": WrenchStamped, "markers": PointCloud2, "tracks": PointCloud2}


class Outputs:
    """Publishers of all channels of a rig, of the rest states of its markers, and of /clock.

    A stamp is the wall time at which the simulation began plus simulated time: where the simulation is
    slower than real time, stamps fall behind the wall clock and never jump.
    """

    def __init__(self, node: Node, rig: Rig, channels: Mapping[str, Channel], give_clock: bool) -> None:
        self._channels = channels
        self._tare = Tare(channels)
        self._ids: dict[str, Any] = {}
        self._epoch_ns = self._now_ns = 0
        self._cameras = {n: c for n, c in rig.cameras.items() if not isinstance(c, OrthographicCamera)}

        def stream(kind: Any, topic: str) -> Publisher:
            overridable = QoSOverridingOptions.with_default_policies()
            return node.create_publisher(kind, topic, STREAM, qos_overriding_options=overridable)

        self._streams = {name: stream(_TYPES[c.kind], c.topic) for name, c in channels.items()}
        self._infos = {n: stream(CameraInfo, c.topics.camera_info) for n, c in self._cameras.items()}
        self._rests = {
            name: node.create_publisher(PointCloud2, rest_topic(channel), LATCHED)
            for name, channel in channels.items()
            if channel.kind == "markers"
        }
        self._clock = node.create_publisher(Clock, "/clock", LATEST) if give_clock else None

    def begin(self, answer: physics.Ready) -> None:
        """Simulated time 0 is now; stamps go on even after another simulation."""
        self._ids = answer.ids
        self._epoch_ns = max(time.time_ns(), self._now_ns + 1_000_000)
        self._now_ns = self._epoch_ns
        self.restart(answer.rest)

    def restart(self, rest: Mapping[str, Floats]) -> None:
        """The state is at the start, where the readings are ``rest``: a tare is taken back."""
        self._tare.restart(rest)
        self._publish_rest()

    def zero(self) -> list[str]:
        """Tare; returns the channels that cannot be, for lack of a reading."""
        missing = self._tare.zero()
        self._publish_rest()
        return missing

    def publish(self, batch: physics.Batch) -> None:
        """Publish what became due in a step."""
        self._now_ns = self._stamp(batch.simulated_s)
        if self._clock is not None:
            self._clock.publish(messages.clock(self._now_ns))
        for reading in batch.readings:
            name = reading.channel
            self._tare.take(name, reading.values)
            self._streams[name].publish(self._message(reading))
            if name in self._cameras:
                stamp, frame = self._stamp(reading.stamp_s), self._channels[name].frame_id
                self._infos[name].publish(messages.camera_info(stamp, frame, self._cameras[name]))

    def _stamp(self, simulated_s: float) -> int:
        return self._epoch_ns + round(simulated_s * 1e9)

    def _message(self, reading: Reading) -> Any:
        channel, values = self._channels[reading.channel], reading.values
        stamp, frame, name = self._stamp(reading.stamp_s), channel.frame_id, channel.name
        if channel.kind == "pose":
            return messages.pose(stamp, frame, Pose.of(values))
        if channel.kind == "wrench":
            return messages.wrench(stamp, frame, values - self._tare.offset(name))
        if channel.kind == "markers":
            points = clouds.marker_points(values, self._tare.offset(name), self._ids[name])
        else:
            points = clouds.track_points(values, self._ids[name])
        return messages.cloud(stamp, frame, points)

    def _publish_rest(self) -> None:
        for name, publisher in self._rests.items():
            at, frame = self._tare.offset(name), self._channels[name].frame_id
            points = clouds.marker_points(at, at, self._ids[name])
            publisher.publish(messages.cloud(self._now_ns, frame, points))
