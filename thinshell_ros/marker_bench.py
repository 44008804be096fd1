"""Rate and latency of ``marker_node`` on rendered pictures of a gel that is pressed, over loopback.

    python -m thinshell_ros.marker_bench --markers 63 --seconds 10 --rates 30 60

The latency is from the stamp of a picture, when it is published, to its tracks; the work is that of the tracking alone.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from typing import Any

import numpy as np

from sysid.vision.render import dot_diameter, draw_dots

SIZE_PX = 640, 480
REST_IMAGES = 10
START_S = 60.0


def pictures(markers: int, count: int = 60) -> list[np.ndarray]:
    """Pictures of a grid that is pressed and sheared in its middle, and of its return."""
    rows = max(round(np.sqrt(0.75 * markers)), 2)
    u, v = np.meshgrid(np.linspace(50.0, 590.0, max(round(markers / rows), 2)), np.linspace(50.0, 430.0, rows))
    rest = np.stack([u.ravel(), v.ravel()], axis=1)
    arm, diameter = rest - [320.0, 240.0], dot_diameter(rest)
    weight = np.exp(-(arm**2).sum(axis=1) / (2.0 * 120.0**2))[:, None]
    made = []
    for k in range(count):
        share = 0.5 - 0.5 * np.cos(2.0 * np.pi * k / count)
        made.append(draw_dots(rest + share * weight * ([20.0, 8.0] + 0.1 * arm), diameter, *SIZE_PX))
    return made


def measure(shown: list[np.ndarray], rate_hz: float, seconds: float) -> dict[str, str]:
    """The figures that the node says of itself after so long."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import Image

    from thinshell_ros import messages

    received: list[Any] = []
    node = rclpy.create_node("marker_bench")
    publisher = node.create_publisher(Image, "image", 1)
    node.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
    command = [sys.executable, "-m", "thinshell_ros.marker_node", "--ros-args", "-p", f"rest_images:={REST_IMAGES}"]
    process = subprocess.Popen(command)
    try:
        begin = time.monotonic()
        while not publisher.get_subscription_count():
            if time.monotonic() - begin > START_S:
                raise TimeoutError(f"marker_node does not listen after {START_S:g} s")
            rclpy.spin_once(node, timeout_sec=0.1)
        begin, sent = time.monotonic(), 0
        while (now := time.monotonic() - begin) < seconds:
            if now * rate_hz >= sent:
                image = shown[0] if sent < 2 * REST_IMAGES else shown[sent % len(shown)]
                publisher.publish(messages.picture(time.time_ns(), "camera", image))
                sent += 1
            rclpy.spin_once(node, timeout_sec=0.0005)
        rclpy.spin_once(node, timeout_sec=1.5)
        values = {pair.key: pair.value for pair in received[-1].status[0].values}
        return values | {"sent": str(sent)}
    finally:
        process.terminate()
        process.wait(START_S)
        node.destroy_node()


def main() -> int:
    """Print a line for each rate."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--markers", type=int, default=63, help="number of markers, about")
    parser.add_argument("--seconds", type=float, default=10.0, help="for each rate")
    parser.add_argument("--rates", type=float, nargs="+", default=[30.0, 60.0], help="pictures a second")
    given = parser.parse_args()
    import rclpy

    rclpy.init()
    shown = pictures(given.markers)
    for rate in given.rates:
        v = measure(shown, rate, given.seconds)
        print(
            f"{v['markers']} markers, {rate:g} Hz: {v['pictures']} of {v['sent']} pictures, {v['given_up']} given up, "
            f"work p50 {1e3 * float(v['work_p50_s']):.1f} ms, p99 {1e3 * float(v['work_p99_s']):.1f} ms, latency p50 "
            f"{1e3 * float(v['latency_p50_s']):.1f} ms, p99 {1e3 * float(v['latency_p99_s']):.1f} ms"
        )
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
