"""Qualities of service of the nodes: they publish strong and subscribe weak, so that any driver is heard."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

STREAM = QoSProfile(depth=5)
LATEST = QoSProfile(depth=1)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Who comes late gets the last message."""
EVENTS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Who comes late gets them all: a tare before a recording says what its readings are counted from."""

READINGS = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
"""To subscribe to what sensors read."""
