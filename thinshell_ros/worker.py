"""The physics process as the node holds it. No ROS."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

from thinshell_ros import physics

STOP_S = 3.0
"""Time [s] that a process gets to end by itself."""


class Worker:
    """A process of its own, so that the physics does not hold up the node.

    It is spawned, not forked: neither threads of the middleware nor of Taichi survive a fork.
    """

    def __init__(self, settings: physics.Settings) -> None:
        self._settings = settings
        self._number = 0
        self._link: Connection | None = None
        self._targets: dict[str, physics.Target] = {}
        self.start()

    def start(self) -> None:
        """Start the process; building the scene takes it some seconds, then it says ``Ready``."""
        if self._link is not None:
            self._link.close()
        context = multiprocessing.get_context("spawn")
        self._link, far = context.Pipe()
        self._process = context.Process(
            target=physics.run, args=(far, self._settings), name="thinshell-physics", daemon=True
        )
        self._process.start()
        far.close()
        self._ready = False
        self._listening = False
        self._targets.clear()

    @property
    def pid(self) -> int | None:
        """Number of the process."""
        return self._process.pid

    def end(self) -> str:
        """How the process ended by itself, '' while it runs."""
        if self._process.is_alive():
            return ""
        return f"The physics process ended with code {self._process.exitcode}."

    def answers(self) -> Iterator[physics.Answer]:
        """What has arrived; does not wait."""
        assert self._link is not None
        try:
            while self._link.poll():
                answer = self._link.recv()
                self._ready = self._listening = True
                yield answer
        except (EOFError, OSError):
            return
        self._pass_on()

    def aim(self, target: physics.Target) -> None:
        """Send a target now, or the latest one as soon as the process listens again.

        One message for each that comes back: a slow process is never swamped, so sending never blocks.
        """
        self._targets[target.end_effector] = target
        self._pass_on()

    def _pass_on(self) -> None:
        if self._listening:
            for target in self._targets.values():
                self._send(target)
                self._listening = False
            self._targets.clear()

    def reset(self) -> int:
        """Ask for a reset; returns the number of the answer."""
        self._number += 1
        self._targets.clear()
        self._send(physics.Reset(self._number))
        return self._number

    def pause(self, paused: bool) -> int:
        """Ask to stop or to go on; returns the number of the answer."""
        self._number += 1
        self._send(physics.Pause(self._number, paused))
        return self._number

    def stop(self) -> None:
        """End the process and wait for it. A process that still builds its scene is ended at once."""
        if self._ready:
            self._send(physics.Stop())
            self._drain()
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        if self._link is not None:
            self._link.close()

    def _drain(self) -> None:
        """Take and drop answers until the process ends: it cannot end while it waits to send one."""
        for _ in range(int(STOP_S / 0.05)):
            for _ in self.answers():
                pass
            self._process.join(0.05)
            if not self._process.is_alive():
                return

    def _send(self, request: Any) -> None:
        assert self._link is not None
        try:
            self._link.send(request)
        except (BrokenPipeError, OSError):
            pass  # the process is gone, which ``end`` says
