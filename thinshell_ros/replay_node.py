"""``replay_node``: replays a checked trajectory on whatever follows poses, under guard. A lifecycle node.

configure checks the trajectory as a whole, activate listens and records, ``~/execute`` moves; what is guarded is in
:mod:`thinshell_ros.replay.guard`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from sim_core.errors import ThinshellError
from thinshell_ros import messages
from thinshell_ros.health import Level, Report
from thinshell_ros.lifecycle import ManagedNode
from thinshell_ros.parameters import warn_of_unknown
from thinshell_ros.qos import LATCHED
from thinshell_ros.replay.deployment import Deployment
from thinshell_ros.replay_parameters import declare_all
from thinshell_ros.runner import FinishingNode, run_and_finish


class ReplayNode(ManagedNode, FinishingNode):
    """``~/execute``, ``~/abort``, ``~/retract``; ``~/trajectory`` in, ``~/status`` and ``~/path`` out, latched."""

    def __init__(self) -> None:
        super().__init__("trajectory_deploy")
        declare_all(self)
        warn_of_unknown(self)
        self._deployment: Deployment | None = None
        self._offered: MultiDOFJointTrajectory | None = None
        self._refused = ""
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(MultiDOFJointTrajectory, "~/trajectory", self._on_trajectory, LATCHED)
        self.create_service(Trigger, "~/execute", self._on_execute)
        self.create_service(Trigger, "~/abort", self._on_abort)
        self.create_service(Trigger, "~/retract", self._on_retract)
        self.create_timer(1.0, self._tell, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._tell()
        self.get_logger().info("Waiting to be configured.")

    def _on_trajectory(self, message: MultiDOFJointTrajectory) -> None:
        self._offered = message
        self.get_logger().info("A trajectory has come: configure takes it where trajectory_uri is empty.")

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Check the whole trajectory and prepare its topics."""
        try:
            self._deployment = Deployment(self, self._offered, self._tell)
        except ThinshellError as error:
            return self._refuse(error)
        self._refused = ""
        self._tell()
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen, and record."""
        assert self._deployment is not None
        try:
            self._deployment.activate()
        except ThinshellError as error:
            return self._refuse(error)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Hold if it moves, and finish the recording."""
        self._stop("the node was deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the trajectory."""
        if self._deployment is not None:
            self._deployment.destroy()
            self._deployment = None
        self._tell()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Hold if it moves, and finish the recording."""
        self._stop("the node was shut down")
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Hold: a transition failed by a defect, which rclpy keeps to itself."""
        self._stop(f"a transition from {state.label} failed by a defect")
        return super().on_error(state)

    def _refuse(self, error: ThinshellError) -> TransitionCallbackReturn:
        self._refused = str(error)
        self.get_logger().error(self._refused)
        self._tell()
        return TransitionCallbackReturn.FAILURE

    def _stop(self, reason: str) -> None:
        if self._deployment is not None and (recorded := self._deployment.deactivate(reason)):
            print(recorded, file=sys.stderr)  # the middleware, and its log, may be gone

    def _on_execute(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        response.success, response.message = False, "There is no trajectory: configure and activate the node first."
        if self._deployment is not None:
            response.success, response.message = self._deployment.execute()
        self.get_logger().info(f"Execute: {response.message}")
        self._tell()
        return response

    def _on_abort(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        response.success = self._deployment is not None and self._deployment.abort("~/abort was called")
        response.message = "holding" if response.success else "No replay is running."
        return response

    def _on_retract(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = False, "There is no trajectory: configure and activate the node first."
        if self._deployment is not None:
            response.success, response.message = self._deployment.retract()
        self.get_logger().info(f"Retract: {response.message}")
        self._tell()
        return response

    def _tell(self) -> None:
        """Publish the state: at once when it changes, and every second."""
        level: Level = "error" if self._refused else "ok"
        reports, hands = [Report("replay", level, "unconfigured", {"detail": self._refused})], ""
        if self._deployment is not None:
            reports, hands = self._deployment.watch(), self._deployment.end_effectors
        name = self.get_fully_qualified_name()
        self._status.publish(messages.status(name, hands, reports[0]))
        self._diagnostics.publish(messages.diagnostics(time.time_ns(), name, hands, reports))

    def stop_requested(self) -> None:
        """Hold at once."""
        if self._deployment is not None:
            self._deployment.abort("the node was asked to end")

    def finish(self) -> int:
        """Finish the recording."""
        self._stop("the node has ended")
        return 0


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_and_finish(ReplayNode, args)


if __name__ == "__main__":
    sys.exit(main())
