"""What contacts exert is on topics of ``sim_node`` where it is asked for."""

from __future__ import annotations

from pathlib import Path

import pytest
from ros_live import REST_HEIGHT_M, RIG, START_S, Client, NodeProcess

pytestmark = pytest.mark.ros

DEPTH_M = 0.0009
"""How far the ball goes below its rest: 0.4 mm into the pad."""

NOISE_N = 0.002


def test_the_wrench_of_a_contact_is_what_the_sensor_under_the_pad_feels(ros: None, tmp_path: Path) -> None:
    """But for the 5.6 mN that the pad weighs, all that its sensor feels is the ball."""
    from geometry_msgs.msg import WrenchStamped

    node = NodeProcess("sim_node", tmp_path / "output", "/touched", rig=RIG, contact_forces="true")
    client = Client("toucher", "/touched")
    try:
        contact = client.listen(WrenchStamped, "contacts/pad/ball")
        sensor = client.listen(WrenchStamped, "tactile/left/wrench")
        client.wait(lambda: contact and sensor, f"no wrench: {node.output}", START_S)
        assert contact[-1].header.frame_id == "base_link"
        assert contact[-1].wrench.force.z == 0.0, "nothing touches yet"

        def pressed() -> bool:
            client.aim(REST_HEIGHT_M - DEPTH_M)
            return contact[-1].wrench.force.z < -0.05

        client.wait(pressed, "the ball does not press on the pad")
        for _ in range(10):  # until it stands still
            client.aim(REST_HEIGHT_M - DEPTH_M)
            client.spin(0.1)
        pushed, felt = contact[-1].wrench.force.z, sensor[-1].wrench.force.z
        assert pushed < 0.0, "it pushes the pad, which the contact names first, down"
        assert abs(felt) == pytest.approx(-pushed, abs=5.0 * NOISE_N + 0.006, rel=0.01)
        stamp, other = contact[-1].header.stamp, sensor[-1].header.stamp
        assert abs(stamp.sec - other.sec + 1e-9 * (stamp.nanosec - other.nanosec)) < 0.1
        assert node.stop() == 0, node.output
    finally:
        node.kill()
        client.node.destroy_node()
