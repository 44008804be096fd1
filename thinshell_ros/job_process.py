"""The process that does a job, and what it reports. No ROS."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from shutil import rmtree
from typing import Any

from sim_core.errors import ThinshellError
from sysid.fit.multistart import Step
from sysid.io.atomic_folder import unfinished
from sysid.workflow import diagnose_bags, fit_bags
from thinshell_ros.fit_request import DiagnosisRequest, FitRequest
from thinshell_ros.motion_request import OptimiseRequest, PlanRequest

Request = FitRequest | DiagnosisRequest | PlanRequest | OptimiseRequest

TIDIED = "ignore:resource_tracker"
"""What Python says of semaphores of processes that were ended, which it then removes."""


@dataclass(frozen=True)
class Share:
    """``share`` of the work that is done, 0 to 1; ``text``: what is being done."""

    share: float
    text: str


@dataclass(frozen=True)
class Warned:
    """``text``: what speaks against a recording, before anything is simulated."""

    text: str


@dataclass(frozen=True)
class Succeeded:
    """``found``: the content of the file with the result (``file`` of the request)."""

    found: dict[str, Any]


@dataclass(frozen=True)
class Failed:
    """``reason``: one paragraph."""

    reason: str


Event = Share | Step | Warned | Succeeded | Failed


def run(link: Connection, request: Request) -> None:
    """Do what is asked, and send events until ``Succeeded`` or ``Failed``.

    The process and those that it starts are a process group, which ends at once when the other end of the link closes.
    """
    os.setsid()
    threading.Thread(target=_end_with, args=(link, unfinished(request.out)), daemon=True).start()
    try:
        _work(link, request)
        link.send(_succeeded(request))
    except ThinshellError as error:
        link.send(Failed(str(error)))
    except Exception as error:
        link.send(Failed(f"This is a defect of the program: {type(error).__name__}: {error}. Please report it."))


def _work(link: Connection, request: Request) -> None:
    def report(share: float, text: str) -> None:
        link.send(Share(share, text))

    def warn(text: str) -> None:
        link.send(Warned(text))

    if isinstance(request, DiagnosisRequest):
        diagnose_bags(
            request.rig, request.bags, held_out=request.held_out, out=request.out, on_progress=report, on_warning=warn
        )
    elif isinstance(request, PlanRequest):
        from sysid.workflow.plan import plan_to_folder

        plan_to_folder(
            request.rig, request.experiments, request.names,
            out=request.out, on_progress=report, nuisance=request.nuisance,
        )  # fmt: skip
    elif isinstance(request, OptimiseRequest):
        from sim_core.tasks import load_task
        from sysid.workflow.optimise import optimise_task

        report(0.0, "making the scene")
        optimise_task(load_task(request.task, rig=request.rig), request.settings, request.out, report)
    else:
        fit_bags(
            request.rig, request.bags, request.names, request.options, held_out=request.held_out, out=request.out,
            on_progress=report, on_step=link.send, on_warning=warn,
        )  # fmt: skip


def _succeeded(request: Request) -> Succeeded:
    return Succeeded(json.loads((request.out / request.file).read_text()))


def _end_with(link: Connection, part: Path) -> None:
    """Kill the process group when nobody holds the other end of the link any more; nothing is ever sent over it.

    ``part``: the folder of results, which goes too if it is still empty.
    """
    try:
        link.poll(None)
    finally:
        with suppress(OSError):
            part.rmdir()
        os.killpg(0, signal.SIGKILL)


class JobProcess:
    """One job in a process of its own.

    It is spawned, not forked: threads of the middleware do not survive a fork.
    """

    def __init__(self, request: Request) -> None:
        self._request = request
        self._over = False
        if TIDIED not in sys.warnoptions:
            sys.warnoptions.append(TIDIED)  # handed on to the process that tidies up, as -W
        context = get_context("spawn")
        self._link, far = context.Pipe()
        self._process = context.Process(target=run, args=(far, request), name="thinshell-job")
        self._started = time.monotonic()
        self._process.start()
        far.close()

    @property
    def pid(self) -> int | None:
        """Number of the process."""
        return self._process.pid

    @property
    def elapsed_s(self) -> float:
        """Time [s] since the start."""
        return time.monotonic() - self._started

    def events(self) -> Iterator[Event]:
        """What has arrived, without waiting. The last is ``Succeeded`` or ``Failed``, after a crash too."""
        alive = self._process.is_alive()  # before the link is read, which then holds all that there will be
        try:
            while not self._over and self._link.poll():
                event = self._link.recv()
                self._over = isinstance(event, Succeeded | Failed)
                yield event
        except (EOFError, OSError):
            pass
        if not alive and not self._over:
            yield self.stop() or Failed(self._crash())
        elif self._over:
            self.stop()

    def _crash(self) -> str:
        code = self._process.exitcode
        if code is not None and code < 0:
            return (
                f"The process of the job was ended by {signal.Signals(-code).name}. Usually the machine ran out of "
                "memory, which its kernel log says: use fewer recordings at once, or coarser cells."
            )
        return f"The process of the job ended with code {code}. The node's output says more."

    def stop(self) -> Succeeded | None:
        """End the process and all that it started, and remove what is not finished, but for what a search has tried.

        If it had not reported its end: what it would have reported if all was written before it ended.
        """
        if self._link.closed:
            return None
        assert self._process.pid is not None
        try:
            os.killpg(self._process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass  # it has no group yet, or all of it is gone
        self._process.kill()
        self._process.join()
        self._link.close()
        was_over, self._over = self._over, True
        if was_over:
            return None  # it has cleared up itself, or said where it left what is finished
        if isinstance(self._request, OptimiseRequest):
            return None  # its folder is there from the first rollout on
        if self._request.out.exists():
            return _succeeded(self._request)
        rmtree(unfinished(self._request.out), ignore_errors=True)
        return None
