"""What is published reliably arrives, also where whoever listens stands still for a while."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest
from ros_live import WAIT_S, Client

pytestmark = pytest.mark.ros

COUNT = 90
LISTENER = f"""
import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String

rclpy.init()
node, heard = rclpy.create_node("listener"), []
node.create_subscription(String, "readings", lambda message: heard.append(message.data[:3]), QoSProfile(depth=1000))
while not heard or heard[-1] != "{COUNT - 1:03d}":
    rclpy.spin_once(node, timeout_sec=0.1)
print(len(heard), flush=True)
rclpy.shutdown()
"""


def test_nothing_is_lost_while_a_listener_stands_still_for_a_second(ros: None) -> None:
    from std_msgs.msg import String

    from thinshell_ros.qos import STREAM, overridable

    client = Client("talker")
    publisher = client.node.create_publisher(String, "readings", **overridable(STREAM))
    listener = subprocess.Popen([sys.executable, "-c", LISTENER], stdout=subprocess.PIPE, text=True)
    try:
        client.wait(publisher.get_subscription_count, "nobody listens")
        client.spin(1.0)  # the listener has to discover the publisher too
        publisher.publish(String(data="000"))
        listener.send_signal(signal.SIGSTOP)
        for number in range(1, COUNT):
            publisher.publish(String(data=f"{number:03d}" + 16_000 * "."))
            time.sleep(0.005)
        listener.send_signal(signal.SIGCONT)
        said, _ = listener.communicate(timeout=WAIT_S)
        assert said.split()[-1] == str(COUNT)
    finally:
        listener.kill()
        listener.wait()
        client.node.destroy_node()
