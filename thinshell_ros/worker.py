"""The physics process as the node holds it. No ROS."""

from __future__ import annotations

import multiprocessing
import queue
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection

from thinshell_ros import loop, protocol

STOP_S = 3.0
"""Time [s] that a process gets to end by itself."""


class Worker:
    """A process of its own, so that the physics does not hold up the node.

    It is spawned, not forked: threads of the middleware do not survive a fork. A thread takes what it
    sends, because a process that is stopped in the middle of an answer would hold up who waits for its end.
    """

    def __init__(self, settings: protocol.Settings, on_answer: Callable[[], None] = lambda: None) -> None:
        """``on_answer``: called in another thread when an answer has come."""
        self._settings = settings
        self._on_answer = on_answer
        self._number = 0
        self._link: Connection | None = None
        self._thread: threading.Thread | None = None
        self._targets: dict[str, protocol.Command] = {}
        self.start()

    def start(self, settings: protocol.Settings | None = None, paused: bool = False) -> None:
        """Start the process, from now on with these settings if given. Building the scene takes it some seconds, then
        it says ``Ready``. ``paused``: it stands still then."""
        self._settings = settings or self._settings
        context = multiprocessing.get_context("spawn")
        self._link, far = context.Pipe()
        self._process = context.Process(
            target=loop.run, args=(far, self._settings, paused), name="thinshell-physics", daemon=True
        )
        self._process.start()
        far.close()
        self.heard_s = self.started_s = time.monotonic()
        """Wall time [s] of its last sign of life, and of its start."""
        self._inbox: queue.SimpleQueue[tuple[float, protocol.Answer]] = queue.SimpleQueue()
        self._listening = False
        self._targets.clear()
        # A daemon: a node that a signal ends while it is being made must not wait for it.
        self._thread = threading.Thread(target=self._receive, args=(self._link, self._inbox), daemon=True)
        self._thread.start()

    def _receive(self, link: Connection, inbox: queue.SimpleQueue[tuple[float, protocol.Answer]]) -> None:
        while True:
            try:
                answer = link.recv()
            except (EOFError, OSError):
                return
            self.heard_s = time.monotonic()
            inbox.put((self.heard_s, answer))
            self._on_answer()

    @property
    def pid(self) -> int | None:
        """Number of the process."""
        return self._process.pid

    def end(self) -> str:
        """How the process ended by itself, '' while it runs."""
        if self._process.is_alive():
            return ""
        return f"The physics process ended with code {self._process.exitcode}."

    def responses(self) -> Iterator[tuple[float, protocol.Answer]]:
        """What has arrived, each with its wall time of arrival [s]; does not wait."""
        while not self._inbox.empty():
            self._listening = True
            yield self._inbox.get()
        self._pass_on()

    def aim(self, target: protocol.Command) -> None:
        """Send a command now, or the latest one as soon as the process listens again.

        One message for each that comes back: a slow process is never swamped, so sending never blocks.
        """
        self._targets[target.end_effector] = target
        self._pass_on()

    def _pass_on(self) -> None:
        if self._listening:
            self._flush()

    def _flush(self) -> None:
        for target in self._targets.values():
            self._send(target)
            self._listening = False
        self._targets.clear()

    def reset(self) -> int:
        """Ask for a reset; returns the number of the answer."""
        self._number += 1
        self._targets.clear()
        self._send(protocol.Reset(self._number))
        return self._number

    def keep(self) -> int:
        """Ask to keep the state; returns the number of the answer."""
        self._number += 1
        self._send(protocol.Keep(self._number))
        return self._number

    def restore(self) -> int:
        """Ask to go back to the state that was kept; returns the number of the answer."""
        self._number += 1
        self._targets.clear()
        self._send(protocol.Restore(self._number))
        return self._number

    def pause(self, paused: bool) -> int:
        """Ask to stop or to go on; returns the number of the answer."""
        self._number += 1
        self._send(protocol.Pause(self._number, paused))
        return self._number

    def step(self, duration_s: float) -> int:
        """Ask for the steps of a duration [s], with all targets from before; returns the number of the answer."""
        self._number += 1
        self._flush()
        self._send(protocol.Step(self._number, duration_s))
        return self._number

    def stop(self, wait_s: float = STOP_S) -> None:
        """End the process and wait for it; one that does not end by itself within ``wait_s`` [s] is killed."""
        if wait_s > 0.0:
            self._send(protocol.Stop())
            self._process.join(wait_s)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self._link is not None:
            self._link.close()

    def _send(self, request: protocol.Request) -> None:
        assert self._link is not None
        try:
            self._link.send(request)
        except (BrokenPipeError, OSError):
            pass  # the process is gone, which ``end`` says
