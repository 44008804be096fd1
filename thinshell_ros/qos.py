"""Qualities of service that the nodes publish with."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile

STREAM = QoSProfile(depth=5)
LATEST = QoSProfile(depth=1)
EVENTS = QoSProfile(depth=100)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Who comes late gets the last message."""
