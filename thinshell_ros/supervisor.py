"""Watches over the physics process: what it is asked is answered within a bound, whatever happens to it. No ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Protocol

from thinshell_ros import protocol
from thinshell_ros.worker import Worker

BUILD_S = 300.0
"""Time [s] that the process gets to build its scene; the first time on a machine it compiles all kernels."""


class Waiting(Protocol):
    """Somebody who waits for an answer."""

    def set_result(self, result: protocol.Done) -> None:
        """Take the answer."""


class Supervisor:
    """The physics process with a watchdog. A process that has not been heard of for ``patience_s`` [s] of wall time is
    taken to hang: whoever waits for a response gets this as an error, and a reset kills it and starts another."""

    def __init__(
        self, settings: protocol.Settings, patience_s: float, on_answer: Callable[[], None] = lambda: None
    ) -> None:
        self._patience_s = patience_s
        self._worker = Worker(settings, on_answer)
        self._waiting: dict[int, Waiting] = {}
        self.ready = False
        self.status: protocol.Status | None = None
        self._since: protocol.Status | None = None

    @property
    def pid(self) -> int | None:
        """Number of the process."""
        return self._worker.pid

    @property
    def silent_s(self) -> float:
        """Time [s] since its last sign of life, or since its start."""
        return time.monotonic() - self._worker.heard_s

    def fault(self) -> str:
        """What is wrong with the process itself, '' if nothing is."""
        if ended := self._worker.end():
            return ended
        if self.silent_s <= (self._patience_s if self.ready else BUILD_S):
            return ""
        doing = "has not answered" if self.ready else "has been building its scene"
        return f"The physics process {doing} for {self.silent_s:.0f} s."

    def responses(self) -> Iterator[tuple[float, protocol.Answer]]:
        """What has arrived, each with its wall time of arrival [s]. Those who wait get their responses; where the
        process hangs or has ended, that."""
        for arrival, answer in self._worker.responses():
            if isinstance(answer, protocol.Ready):
                self.ready = True
            elif isinstance(answer, protocol.Status):
                self.status = answer
                self._since = answer if self._since is None else answer.including(self._since)
            yield arrival, answer
            if isinstance(answer, protocol.Done) and answer.number in self._waiting:
                self._waiting.pop(answer.number).set_result(answer)
        if self._waiting and (fault := self.fault()):
            self._give_up(f"{fault} Call ~/reset to start it again.")

    def review(self) -> protocol.Status | None:
        """The latest status, with numbers over all steps since the last call of this function: what holds for less
        than the time between two calls is in one of them."""
        since, self._since = self._since, None
        return since or self.status

    def _give_up(self, message: str) -> None:
        waiting, self._waiting = self._waiting, {}
        for one in waiting.values():
            one.set_result(protocol.Done(0, False, message))

    def aim(self, target: protocol.Command) -> None:
        """Move an end effector towards a pose, or with a velocity."""
        self._worker.aim(target)

    def reset(self, waiting: Waiting) -> None:
        """Go back to the start; a process that hangs or has ended is started again."""
        if fault := self.fault():
            self.restart()
            waiting.set_result(protocol.Done(0, True, f"{fault} It is being started again."))
        else:
            self._ask(self._worker.reset, waiting)

    def keep(self, waiting: Waiting) -> None:
        """Keep the state."""
        self._ask(self._worker.keep, waiting)

    def restore(self, waiting: Waiting) -> None:
        """Go back to the state that was kept."""
        self._ask(self._worker.restore, waiting)

    def pause(self, paused: bool, waiting: Waiting) -> None:
        """Stop or go on."""
        self._ask(lambda: self._worker.pause(paused), waiting)

    def step(self, duration_s: float, waiting: Waiting) -> None:
        """Advance by a duration [s] while paused."""
        self._ask(lambda: self._worker.step(duration_s), waiting)

    def _ask(self, ask: Callable[[], int], waiting: Waiting) -> None:
        if fault := self.fault():
            waiting.set_result(protocol.Done(0, False, f"{fault} Call ~/reset to start it again."))
        elif not self.ready:
            waiting.set_result(protocol.Done(0, False, "The scene is still being built. Ask again when it stands."))
        else:
            self._waiting[ask()] = waiting

    def restart(self, settings: protocol.Settings | None = None) -> None:
        """Kill the process and start another, from now on with these settings if given; one that was paused stays so
        with other settings."""
        paused = settings is not None and self.status is not None and self.status.paused
        self._worker.stop(0.0)
        self._give_up("The physics process was started again.")
        self.ready, self.status, self._since = False, None, None
        self._worker.start(settings, paused)

    def stop(self) -> None:
        """End the process, at once if it hangs or is still building its scene."""
        if self.ready and not self.fault():
            self._worker.stop()
        else:
            self._worker.stop(0.0)
