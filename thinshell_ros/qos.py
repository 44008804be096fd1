"""Qualities of service of the nodes: they publish strong and subscribe weak, so that any driver is heard. A site may
change them by the parameters ``qos_overrides./TOPIC.publisher.POLICY`` and ``....subscription.POLICY``.
"""

from __future__ import annotations

from copy import copy
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

STREAM = QoSProfile(depth=100)
"""Nothing is lost while whoever listens reliably stands still for a second, on a busy machine, at 100 Hz."""
PICTURES = QoSProfile(depth=5)
"""Each may have a megabyte."""
LATEST = QoSProfile(depth=1)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Who comes late gets the last message."""
EVENTS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Who comes late gets them all: a tare before a recording says what its readings are counted from."""

READINGS = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
"""To subscribe to what sensors read."""


def overridable(profile: QoSProfile) -> dict[str, Any]:
    """Arguments of a publisher or subscription whose history, depth and reliability parameters may change.

    Its profile is a copy: rclpy writes what is overridden into the one that it is given.
    """
    return {"qos_profile": copy(profile), "qos_overriding_options": QoSOverridingOptions.with_default_policies()}
