"""``sysid_node``: fits a rig to recordings, diagnoses what it leaves out, plans experiments, optimises motions, and
reports how far it is.

The jobs are those of ``thinshell fit``, ``diagnose``, ``plan`` and ``optimise``, in a process of their own; here are
only services, parameters and what is published; :mod:`thinshell_ros.job_actions` has the same as actions. Parameters
are read when a job is started, so that they can be set between jobs.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from sim_core.errors import ConfigError, ThinshellError
from sim_core.rigs import load_rig
from thinshell_ros import messages
from thinshell_ros.fit_request import diagnosis_request, fit_request, numbers_of, topic_names
from thinshell_ros.job_actions import JobActions
from thinshell_ros.job_process import Event, Request, Warned
from thinshell_ros.jobs import Jobs, new_id
from thinshell_ros.motion_request import optimise_request, plan_request
from thinshell_ros.parameters import declare, value_of, warn_of_unknown
from thinshell_ros.qos import LATCHED, overridable
from thinshell_ros.runner import run

VALUES = (
    "bag_uri", "held_out_uri", "fit.parameters", "fit.initial", "fit.lower", "fit.upper", "fit.max_iterations",
    "fit.seed", "fit.nuisance", "fit.prior_sd", "fit.per_bag", "fit.starts", "fit.profile", "fit.robust",
    "output_dir", "plan.experiments", "optimise.task", "optimise.rig", "optimise.method", "optimise.budget",
    "optimise.seed", "optimise.stop_at_success",
)  # fmt: skip

NAMES = {"fit": "fit", "diagnose": "diagnosis", "plan": "plan", "optimise": "optimisation"}
"""What jobs are called, by what is asked for."""

NUMBERS = ("fit.initial", "fit.lower", "fit.upper", "fit.prior_sd")


class SysidNode(Node):
    """One job at a time: ``~/start`` (a fit), ``~/diagnose``, ``~/plan``, ``~/optimise``, ``~/resume``, ``~/cancel``;
    ``~/status``, ``~/parameters_estimate`` and ``~/result``, latched. Where thinshell_interfaces is built, the actions
    ``~/fit``, ``~/diagnose``, ``~/plan`` and ``~/optimise`` too."""

    def __init__(self) -> None:
        super().__init__("tactile_sysid")
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
        declare(self, "output_dir", "", "each job makes a folder of its own in this one", fixed=False)
        declare(self, "plan.experiments", words, "experiments to plan: names or files", fixed=False)
        declare(self, "optimise.task", "", "task: a name, NAME:VARIANT or a file", fixed=False)
        declare(self, "optimise.rig", "", "in place of the task's: a name or a file", fixed=False)
        declare(self, "optimise.method", "hybrid", "hybrid, gradient, adam, cma or cem", fixed=False)
        declare(self, "optimise.budget", 200, "rollouts", bounds=(1, 1_000_000), fixed=False)
        declare(self, "optimise.seed", 0, "seed of the search", bounds=(0, 2**31), fixed=False)
        declare(self, "optimise.stop_at_success", False, "end with the first success", fixed=False)
        warn_of_unknown(self)

        self._jobs = Jobs(self._heard)
        self._reported_s = 0.0
        self._shown: object = None
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._estimate = self.create_publisher(Float64MultiArray, "~/parameters_estimate", **overridable(LATCHED))
        self._result = self.create_publisher(String, "~/result", **overridable(LATCHED))
        for service, kind in (("start", "fit"), ("diagnose",) * 2, ("plan",) * 2, ("optimise",) * 2):
            self.create_service(Trigger, f"~/{service}", partial(self._on_start, kind))
        self.create_service(Trigger, "~/resume", self._on_resume)
        self.create_service(Trigger, "~/cancel", self._on_cancel)
        self._actions = JobActions(self, self._jobs, self.begin)
        self.create_timer(0.05, self._on_poll, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._publish_state()
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

    def begin(self, kind: str, given: Mapping[str, Any], resume: str = "") -> str:
        """Start a job of a kind (fit, diagnose, plan, optimise) with the values of the parameters, or with those in
        ``given``, and return its name. ``resume``: the job that goes on instead.

        Raises:
            ThinshellError: it cannot be met, or another job is running.
        """
        self._jobs.check_free()
        if resume and (kind != "optimise" or self._jobs.knows(resume)):
            request, job_id = self._jobs.resumed(resume)
            if request.kind != NAMES[kind]:
                raise ConfigError(f"{resume} is no {NAMES[kind]}.", f"Resume it as a {request.kind}.")
            return self._start(request, job_id)
        job_id = resume or new_id(NAMES[kind])
        topics = {name: value_of(self, f"topics.{name}") for name in self._topics}
        values = {name: value_of(self, name) for name in VALUES} | dict(given)
        if kind == "fit":
            return self._start(fit_request(self._rig, topics, values, job_id), job_id)
        if kind == "diagnose":
            return self._start(diagnosis_request(self._rig, topics, values, job_id), job_id)
        if kind == "plan":
            return self._start(plan_request(self._rig, values, job_id), job_id)
        return self._start(optimise_request(values, job_id, begun=bool(resume)), job_id)

    def _start(self, request: Request, job_id: str) -> str:
        self._jobs.start(request, job_id)
        self._shown = None
        self._estimate.publish(messages.named_numbers(self._jobs.state.estimate()))
        self.get_logger().info(f"{job_id} begins.")
        self._publish_state()
        return job_id

    def _on_start(self, kind: str, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        try:
            response.success, response.message = True, self.begin(kind, {})
        except ThinshellError as error:
            response.success, response.message = False, str(error)
        return response

    def _on_resume(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        try:
            response.success, response.message = True, self._start(*self._jobs.resumed())
        except ThinshellError as error:
            response.success, response.message = False, str(error)
        return response

    def _on_cancel(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        response.success, response.message = self._jobs.cancel()
        return response

    def _on_poll(self) -> None:
        self._jobs.poll()
        self._actions.check_cancelled()

    def _heard(self, events: Sequence[Event]) -> None:
        """Publish what is new at once, the time that passes every second."""
        state = self._jobs.state
        for event in events:
            if isinstance(event, Warned):
                self.get_logger().warning(f"{state.job_id}: {event.text}")
        if self._shown is not (shown := state.step or state.state):
            self._shown = shown
            self._estimate.publish(messages.named_numbers(state.estimate()))
        if state.result:
            self._estimate.publish(messages.named_numbers(state.estimate()))
            self._result.publish(String(data=json.dumps(state.result, allow_nan=False)))
        if state.state == "failed":
            self.get_logger().error(f"{state.job_id} failed: {state.doing}")
        elif state.state == "cancelled" or (state.state == "succeeded" and state.level == "warn"):
            # a line of code may log with one severity only
            self.get_logger().warning(f"{state.job_id} {state.state}: {state.doing}")
        elif state.state == "succeeded":
            self.get_logger().info(f"{state.job_id} succeeded: {state.doing}")
        if events or state.state != "running" or time.monotonic() - self._reported_s > 1.0:
            self._publish_state()

    def _publish_state(self) -> None:
        self._reported_s = time.monotonic()
        report = self._jobs.state.report(self._jobs.elapsed_s)
        self._status.publish(messages.status(self.get_fully_qualified_name(), self._rig.name, report))
        self._actions.publish()

    def destroy_node(self) -> None:
        """End the job, then the node."""
        if hasattr(self, "_jobs") and (words := self._jobs.end()):
            print(words, file=sys.stderr)  # the middleware, and its log, may be gone
        if hasattr(self, "_actions"):
            self._actions.destroy()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(SysidNode, args)


if __name__ == "__main__":
    sys.exit(main())
