"""A client of ``replay_node`` for tests."""

from __future__ import annotations

from typing import Any

from ros_live import START_S, Client, NodeProcess

NODE = "trajectory_deploy"
PATIENT = {"pose_timeout_s": 2.0, "wrench_timeout_s": 2.0, "clock_tolerance_s": 2.0, "max_lag_s": 2.0}
"""Time-outs for a machine that may be busy."""
SLOW_PLANT = {
    "pose_timeout_s": 4.0, "wrench_timeout_s": 4.0, "check_stamps": "false", "max_force_n": 5.0, "max_lag_s": 4.0,
}  # fmt: skip
"""... on which the physics may fall behind the wall clock too."""


class Replayer(Client):
    """A client of the node, in a namespace, that also hears the plant; its own relative names are below ``home``."""

    def __init__(self, process: NodeProcess, namespace: str = "", plant: str = "", home: str = "/") -> None:
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
        from geometry_msgs.msg import PoseStamped

        super().__init__("operator", home)
        self.process, self._node = process, f"{namespace}/{NODE}"
        self.targets = self.listen(PoseStamped, f"{plant}/target_pose")
        self.poses = self.listen(PoseStamped, f"{plant}/current_pose")
        self.statuses = self.listen(DiagnosticStatus, f"{self._node}/status", latched=True)
        self.listen(DiagnosticArray, "/diagnostics")

    def change(self, transition: str) -> bool:
        """Ask for a change of state, once."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        number = getattr(Transition, f"TRANSITION_{transition.upper()}")
        return bool(
            self.ask(ChangeState, "change_state", ChangeState.Request(transition=Transition(id=number))).success
        )

    def ask(self, kind: Any, name: str, request: Any) -> Any:
        """Response of a service of the node, which is not asked twice."""
        client = self.node.create_client(kind, f"{self._node}/{name}")
        try:
            self.wait(client.service_is_ready, f"no service {name}: {self.process.output}", START_S)
            self.spin(0.3)  # the server has to discover the client too
            future = client.call_async(request)
            self.wait(future.done, f"no answer of {name}: {self.process.output}", START_S)
            return future.result()
        finally:
            self.node.destroy_client(client)

    def trigger(self, name: str) -> Any:
        from std_srvs.srv import Trigger

        return self.ask(Trigger, name, Trigger.Request())

    def set(self, **values: Any) -> None:
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        given = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        answer = self.ask(SetParameters, "set_parameters", SetParameters.Request(parameters=given))
        assert all(result.successful for result in answer.results), answer.results

    def until(self, *states: str) -> dict[str, str]:
        """Values of the next status with one of these messages."""
        seen = len(self.statuses)

        def wanted() -> Any:
            return next((s for s in self.statuses[seen:] if s.message in states), None)

        status = self.wait(wanted, f"not {' or '.join(states)}: {self.process.output}", START_S)
        return {pair.key: pair.value for pair in status.values} | {"state": status.message}


def execute(replayer: Replayer) -> None:
    """Begin; again where readings have not come yet."""

    def begun() -> bool:
        answer = replayer.trigger("execute")
        assert answer.success or "No reading" in answer.message or "Not recorded yet" in answer.message, answer.message
        return bool(answer.success)

    replayer.wait(begun, "it did not begin", START_S)
