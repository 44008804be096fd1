"""Jobs of ``sysid_node`` as actions of ``thinshell_interfaces``, where that is built: ``~/fit``, ``~/diagnose``,
``~/plan`` and ``~/optimise``.

A goal is accepted always. One that cannot be met is aborted at once, and the ``sentence`` of its result says why: to
reject a goal carries no words.
"""

from __future__ import annotations

import array
import json
import math
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from sim_core.errors import ThinshellError
from thinshell_ros.job_state import JobState
from thinshell_ros.jobs import Jobs

Begin = Callable[[str, Mapping[str, Any], str], str]

PARAMETERS = {
    "fit": {
        "bag_uri": "bag_uri", "held_out_uri": "held_out_uri", "parameters": "fit.parameters",
        "initial": "fit.initial", "lower": "fit.lower", "upper": "fit.upper",
        "max_iterations": "fit.max_iterations", "output_dir": "output_dir",
    },
    "diagnose": {"bag_uri": "bag_uri", "held_out_uri": "held_out_uri", "output_dir": "output_dir"},
    "plan": {"experiments": "plan.experiments", "parameters": "fit.parameters", "output_dir": "output_dir"},
    "optimise": {
        "task": "optimise.task", "rig": "optimise.rig", "method": "optimise.method", "budget": "optimise.budget",
        "seed": "optimise.seed", "output_dir": "output_dir",
    },
}  # fmt: skip
"""Parameters of the node that the fields of goals stand for."""


def given_by(kind: str, goal: Any) -> dict[str, Any]:
    """Values of the parameters of the node that a goal gives: of the fields that are neither empty nor zero."""
    values = {parameter: getattr(goal, name) for name, parameter in PARAMETERS[kind].items()}
    plain = {name: list(value) if isinstance(value, array.array) else value for name, value in values.items()}
    return {name: value for name, value in plain.items() if value}


def feedback_fields(kind: str, state: JobState, elapsed_s: float) -> dict[str, Any]:
    """What the feedback of an action says of a job."""
    report = state.report(elapsed_s).values
    fields = {
        "share": float(state.share), "doing": state.doing,
        "elapsed_s": float(elapsed_s), "eta_s": float(report["eta_s"]),
    }  # fmt: skip
    if kind == "fit":
        best = state.estimate()
        fields["evaluations"] = state.step.evaluations if state.step else 0
        fields["loss"] = float(state.step.misfit) if state.step else math.nan
        fields["names"], fields["values"] = list(best), list(best.values())
    return fields


def result_fields(kind: str, state: JobState) -> dict[str, Any]:
    """What the result of an action says of a job that has ended."""
    found, job_id = state.result, state.job_id
    if not found:
        return {"job_id": job_id, "sentence": state.doing}
    fields = {
        "job_id": job_id, "output_dir": found["output_dir"], "sentence": state.doing, "json": json.dumps(found),
    }  # fmt: skip
    if kind == "fit":
        names = list(found["estimate"])
        fields |= {"names": names, "converged": found["converged"], "explained": found["explained"]}
        fields |= {key: [float(found[key][name]) for name in names] for key in ("estimate", "std")}
    elif kind == "diagnose":
        fields |= {key: found[key] for key in ("verdict", "effects")}
        fields["probability"] = [math.nan if p is None else float(p) for p in found["probability"]]
        fields["amended_rig"] = f"{found['output_dir']}/amended_rig.yaml"
    elif kind == "plan":
        names = list(found["ci95"])
        fields |= {"names": names, "determined": [found["determined"][name] for name in names]}
        fields |= {key: [found["ci95"][n][k] for n in names] for k, key in enumerate(("lower", "upper"))}
    else:
        fields |= {key: found[key] for key in ("success", "failures", "trajectory")}
        fields["reward"] = float(found["reward"])
    return fields


class _Deferred(ActionServer):
    """An action server whose goals end when the node says so. rclpy would have a goal that is executed occupy the
    executor, as a callback or as a coroutine that is asked again without a pause."""

    def __init__(self, node: Node, kind: Any, name: str, begin: Callable[[ServerGoalHandle], None], stop: Any) -> None:
        self._begin = begin
        super().__init__(node, kind, name, execute_callback=_unused, cancel_callback=stop)

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Any) -> None:
        """A goal was accepted and is now executed."""
        del execute_callback
        self._begin(goal_handle)

    def end(self, goal_handle: ServerGoalHandle, finish: Callable[[ServerGoalHandle], Any]) -> None:
        """``finish`` sets how a goal ended, and returns its result."""
        super().notify_execute(goal_handle, finish)


def _unused(handle: ServerGoalHandle) -> None:
    raise NotImplementedError


class JobActions:
    """Action servers of a node, one for each kind of job; none where ``thinshell_interfaces`` is not built."""

    def __init__(self, node: Node, jobs: Jobs, begin: Begin) -> None:
        self._node, self._jobs, self._begin = node, jobs, begin
        self._running: tuple[str, ServerGoalHandle] | None = None
        self._servers: dict[str, _Deferred] = {}
        try:
            from thinshell_interfaces.action import Diagnose, Fit, Optimise, Plan
        except ImportError:
            node.get_logger().info("thinshell_interfaces is not built: jobs are started by services.")
            return
        self._types = {"fit": Fit, "diagnose": Diagnose, "plan": Plan, "optimise": Optimise}
        for kind, action in self._types.items():

            def accepted(handle: ServerGoalHandle, kind: str = kind) -> None:
                self._on_goal(kind, handle)

            self._servers[kind] = _Deferred(node, action, f"~/{kind}", accepted, lambda handle: CancelResponse.ACCEPT)

    def _on_goal(self, kind: str, handle: ServerGoalHandle) -> None:
        try:
            # The job reports before its handle is known here, and once more by the feedback below.
            self._begin(kind, given_by(kind, handle.request), getattr(handle.request, "resume", ""))
        except ThinshellError as error:
            words = str(error)

            def refuse(handle: ServerGoalHandle) -> Any:
                handle.abort()
                return self._types[kind].Result(sentence=words)

            self._servers[kind].end(handle, refuse)
            return
        self._running = kind, handle
        self.publish()

    def publish(self) -> None:
        """Feedback of the job of the goal that is executed, and its result where it has ended."""
        if self._running is None:
            return
        kind, handle = self._running
        state = self._jobs.state
        handle.publish_feedback(self._types[kind].Feedback(**feedback_fields(kind, state, self._jobs.elapsed_s)))
        if self._jobs.running:
            return
        self._running = None
        fields, ended = result_fields(kind, state), state.state

        def finish(handle: ServerGoalHandle) -> Any:
            if ended == "succeeded":
                handle.succeed()
            elif ended == "cancelled" and handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()  # failed, or cancelled by the service
            return self._types[kind].Result(**fields)

        self._servers[kind].end(handle, finish)

    def check_cancelled(self) -> None:
        """End the job whose goal is to be cancelled."""
        if self._running is not None and self._running[1].is_cancel_requested:
            self._jobs.cancel()  # which publishes its end

    def destroy(self) -> None:
        """End the servers."""
        for server in self._servers.values():
            server.destroy()
