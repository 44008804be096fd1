"""One job at a time: started, followed, cancelled, and resumed. No ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from sim_core.errors import ConfigError, nearest_match
from sim_core.rigs import resolve_name, with_parameters
from sysid.fit.multistart import Step
from thinshell_ros.fit_request import FitRequest
from thinshell_ros.job_process import Event, JobProcess, Request
from thinshell_ros.job_state import JobState
from thinshell_ros.motion_request import OptimiseRequest

_LATEST_MS = [0]


def new_id(kind: str) -> str:
    """Name of a new job, by its kind and the time [ms]; of two within a millisecond the second has the next one."""
    _LATEST_MS[0] = max(_LATEST_MS[0] + 1, time.time_ns() // 1_000_000)
    seconds, ms = divmod(_LATEST_MS[0], 1000)
    return f"{kind}_{time.strftime('%Y%m%d_%H%M%S', time.localtime(seconds))}_{ms:03d}"


class Jobs:
    """The job that runs or ran last. ``state``: what is known of it; ``request``: what it was asked to do.

    ``on_events``: hears what its process has reported, after the state has taken it in.
    """

    def __init__(self, on_events: Callable[[Sequence[Event]], None]) -> None:
        self.state, self.elapsed_s = JobState(), 0.0
        self.request: Request | None = None
        self._on_events = on_events
        self._process: JobProcess | None = None
        self._ended: dict[str, tuple[Request, Step | None]] = {}
        """Jobs that did not come to their end, with the best that they had found."""

    @property
    def running(self) -> bool:
        """Whether a job runs."""
        return self._process is not None

    def check_free(self) -> None:
        """Raise ``ConfigError`` where a job is running."""
        if self.running:
            raise ConfigError(f"{self.state.job_id} is running.", "Wait for its end, or call ~/cancel first.")

    def start(self, request: Request, job_id: str) -> None:
        """Start a job.

        Raises:
            ConfigError: one is running.
        """
        self.check_free()
        most = request.options.max_evaluations or 0 if isinstance(request, FitRequest) else 0
        self.request, self.elapsed_s = request, 0.0
        self.state = JobState(job_id, "running", "starting", most, kind=request.kind)
        self._ended.pop(job_id, None)
        self._process = JobProcess(request)

    def knows(self, job_id: str) -> bool:
        """Whether it is a job that did not come to its end."""
        return job_id in self._ended

    def resumed(self, job_id: str = "") -> tuple[Request, str]:
        """The request with which a job that did not come to its end goes on, by default the last one, and the name
        that it has then: a search goes on in its folder under its name; a fit is a new job that begins at the best
        values that were found, but for parameters of which something is known beforehand, which begin at that.

        Raises:
            ConfigError: there is none, or it cannot go on.
        """
        if not job_id and not self._ended:
            raise ConfigError("No job was cancelled or failed.", "Start one.")
        name = job_id or list(self._ended)[-1]
        if name not in self._ended:
            raise ConfigError(
                f"{name} is no job of this node that was cancelled or failed.", nearest_match(name, self._ended)
            )
        request, step = self._ended[name]
        if isinstance(request, OptimiseRequest):
            return request, name
        if not isinstance(request, FitRequest):
            raise ConfigError(f"{name} cannot go on: a {request.kind} keeps nothing before its end.", "Start it again.")
        again = new_id(request.kind)
        if step is None:
            return replace(request, out=request.out.with_name(again)), again
        known = {resolve_name(request.rig, n) for n in (*request.rig.known, *request.options.priors)}
        free = {n: v for n, v in step.values.items() if n in request.names and n not in known}
        most = request.options.max_evaluations
        options = request.options
        if most is not None:
            options = replace(options, max_evaluations=max(1, most - step.evaluations))
        at_best = with_parameters(request.rig, free)
        return replace(request, rig=at_best, options=options, out=request.out.with_name(again)), again

    def poll(self) -> None:
        """Take what the process has reported."""
        if self._process is not None:
            self.elapsed_s = self._process.elapsed_s
            self._take(list(self._process.events()))

    def _take(self, events: Sequence[Event]) -> None:
        assert self.request is not None
        for event in events:
            self.state.take(event, self.request)
        if self.state.state != "running":
            self._process = None
            if self.state.state != "succeeded":
                self._ended[self.state.job_id] = self.request, self.state.step
        self._on_events(events)

    def cancel(self) -> tuple[bool, str]:
        """End the job at once; whether it was, and how it ended in words."""
        self.poll()  # it may just have ended
        if self._process is None or self.request is None:
            return False, "No job is running."
        done = self._process.stop()
        if done is not None:
            self._take([done])
            return False, f"{self.state.job_id} succeeded before it could be cancelled; {self.state.doing}"
        self._process = None
        self._ended[self.state.job_id] = self.request, self.state.step
        self.state.state, self.state.doing, self.state.step = "cancelled", self._left(), None
        self._on_events([])
        return True, f"{self.state.job_id} was cancelled; {self.state.doing}"

    def _left(self) -> str:
        """What a job leaves that is ended, in words."""
        if isinstance(self.request, OptimiseRequest):
            return f"what it has tried is in {self.request.out}, and ~/resume goes on from there"
        if isinstance(self.request, FitRequest) and self.state.step is not None:
            return "nothing was written; ~/resume begins at the best values so far"
        return "nothing was written"

    def end(self) -> str:
        """End the job with the node; what became of it in words, '' where none ran."""
        if self._process is None:
            return ""
        if self._process.stop() is not None:
            return f"{self.state.job_id} had just succeeded in writing its results."
        left = "nothing was written"
        if isinstance(self.request, OptimiseRequest):
            left = f"what it has tried is in {self.request.out}"
        return f"{self.state.job_id} was cancelled; {left}."
