"""``marker_node``: pictures of a tactile or scene camera in, tracks of its markers out.

The tracking is :mod:`sysid.vision.live`, the code of ``thinshell track``.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image, PointCloud2
from std_srvs.srv import Trigger

from sim_core.errors import ConfigError
from sysid.recording.images import pixels
from sysid.vision.detect import DetectionParameters
from sysid.vision.live import LiveTracker
from thinshell_ros import clouds, messages
from thinshell_ros.parameters import declare, warn_of_unknown
from thinshell_ros.qos import STREAM, overridable
from thinshell_ros.runner import run
from thinshell_ros.seeing import Seeing

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""A picture that comes while another is worked on takes the place of the one that waits: tracks are late by one at
most."""

LOG_S = 5.0
"""Shortest time [s] between two lines of the log of the same kind."""


class MarkerNode(Node):
    """``image`` and ``image/compressed`` in, ``marker_tracks`` out; ``~/zero`` takes the layout at rest anew."""

    def __init__(self) -> None:
        super().__init__("marker_tracker")
        declare(self, "rest_images", 10, "pictures that the layout at rest is taken from", bounds=(1, 1000))
        declare(
            self, "layout", "", "tracking.json of an earlier 'thinshell track': its layout and numbers; empty: none"
        )
        declare(self, "polarity", "auto", "bright or dark dots, or auto")
        declare(self, "diameter_px", 0.0, "diameter of a dot; 0: measured", bounds=(0.0, 200.0))
        warn_of_unknown(self)
        self._tracker = self._new()
        self._seeing = Seeing()
        self._heard_s = time.monotonic()
        self._tracks = self.create_publisher(PointCloud2, "marker_tracks", **overridable(STREAM))
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        for kind, topic in ((Image, "image"), (CompressedImage, "image/compressed")):
            take = partial(self._on_picture, kind is CompressedImage)
            self.create_subscription(kind, topic, callback=take, **overridable(NEWEST))
        self.create_service(Trigger, "~/zero", self._on_zero)
        self.create_timer(1.0, self._on_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info("Waiting for pictures of the sensor at rest.")

    def _new(self) -> LiveTracker:
        given = {name: self.get_parameter(name).value for name in ("polarity", "diameter_px", "rest_images", "layout")}
        detection = DetectionParameters(given["polarity"], given["diameter_px"] or None)
        layout = None if not given["layout"] else read_layout(Path(given["layout"]).expanduser())
        return LiveTracker(given["rest_images"], layout=layout, detection=detection)

    def _on_picture(self, compressed: bool, message: Any) -> None:
        begun, header = self.get_clock().now().nanoseconds, message.header
        self._heard_s = time.monotonic()
        try:
            image = pixels(message, compressed)
        except ValueError as error:
            self._seeing.misread(f"a picture {error}")
            self.get_logger().warning(f"A picture {error}: it is left out.", throttle_duration_sec=LOG_S)
            return
        known = self._tracker.reference is not None
        frame = self._tracker.take(image)
        stamp = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
        if self._tracker.reference is not None:
            if not known:
                self.get_logger().info(f"Following {len(frame.uv)} markers.")
            points = clouds.track_points(frame.uv, np.arange(len(frame.uv)), frame.confidence)
            self._tracks.publish(messages.cloud(stamp, header.frame_id, points))
        if frame.note and known:
            self.get_logger().warning(f"A picture gives no markers: {frame.note}.", throttle_duration_sec=LOG_S)
        done = self.get_clock().now().nanoseconds
        seen = int(np.isfinite(frame.uv[:, 0]).sum())
        self._seeing.take(1e-9 * stamp, 1e-9 * begun, 1e-9 * done, seen, len(frame.uv), frame.note)

    def _on_zero(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        self._tracker = self._new()
        response.success, response.message = (
            True,
            "The layout is taken from the next pictures; markers are numbered anew.",
        )
        if self._tracker.reference is not None:
            response.message = "The next picture is matched to the layout that was given."
        return response

    def _on_diagnostics(self) -> None:
        report, name = self._seeing.report(time.monotonic() - self._heard_s), self.get_fully_qualified_name()
        self._diagnostics.publish(messages.diagnostics(time.time_ns(), name, "", [report]))


def read_layout(path: Path) -> np.ndarray:
    """Positions [px] ``(m, 2)`` of the layout of an earlier tracking.

    Raises:
        ConfigError: the file has none.
    """
    try:
        layout = np.asarray(json.loads(path.read_text(encoding="utf-8"))["reference_uv_px"], dtype=float)
        if layout.ndim != 2 or layout.shape[1] != 2 or len(layout) < 4 or not np.isfinite(layout).all():
            raise ValueError(f"reference_uv_px has the shape {layout.shape}, not of 4 or more markers x 2")
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{path} holds no layout of markers: {error}.", "Give the tracking.json that 'thinshell track' writes."
        ) from None
    return layout


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(MarkerNode, args)


if __name__ == "__main__":
    sys.exit(main())
