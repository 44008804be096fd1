"""``sysid_node``: fits a rig to recordings, or diagnoses what it leaves out, and tells how far it is.

The jobs are those of ``thinshell fit`` and ``thinshell diagnose``, in a process of their own; here are only services,
parameters and what is published. Parameters are read when a job is started, so that they can be set between jobs.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from typing import Literal

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from sim_core.errors import ThinshellError
from sim_core.rigs import load_rig
from thinshell_ros import messages
from thinshell_ros.fit_process import Event, FitProcess, Warned
from thinshell_ros.fit_request import Request, diagnosis_request, fit_request, numbers_of, topic_names
from thinshell_ros.fit_state import FitState
from thinshell_ros.parameters import declare, value_of, warn_of_unknown
from thinshell_ros.qos import LATCHED, overridable
from thinshell_ros.runner import run

VALUES = (
    "bag_uri", "held_out_uri", "fit.parameters", "fit.initial", "fit.lower", "fit.upper", "fit.max_iterations",
    "fit.seed", "fit.nuisance", "fit.prior_sd", "fit.per_bag", "fit.starts", "fit.profile", "fit.robust",
    "output_dir",
)  # fmt: skip


NUMBERS = ("fit.initial", "fit.lower", "fit.upper", "fit.prior_sd")


class SysidNode(Node):
    """One job at a time: ``~/start`` (a fit), ``~/diagnose``, ``~/cancel``; ``~/status``, ``~/parameters_estimate`` and
    ``~/result``, latched."""

    def __init__(self) -> None:
        super().__init__("tactile_sysid")
        self._process: FitProcess | None = None
        self._rig = load_rig(declare(self, "rig", "", "rig to fit: a name or a YAML file"))
        self._topics = topic_names(self._rig)
        for name, topic in self._topics.items():
            declare(self, f"topics.{name}", topic, "topic of the recordings", fixed=False)
        declare(self, "bag_uri", "", "recording, or list of recordings, to fit", fixed=False, any_type=True)
        declare(self, "held_out_uri", "", "recordings kept for the check", fixed=False, any_type=True)
        words = Parameter.Type.STRING_ARRAY
        declare(self, "fit.parameters", words, "parameters of the rig to estimate", fixed=False)
        declare(self, "fit.initial", None, "values to start from; [] or none: the rig's", fixed=False, any_type=True)
        declare(self, "fit.lower", None, "lower bounds; [] or none: of the physics", fixed=False, any_type=True)
        declare(self, "fit.upper", None, "upper bounds; [] or none: of the physics", fixed=False, any_type=True)
        declare(self, "fit.max_iterations", 200, "evaluations at most", bounds=(1, 100_000), fixed=False)
        declare(self, "fit.seed", 0, "seed of everything random", bounds=(0, 2**31), fixed=False)
        kinds = "what is estimated as well: time,bias,camera,pose; all; none"
        declare(self, "fit.nuisance", "all", kinds, fixed=False)
        spread = "what is known before of fit.initial; 0: nothing"
        declare(self, "fit.prior_sd", None, spread, fixed=False, any_type=True)
        self.add_on_set_parameters_callback(self._check)
        declare(
            self, "fit.per_bag", words, "those of fit.parameters that each bag has a value of its own of", fixed=False
        )
        declare(self, "fit.starts", 1, "searches from so many starts", bounds=(1, 1000), fixed=False)
        declare(self, "fit.profile", False, "find each interval from the likelihood itself", fixed=False)
        declare(self, "fit.robust", True, "leave out readings that are mistakes of a tracker or a sensor", fixed=False)
        declare(self, "output_dir", "", "each fit makes a folder of its own in this one", fixed=False)
        warn_of_unknown(self)

        self._state = FitState()
        self._request: Request | None = None
        self._elapsed_s = self._reported_s = 0.0
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._estimate = self.create_publisher(Float64MultiArray, "~/parameters_estimate", **overridable(LATCHED))
        self._result = self.create_publisher(String, "~/result", **overridable(LATCHED))
        self.create_service(Trigger, "~/start", lambda request, response: self._on_start("fit", response))
        self.create_service(Trigger, "~/diagnose", lambda request, response: self._on_start("diagnosis", response))
        self.create_service(Trigger, "~/cancel", self._on_cancel)
        self.create_timer(0.05, self._on_poll, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._tell()
        self.get_logger().info(f"Ready to fit {self._rig.name}.")

    def _check(self, changed: list[Parameter]) -> SetParametersResult:
        """Refuse what is no list of numbers where one is wanted."""
        try:
            for parameter in changed:
                if parameter.name in NUMBERS:
                    numbers_of(parameter.value, parameter.name)
        except ThinshellError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_start(self, kind: Literal["fit", "diagnosis"], response: Trigger.Response) -> Trigger.Response:
        """Start a job of a kind."""
        if self._process is not None:
            response.success = False
            response.message = f"{self._state.job_id} is running. Wait for its end, or call ~/cancel first."
            return response
        job_id = f"{kind}_{time.strftime('%Y%m%d_%H%M%S')}_{time.time_ns() // 1_000_000 % 1000:03d}"
        topics = {name: value_of(self, f"topics.{name}") for name in self._topics}
        values = {name: value_of(self, name) for name in VALUES}
        try:
            if kind == "fit":
                asked = fit_request(self._rig, topics, values, job_id)
                self._request, doing = asked, f"fitting {', '.join(asked.names)} of {self._rig.name}"
            else:
                self._request = diagnosis_request(self._rig, topics, values, job_id)
                doing = f"asking what {self._rig.name} leaves out"
        except ThinshellError as error:
            response.success, response.message = False, str(error)
            return response
        self._process = FitProcess(self._request)
        most = values["fit.max_iterations"] if kind == "fit" else 0
        self._state, self._elapsed_s = FitState(job_id, "running", "starting", most, kind=kind), 0.0
        self._estimate.publish(messages.named_numbers(self._state.estimate()))
        self.get_logger().info(f"{job_id}: {doing}.")
        self._tell()
        response.success, response.message = True, job_id
        return response

    def _on_cancel(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        self._on_poll()  # it may just have ended
        if self._process is None:
            response.success, response.message = False, "No job is running."
            return response
        done = self._process.stop()
        if done is not None:
            self._take([done])
            response.success = False
            response.message = f"{self._state.job_id} succeeded before it could be cancelled; {self._state.doing}"
            return response
        self._process = None
        self._state.state, self._state.doing, self._state.step = "cancelled", "nothing was written", None
        self._estimate.publish(messages.named_numbers(self._state.estimate()))
        self.get_logger().info(f"{self._state.job_id} was cancelled.")
        self._tell()
        response.success, response.message = True, f"{self._state.job_id} was cancelled; nothing was written"
        return response

    def _on_poll(self) -> None:
        """Take what the fit reported, and publish: what is new at once, the time that passes every second."""
        if self._process is None:
            return
        self._elapsed_s = self._process.elapsed_s
        self._take(list(self._process.events()))

    def _take(self, events: Sequence[Event]) -> None:
        assert self._request is not None
        step = self._state.step
        for event in events:
            self._state.take(event, self._request)
            if isinstance(event, Warned):
                self.get_logger().warning(f"{self._state.job_id}: {event.text}")
        if self._state.step is not step or self._state.result:
            self._estimate.publish(messages.named_numbers(self._state.estimate()))
        if self._state.result:
            self._result.publish(String(data=json.dumps(self._state.result, allow_nan=False)))
        if self._state.state != "running":
            self._process = None
            if self._state.state == "failed":
                self.get_logger().error(f"{self._state.job_id} failed: {self._state.doing}")
            elif self._state.level == "warn":  # a line of code may log with one severity only
                self.get_logger().warning(f"{self._state.job_id} succeeded: {self._state.doing}")
            else:
                self.get_logger().info(f"{self._state.job_id} succeeded: {self._state.doing}")
        if events or time.monotonic() - self._reported_s > 1.0:
            self._tell()

    def _tell(self) -> None:
        self._reported_s = time.monotonic()
        report = self._state.report(self._elapsed_s)
        self._status.publish(messages.status(self.get_fully_qualified_name(), self._rig.name, report))

    def destroy_node(self) -> None:
        """End the fit, then the node."""
        if self._process is not None:
            done = self._process.stop() is not None
            ended = "had just succeeded in writing its results" if done else "was cancelled; nothing was written"
            print(f"{self._state.job_id} {ended}.", file=sys.stderr)  # the middleware, and its log, may be gone
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(SysidNode, args)


if __name__ == "__main__":
    sys.exit(main())
