"""Pictures of the markers that a simulated camera sees, on its image topic."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import CompressedImage, Image

from sim_core.rigs import FisheyeCamera, PinholeCamera
from sysid.vision.render import dot_diameter, draw_dots
from thinshell_ros import messages
from thinshell_ros.poses import Floats


def is_compressed(topic: str) -> bool:
    """Whether a topic of images has compressed ones, by its name, as image transports name them."""
    return topic.rsplit("/", 1)[-1] == "compressed"


class MarkerImages:
    """Pictures of one camera. ``make``: creates the publisher of a message type."""

    def __init__(self, camera: PinholeCamera | FisheyeCamera, make: Callable[[Any], Any]) -> None:
        self._size = camera.width_px, camera.height_px
        compressed = is_compressed(camera.topics.image)
        self._publisher = make(CompressedImage if compressed else Image)
        self._message = messages.compressed_picture if compressed else messages.picture
        self._diameter_px = 0.0

    def publish(self, stamp_ns: int, frame_id: str, places_px: Floats) -> None:
        """A picture of markers at ``places_px`` ``(m, 2)``, NaN where one is out of sight, at a stamp [ns]."""
        self._diameter_px = self._diameter_px or dot_diameter(places_px)
        if self._publisher.get_subscription_count():
            grey = draw_dots(places_px, self._diameter_px, *self._size)
            self._publisher.publish(self._message(stamp_ns, frame_id, grey))
