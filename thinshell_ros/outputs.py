"""The topics that a simulated rig publishes, and the time that their stamps are in."""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, PointCloud2
from visualization_msgs.msg import Marker

from sim_core.rigs import OrthographicCamera, Rig
from thinshell_ros import clouds, messages, protocol
from thinshell_ros.marker_images import MarkerImages
from thinshell_ros.poses import Floats, Pose
from thinshell_ros.qos import EVENTS, LATCHED, LATEST, PICTURES, STREAM, overridable
from thinshell_ros.sampling import Reading
from thinshell_ros.streams import EVENT_TOPIC, Channel, rest_topic
from thinshell_ros.tare import Tare

_TYPES = {
    "pose": PoseStamped,
    "wrench": WrenchStamped,
    "contact": WrenchStamped,
    "markers": PointCloud2,
    "tracks": PointCloud2,
    "mesh": Marker,
}

CLOCK_S, LEAST_S = 0.005, 0.001
"""Period [s] of /clock, and the shortest time between two looks at what is due."""

SKIP_S = 0.02
"""Time [s] left out at once that is worth an event."""


class Outputs:
    """Publishers of all channels of a rig, of the rest states of its markers, of what happened to them, and of /clock.

    A stamp is the wall time at which the simulation began plus simulated time. Without /clock, stamps follow the wall
    clock: what simulated time falls behind is left out as soon as it keeps up again (:class:`Pacer`), which is an
    event. With /clock, stamps are in the time that it tells, which stands still when the simulation does.
    """

    def __init__(
        self,
        node: Node,
        rig: Rig,
        channels: Mapping[str, Channel],
        give_clock: bool,
        factor: float = 1.0,
        pictures: bool = False,
    ) -> None:
        """``factor``: simulated time per wall time, 0 for as fast as it can; ``pictures``: of what cameras see, too."""
        self._channels = channels
        self._hardware = rig.name
        self._name = node.get_fully_qualified_name()
        self._factor = factor
        self._step_s = rig.solver.dt_s
        self._tare = Tare(channels)
        self._ids: dict[str, Any] = {}
        self._epoch_ns = self._now_ns = self._clock_ns = 0
        self._skipped_s = 0.0
        self._last = (0.0, 0.0)
        self._held: list[tuple[float, int, Reading]] = []
        self._order = 0
        self._due = dict.fromkeys(channels, 0.0)
        self._cameras = {n: c for n, c in rig.cameras.items() if not isinstance(c, OrthographicCamera)}

        def stream(kind: Any, topic: str, profile: QoSProfile = STREAM) -> Publisher:
            return node.create_publisher(kind, topic, **overridable(profile))

        self._streams = {name: stream(_TYPES[c.kind], c.topic) for name, c in channels.items()}
        self._infos = {n: stream(CameraInfo, c.topics.camera_info) for n, c in self._cameras.items()}
        shown = self._cameras if pictures else {}
        self._pictures = {
            n: MarkerImages(c, partial(stream, topic=c.topics.image, profile=PICTURES)) for n, c in shown.items()
        }
        self._rests = {
            name: node.create_publisher(PointCloud2, rest_topic(channel), LATCHED)
            for name, channel in channels.items()
            if channel.kind == "markers"
        }
        self._events = node.create_publisher(DiagnosticArray, EVENT_TOPIC, EVENTS)
        self._clock = node.create_publisher(Clock, "/clock", LATEST) if give_clock else None

    def use(self, rig: Rig, channels: Mapping[str, Channel]) -> None:
        """Publish for another rig, of the same channels, from now on."""
        self.flush()
        self._hardware, self._channels = rig.name, channels
        self._step_s = rig.solver.dt_s
        self._cameras = {n: c for n, c in rig.cameras.items() if not isinstance(c, OrthographicCamera)}

    def begin(self, answer: protocol.Ready) -> None:
        """Simulated time 0 is now; stamps go on even after another simulation."""
        self.flush()
        self._ids = answer.ids
        self._epoch_ns = max(time.time_ns(), self._now_ns + 1_000_000, self._clock_ns)
        self._now_ns, self._skipped_s, self._last = self._epoch_ns, 0.0, (time.monotonic(), 0.0)
        self.restart(answer.rest)

    def restart(self, rest: Mapping[str, Floats]) -> None:
        """The state is at the start, where the readings are ``rest``: a tare is taken back."""
        self.flush()
        self._tare.restart(rest)
        self._publish_rest()
        words = "The state is back at the start, and the readings are not tared any more."
        self.tell("reset", words, {"poses": "exact"})

    def zero(self) -> list[str]:
        """Tare; returns the channels that cannot be, for lack of a reading."""
        missing = self._tare.zero(1e-9 * self._now_ns)
        self._publish_rest()
        wrenches = [n for n, c in self._channels.items() if c.kind == "wrench" and n not in missing]
        values = {self._streams[n].topic_name: " ".join(f"{v:.9g}" for v in self._tare.offset(n)) for n in wrenches}
        self.tell("tare", "Readings with later stamps are less the values given here [N, N m].", values)
        return missing

    def tell(self, name: str, message: str, values: Mapping[str, str] | None = None) -> None:
        """Publish an event at the stamp of the last reading."""
        event = messages.event(self._now_ns, self._name, self._hardware, name, message, values or {})
        self._events.publish(event)

    def take(self, batch: protocol.Batch, arrival: float, at_once: bool) -> float:
        """Readings of a step that came at wall time ``arrival`` [s], to be published when they are due, or at once.
        Returns what stamps have left out of the wall clock's time [s]."""
        left_out = batch.skipped_s - self._skipped_s if self._clock is None else 0.0
        if left_out:
            self.flush()
            self._skipped_s = batch.skipped_s
        self._last = arrival, batch.simulated_s
        paced = self._factor > 0.0 and not at_once
        for reading in batch.readings:
            due = arrival + max(reading.release_s - batch.simulated_s, 0.0) / self._factor if paced else arrival
            due = self._due[reading.channel] = max(due, self._due[reading.channel])  # a step may come early
            self._order += 1
            heapq.heappush(self._held, (due, self._order, reading))
        self.publish(arrival)
        if left_out > SKIP_S:
            words = f"Stamps leave out {left_out:.3f} s in which the simulation did not go on."
            self.tell("skip", words, {"left_out_s": f"{left_out:.6g}"})
        return left_out

    def publish(self, now: float, running: bool = False) -> None:
        """Publish what is due at wall time ``now`` [s]. ``running``: simulated time goes on at present."""
        if self._clock is not None and self._epoch_ns:
            self._publish_clock(now, running)
        while self._held and self._held[0][0] <= now:
            self._publish(heapq.heappop(self._held)[2])

    def due_in_s(self, now: float, running: bool) -> float:
        """Time [s] after which something is due again; infinite where nothing is held back. Arguments as of
        :meth:`publish`."""
        due = max(self._held[0][0] - now, LEAST_S) if self._held else math.inf
        return min(due, CLOCK_S) if self._clock is not None and running else due

    def _publish_clock(self, now: float, running: bool) -> None:
        """/clock goes on until the end of the step that is being made; it never goes back."""
        assert self._clock is not None
        arrival, simulated = self._last
        ahead = min(max(now - arrival, 0.0) * self._factor, self._step_s) if running else 0.0
        stamp = self._stamp(simulated + ahead)
        if stamp > self._clock_ns:
            self._clock_ns = stamp
            self._clock.publish(messages.clock(stamp))

    def flush(self) -> None:
        """Publish all that is held back."""
        self.publish(float("inf"))

    def _publish(self, reading: Reading) -> None:
        name = reading.channel
        self._tare.take(name, reading.values)
        stamp = self._stamp(reading.stamp_s)
        self._now_ns = max(self._now_ns, stamp)
        self._streams[name].publish(self._message(reading, stamp))
        if name in self._cameras:
            frame = self._channels[name].frame_id
            self._infos[name].publish(messages.camera_info(stamp, frame, self._cameras[name]))
        if name in self._pictures:
            self._pictures[name].publish(stamp, self._channels[name].frame_id, reading.values)

    def _stamp(self, simulated_s: float) -> int:
        return self._epoch_ns + round((simulated_s + self._skipped_s) * 1e9)

    def _message(self, reading: Reading, stamp: int) -> Any:
        channel, values = self._channels[reading.channel], reading.values
        frame, name = channel.frame_id, channel.name
        if channel.kind == "pose":
            return messages.pose(stamp, frame, Pose.of(values))
        if channel.kind == "mesh":
            return messages.mesh(stamp, frame, name, values[self._ids[name]].reshape(-1, 3))
        if channel.kind == "contact":
            return messages.wrench(stamp, frame, values)
        if channel.kind == "wrench":
            return messages.wrench(stamp, frame, values - self._tare.offset(name, 1e-9 * stamp))
        if channel.kind == "markers":
            offset = self._tare.offset(name, 1e-9 * stamp)
            points = clouds.marker_points(values, offset, self._ids[name])
        else:
            points = clouds.track_points(values, self._ids[name])
        return messages.cloud(stamp, frame, points)

    def _publish_rest(self) -> None:
        for name, publisher in self._rests.items():
            at, frame = self._tare.offset(name), self._channels[name].frame_id
            points = clouds.marker_points(at, at, self._ids[name])
            publisher.publish(messages.cloud(self._now_ns, frame, points))
