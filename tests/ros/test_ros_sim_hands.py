"""The simulator node with several hands: velocities, snapshots, and a rig that is amended while it runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_live import START_S, Client, NodeProcess

pytestmark = pytest.mark.ros

PLACE = "/hands"
RIG = """
name: pinch
gravity_m_s2: [0.0, 0.0, 0.0]
solver: {dt_s: 0.01, inertia: false}
bodies:
  pad:
    type: gel
    shape: {type: block, size_m: [0.01, 0.01, 0.006], cells: [1, 1, 1]}
    material: {E_pa: 1.0e5, nu: 0.4, density_kg_m3: 1000.0}
    bonded: bottom
    mount: below
  ball: {type: rigid, shape: {type: sphere, radius_m: 0.006}, mount: above}
end_effectors:
  above:
    start: {position_m: [0.0, 0.0, 0.0105]}
    topics: {target_pose: above/target_pose, current_pose: above/current_pose}
  below:
    start: {position_m: [0.0, 0.0, 0.0]}
    topics: {target_pose: below/target_pose, current_pose: below/current_pose}
contacts:
  - {between: [ball, pad], friction: 0.3}
sensors:
  wrench: {type: wrench, on: pad, rate_hz: 100.0, topic: wrench, frame_id: pad}
"""
SOFTER = "overlay_of: rig.yaml\nparameters: {pad.E_pa: 5.0e4}\n"
TOUCH_M = 0.0085
"""Height of the upper hand that presses the pad by half a millimetre."""


class Hands(Client):
    """A client that commands both hands."""

    def __init__(self, node: NodeProcess) -> None:
        from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped

        super().__init__("hands_client", PLACE)
        self.process = node
        self.wrenches = self.listen(WrenchStamped, "wrench")
        self.poses = {n: self.listen(PoseStamped, f"{n}/current_pose") for n in ("above", "below")}
        self._out = {
            f"{n}_{k}": self.node.create_publisher(kind, f"{n}/target_{k}", 1)
            for n in ("above", "below")
            for k, kind in (("pose", PoseStamped), ("twist", TwistStamped))
        }
        self.wait(lambda: all(self.poses.values()), f"no poses: {node.output}", START_S)
        for publisher in self._out.values():
            self.wait(publisher.get_subscription_count, "nobody takes commands")

    def command(self, name: str, kind: str, z: float) -> None:
        """A pose at a height [m], or a velocity upwards [m/s]."""
        from geometry_msgs.msg import PoseStamped, TwistStamped

        message: Any = PoseStamped() if kind == "pose" else TwistStamped()
        message.header.frame_id = "base_link"
        message.header.stamp = self.node.get_clock().now().to_msg()
        if kind == "pose":
            message.pose.position.z = z
        else:
            message.twist.linear.z = z
        self._out[f"{name}_{kind}"].publish(message)

    def height(self, name: str) -> float:
        """Where a hand is now [m]."""
        return float(self.poses[name][-1].pose.position.z)

    def go(self, name: str, z: float) -> None:
        """To a height [m], however often that has to be said."""

        def there() -> bool:
            self.command(name, "pose", z)
            return abs(self.height(name) - z) < 1e-9

        self.wait(there, f"{name} does not get to {z:g} m: {self.process.output}")

    def settled(self) -> float:
        """Force on the pad [N], at rest."""
        count = len(self.wrenches)
        self.wait(lambda: len(self.wrenches) > count + 20, "no wrench")
        return float(np.mean([m.wrench.force.z for m in self.wrenches[-5:]]))

    def ask(self, name: str) -> Any:
        from std_srvs.srv import Trigger

        return self.call(Trigger, f"thinshell_sim/{name}", Trigger.Request())


@pytest.fixture(scope="module")
def hands(ros: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hands]:
    folder = tmp_path_factory.mktemp("hands")
    (folder / "rig.yaml").write_text(RIG)
    (folder / "softer.yaml").write_text(SOFTER)
    with NodeProcess("sim_node", folder / "output", PLACE, rig=folder / "rig.yaml", noise="false") as node:
        client = Hands(node)
        client.folder = folder  # type: ignore[attr-defined]
        yield client
        client.node.destroy_node()


def test_each_hand_follows_its_own_commands_and_a_velocity_ends_by_itself(hands: Hands) -> None:
    hands.go("below", 0.001)
    assert hands.height("above") == 0.0105
    hands.go("below", 0.0)
    hands.command("above", "twist", 0.004)
    hands.wait(lambda: hands.height("above") > 0.0106, "it does not move")

    def still() -> bool:
        count = len(hands.poses["above"])
        hands.wait(lambda: len(hands.poses["above"]) > count + 5, "no poses")
        return len({m.pose.position.z for m in hands.poses["above"][count:]}) == 1

    hands.wait(still, "it moves on")
    # For 0.5 s of simulated time, of which stamps tell.
    assert hands.height("above") == pytest.approx(0.0105 + 0.5 * 0.004, abs=1e-9)
    assert hands.height("below") == 0.0


def test_a_state_that_was_kept_comes_back(hands: Hands) -> None:
    hands.go("above", TOUCH_M)
    force = hands.settled()
    assert force < -0.02
    kept = hands.ask("snapshot")
    assert kept.success and "kept the state at" in kept.message
    hands.go("above", 0.0105)
    assert abs(hands.settled()) < 1e-6
    assert hands.ask("restore").success
    count = len(hands.poses["above"])
    hands.wait(lambda: len(hands.poses["above"]) > count + 2, "no poses")
    assert hands.height("above") == TOUCH_M
    assert hands.settled() == pytest.approx(force, rel=1e-6)


def test_an_overlay_that_is_set_while_it_runs_counts_from_the_next_reset(hands: Hands) -> None:
    """As that of a fit or a diagnosis: half the modulus takes half the force. What is no such overlay is refused."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    def use(path: Path) -> Any:
        given = [Parameter("rig", value=str(path)).to_parameter_msg()]
        request = SetParameters.Request(parameters=given)
        assert hands.call(SetParameters, "thinshell_sim/set_parameters", request).results[0].successful
        return hands.ask("reset")

    folder: Path = hands.folder  # type: ignore[attr-defined]
    hands.go("above", TOUCH_M)
    force, last = hands.settled(), hands.wrenches[-1].header.stamp
    answer = use(folder / "softer.yaml")
    assert answer.success and "is being built" in answer.message
    count = len(hands.wrenches)
    hands.wait(lambda: len(hands.wrenches) > count + 5, f"no wrench: {hands.process.output}", START_S)
    hands.go("above", TOUCH_M)
    assert hands.settled() == pytest.approx(0.5 * force, rel=0.05)
    now = hands.wrenches[-1].header.stamp
    assert (now.sec, now.nanosec) > (last.sec, last.nanosec)

    (folder / "other.yaml").write_text(RIG.replace("topic: wrench", "topic: force"))
    for name, words in (("other.yaml", "has other end effectors, sensors"), ("none.yaml", "none.yaml")):
        refused = use(folder / name)
        assert not refused.success and words in refused.message
    assert hands.settled() == pytest.approx(0.5 * force, rel=0.05), "it goes on with the one that it has"
