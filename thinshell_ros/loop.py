"""The physics process: requests in, responses out, and steps in between, in pace with the wall clock. No ROS."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from sim_core.errors import ThinshellError
from thinshell_ros.pacing import Pacer
from thinshell_ros.physics import RETRY_S, Physics
from thinshell_ros.protocol import (
    BACK,
    Batch,
    Done,
    Keep,
    Pause,
    Ready,
    Request,
    Reset,
    Restore,
    Settings,
    Status,
    Step,
    Stop,
    Target,
    Velocity,
)

if TYPE_CHECKING:
    from sim_core.solve.step import StepReport

STATUS_PERIOD_S = 0.25
"""Wall time between two statuses."""


class Loop:
    """Steps a simulation. One that finds no step at all stands still until another command or a reset comes."""

    def __init__(
        self,
        link: Connection,
        physics: Physics,
        factor: float = 1.0,
        catches_up: bool = True,
        clock: Callable[[], float] = time.monotonic,
        paused: bool = False,
    ) -> None:
        self._link = link
        self._physics = physics
        self._clock = clock
        self._pacer = Pacer(factor, catches_up)
        self._paused = paused
        self._stuck = ""
        self._retry_at = 0.0
        self._running = True
        self._reports: list[StepReport] = []
        self._not_finite = 0
        self._behind = (0.0, 0.0)
        self._reported_at = -float("inf")

    def run(self) -> None:
        """Go on until a request to stop. Raises EOFError or OSError when the other side is gone."""
        self._link.send(Ready(self._physics.ids, self._physics.rest))
        self._pacer.start(self._clock(), self._physics.time)
        while self._running:
            standing = self._paused or self._stuck
            now, at = self._clock(), self._physics.time
            self._listen(STATUS_PERIOD_S if standing else self._pacer.wait_s(now, at, self._physics.dt))
            if self._running and not self._paused and not self._stuck:
                self._step()
            self._tell()

    def _step(self) -> bool:
        """Advance by a step and send its readings; False where it stands still from now on."""
        trouble = self._trouble()
        try:
            readings, report, bad = self._physics.step()
        except ThinshellError as error:
            self._stuck, self._retry_at = str(error), self._clock() + RETRY_S
            self._reported_at = -float("inf")
            return False
        if self._trouble() != trouble:
            self._reported_at = -float("inf")
        self._reports.append(report)
        self._not_finite += bad
        away, turned = self._physics.behind
        self._behind = max(self._behind[0], away), max(self._behind[1], turned)
        self._link.send(Batch(self._physics.time, readings, self._pacer.skipped_s))
        return True

    def _trouble(self) -> str:
        if self._stuck:
            return f"{self._stuck} The state is held."
        if self._physics.failure is not None:
            return f"{self._physics.failure.words} The end effectors are held until the command changes."
        return ""

    def _listen(self, wait: float) -> None:
        """Take requests until ``wait`` [s] is over, or until there is something else to do."""
        end, standing = self._clock() + wait, (self._paused, self._stuck)
        while self._running and self._link.poll(max(end - self._clock(), 0.0)):
            self._take(self._link.recv())
            if (self._paused, self._stuck) != standing:
                return

    def _take(self, request: Request) -> None:
        if isinstance(request, Target | Velocity):
            self._physics.aim(request)
            if self._stuck and self._clock() >= self._retry_at:
                self._stuck = ""
                self._go_on()
            return
        self._reported_at = -float("inf")
        if isinstance(request, Stop):
            self._running = False
        elif isinstance(request, Pause):
            self._paused = request.paused
            self._go_on()
            self._link.send(Done(request.number, True, "paused" if request.paused else "running"))
        elif isinstance(request, Step):
            self._link.send(self._steps(request))
        elif isinstance(request, Keep):
            self._physics.keep()
            self._link.send(Done(request.number, True, f"kept the state at {self._physics.time:.6g} s"))
        elif isinstance(request, Restore):
            self._link.send(self._restored(request))
        else:
            self._reset(request)

    def _go_on(self) -> None:
        if not self._paused and not self._stuck:
            self._pacer.start(self._clock(), self._physics.time)

    def _steps(self, request: Step) -> Done:
        """Advance while paused."""
        dt = self._physics.dt
        if not self._paused:
            return Done(request.number, False, "The simulation is running: call ~/pause with true before ~/step.")
        self._stuck = ""
        count = max(math.ceil(request.duration_s / dt - 1e-6), 1)
        for done in range(count):
            if not self._step():
                return Done(request.number, False, f"{done} of {count} steps were made. {self._trouble()}")
        made = f"{count} step{'s' if count > 1 else ''} of {dt:g} s, simulated time {self._physics.time:.6g} s"
        return Done(request.number, True, made)

    def _restored(self, request: Restore) -> Done:
        kept_s = self._physics.restore()
        if kept_s is None:
            return Done(request.number, False, "No state is kept: call ~/snapshot first.")
        self._stuck = ""
        self._go_on()
        return Done(request.number, True, f"back in the state that was kept at {kept_s:.6g} s; time goes on")

    def _reset(self, request: Reset) -> None:
        try:
            self._physics.reset()
        except ThinshellError as error:
            self._stuck = str(error)
            self._link.send(Done(request.number, False, self._stuck))
            return
        self._stuck = ""
        self._link.send(Done(request.number, True, BACK, self._physics.rest))
        self._go_on()

    def _tell(self) -> None:
        if self._clock() - self._reported_at < STATUS_PERIOD_S:
            return
        self._reported_at = self._clock()
        reports, self._reports = self._reports, []
        bad, self._not_finite = self._not_finite, 0
        behind, self._behind = self._behind, (0.0, 0.0)
        self._link.send(
            Status(
                self._paused,
                self._trouble(),
                self._physics.time,
                self._pacer.factor(),
                len(reports),
                max((r.iterations for r in reports), default=0),
                max((r.residual_n for r in reports), default=0.0),
                reports[-1].contacts if reports else 0,
                min((r.min_gap_m for r in reports), default=float("inf")),
                bad,
                self._pacer.lag_s,
                *behind,
            )
        )


def end_with_parent() -> None:
    """End this process as soon as the one that spawned it is no more, whatever it is doing: a step may take long."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        assert parent is not None
        parent.join()
        os._exit(1)

    if parent is not None:
        threading.Thread(target=watch, daemon=True).start()


def run(link: Connection, settings: Settings, paused: bool = False) -> None:
    """Body of the process: build, step, answer. Ends on request, or when the other side is gone. ``paused``: it stands
    still at first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the node says when to stop
    end_with_parent()
    try:
        try:
            Loop(link, Physics(settings), settings.real_time_factor, settings.catches_up, paused=paused).run()
        except ThinshellError as error:
            link.send(Status(False, str(error), 0.0, float("nan"), ended=True))
        except (EOFError, OSError):
            raise
        except Exception:
            trouble = f"A defect in the simulation: {traceback.format_exc()}"
            link.send(Status(False, trouble, 0.0, float("nan"), ended=True))
    except (EOFError, OSError):
        return
