"""A bag that is recorded in parallel to the control loop: by ``record_node`` in a process of its own, which costs the
loop no time and ends when the node that replays does."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from rclpy.node import Node

from sim_core.errors import ConfigError

STOP_S = 120.0
"""Time [s] that the recorder gets to finish its bag: reached only by one that hangs, however busy the machine."""


class Recording:
    """Records topics, whose full names are given, from its start until :meth:`stop`."""

    def __init__(self, owner: Node, topics: Sequence[str], rig: str, uri: str) -> None:
        """``owner``: the node that it is named after; ``rig``: kept in the bag, '' for none; ``uri``: new bag, by date
        and time where it is empty.

        Raises:
            ConfigError: the bag exists.
        """
        self.bag = Path(uri or time.strftime("replay_%Y%m%d_%H%M%S")).expanduser().absolute()
        if os.path.lexists(self.bag):
            raise ConfigError(f"{self.bag} exists already.", "Set record_uri to another path, or move it away first.")
        self.name = f"{owner.get_name()}_recorder"
        given = {"uri": self.bag, "rig": rig, "topics": f"[{', '.join(dict.fromkeys(topics))}]"}
        given["use_sim_time"] = str(bool(owner.get_parameter("use_sim_time").value)).lower()
        words = ["--ros-args", "-r", f"__node:={self.name}", "-r", f"__ns:={owner.get_namespace()}"]
        words += ["-r", f"/clock:={owner.resolve_topic_name('/clock')}"]
        for name, value in given.items():
            words += ["-p", f"{name}:={value}"] if value else []
        context = multiprocessing.get_context("spawn")
        self._process = context.Process(target=record, args=(words,), name="recorder", daemon=True)
        self._process.start()

    def fault(self) -> str:
        """That it has ended by itself, '' while it runs."""
        return "" if self._process.is_alive() else f"The recorder ended with code {self._process.exitcode}."

    def stop(self) -> str:
        """Finish the bag; returns what became of it."""
        fault = self.fault()
        if not fault and self._process.pid is not None:
            os.kill(self._process.pid, signal.SIGINT)
        self._process.join(STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        code = self._process.exitcode
        return fault or (f"Recorded {self.bag}." if code == 0 else f"The recorder ended with code {code}: {self.bag}.")


def record(words: list[str]) -> None:
    """What the process does: record until it is asked to end, or the process that started it is no more."""
    from thinshell_ros import record_node

    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=watch, daemon=True).start()
    sys.exit(record_node.main(words))
