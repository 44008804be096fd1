"""``record_node``: named topics into an MCAP bag that follows the bag contract.

Messages are taken as they are on the wire and never decoded. Each topic is asked for in the strongest
quality of service that all its publishers offer, so that nothing is lost that need not be and latched
messages come along.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from sim_core.errors import ConfigError, RecordingError
from sim_core.rigs import load_rig, rig_to_yaml
from thinshell_ros import messages
from thinshell_ros.bagfile import BagFile
from thinshell_ros.health import recording_report
from thinshell_ros.losses import Losses
from thinshell_ros.parameters import declare, warn_of_unknown
from thinshell_ros.runner import FinishingNode, run_and_finish
from thinshell_ros.streams import RecordedTopic, topics_to_record

QUEUE = 1000
"""Messages of a topic that may wait for the disk."""


class RecordNode(FinishingNode):
    """Records from its start until SIGINT or SIGTERM."""

    def __init__(self) -> None:
        super().__init__("recorder")
        rig_name = declare(self, "rig", "", "rig whose topics are recorded: a name or a YAML file")
        named = declare(self, "topics", Parameter.Type.STRING_ARRAY, "topics to record, besides the rig's")
        uri = declare(self, "uri", "", "bag to create; empty: recording_<date>_<time> in the working folder")
        size = declare(self, "max_size_mb", 0, "size of a file after which another begins; 0: none", bounds=(0, 10**6))
        span = declare(self, "max_duration_s", 0.0, "length of a file, likewise; 0: none", bounds=(0.0, 1e6))
        warn_of_unknown(self)
        topics = [RecordedTopic(name) for name in named or []]
        notes = {}
        if rig_name:
            rig = load_rig(rig_name)
            topics += topics_to_record(rig)
            notes["rig"] = rig_to_yaml(rig)
        if not topics:
            raise ConfigError("Nothing to record.", "Set the parameter rig, topics, or both.")
        self._expected: dict[str, bool] = {}
        for topic in topics:
            name = self.resolve_topic_name(topic.name)
            self._expected[name] = topic.expected or self._expected.get(name, False)
        self._refused: dict[str, str] = {}
        self._asked: dict[str, tuple[Subscription, QoSProfile]] = {}
        self._losses = Losses()
        self._bag = BagFile(uri or time.strftime("recording_%Y%m%d_%H%M%S"), notes, size * 10**6, span)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.2, self._look, clock=wall)
        self.create_timer(1.0, self._on_second, clock=wall)
        self.get_logger().info(f"Recording into {self._bag.path}: {', '.join(self._expected)}.")

    def _look(self) -> None:
        """Subscribe to what is published now; ask for less where a publisher offers less."""
        for topic in self._expected:
            offers = self.get_publishers_info_by_topic(topic)
            if not offers or topic in self._refused:
                continue
            best = _strongest([offer.qos_profile for offer in offers])
            self._losses.publishers(topic, len(offers))
            known = self._asked.get(topic)
            if known is not None and not _exceeds(known[1], best):
                continue
            types = sorted({offer.topic_type for offer in offers})
            if len(types) > 1:
                self._refuse(topic, f"is published as {' and as '.join(types)}")
                continue
            if known is not None:
                self.destroy_subscription(known[0])
            elif not self._add(topic, types[0], [_plain(offer.qos_profile) for offer in offers]):
                continue
            kind = _message_class(types[0])
            taken = self.create_subscription(kind, topic, partial(self._on_message, topic), best, raw=True)
            self._asked[topic] = (taken, best)

    def _add(self, topic: str, msgtype: str, offered: list[Qos]) -> bool:
        try:
            _message_class(msgtype)
            self._bag.add(topic, msgtype, offered)
        except (RecordingError, ImportError, AttributeError) as error:
            self._refuse(topic, str(error))
            return False
        self.get_logger().info(f"Recording {topic} ({msgtype}).")
        return True

    def _refuse(self, topic: str, why: str) -> None:
        self._refused[topic] = why
        self.get_logger().error(f"Not recorded: {topic}: {why}")

    def _on_message(self, topic: str, data: bytes, information: dict[str, Any]) -> None:
        self._losses.take(topic, information["publication_sequence_number"])
        self._bag.write(topic, self._now_ns(), data)

    def _now_ns(self) -> int:
        """Time of reception: of the wall clock, or of /clock with use_sim_time."""
        return int(self.get_clock().now().nanoseconds)

    def _missing(self) -> list[str]:
        return [
            topic
            for topic, expected in self._expected.items()
            if expected and topic not in self._asked and topic not in self._refused
        ]

    def _on_second(self) -> None:
        self._bag.flush()
        lost, path = self._losses.counts, str(self._bag.path)
        report = recording_report(self._bag.counts, self._missing(), self._refused, path, lost)
        name = self.get_fully_qualified_name()
        self._diagnostics.publish(messages.diagnostics(time.time_ns(), name, "", [report]))

    def finish(self) -> int:
        """Finish the bag and say what is in it. 0, or 1 when nothing was recorded."""
        log = self.get_logger()
        if self._missing():
            log.warning(f"Nobody published {', '.join(self._missing())}.")
        if not self._bag.close():
            log.error(f"No message came: {self._bag.path} is not kept.")
            return 1
        if lost := {topic: count for topic, count in self._losses.counts.items() if count}:
            log.warning(
                f"Published and not received: {', '.join(f'{topic} {count}' for topic, count in lost.items())}."
            )
        counts = ", ".join(f"{topic} {count}" for topic, count in self._bag.counts.items())
        log.info(f"Recorded {self._bag.path}: {counts}.")
        return 0

    def destroy_node(self) -> None:
        """Finish the bag, whatever happened, then the node."""
        if hasattr(self, "_bag"):
            try:
                self._bag.close()
            except RecordingError as error:
                self.get_logger().error(str(error))
        super().destroy_node()


def _strongest(offers: Sequence[QoSProfile]) -> QoSProfile:
    """The strongest quality of service that all offers fulfil."""
    reliable = all(o.reliability == ReliabilityPolicy.RELIABLE for o in offers)
    latched = all(o.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in offers)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=QUEUE,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _exceeds(asked: QoSProfile, best: QoSProfile) -> bool:
    """Whether more is asked for than all publishers offer: the weaker of them would not be heard."""
    reliable = asked.reliability == ReliabilityPolicy.RELIABLE
    latched = asked.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return bool(
        (reliable and best.reliability != ReliabilityPolicy.RELIABLE)
        or (latched and best.durability != DurabilityPolicy.TRANSIENT_LOCAL)
    )


def _plain(offered: QoSProfile) -> Qos:
    """A quality of service as the bag states it."""

    def span(duration: Any) -> QosTime:
        return QosTime(*divmod(int(duration.nanoseconds), 1_000_000_000))

    return Qos(
        QosHistory(int(offered.history)),
        int(offered.depth),
        QosReliability(int(offered.reliability)),
        QosDurability(int(offered.durability)),
        span(offered.deadline),
        span(offered.lifespan),
        QosLiveliness(int(offered.liveliness)),
        span(offered.liveliness_lease_duration),
        bool(offered.avoid_ros_namespace_conventions),
    )


def _message_class(msgtype: str) -> Any:
    package, _, name = msgtype.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_and_finish(RecordNode, args)


if __name__ == "__main__":
    sys.exit(main())
