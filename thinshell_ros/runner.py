"""How every node starts, what makes it end, and with which exit code."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import ok, try_shutdown

from sim_core.errors import ThinshellError
from thinshell_ros.command import report_error

DRAIN_S = 0.3
"""Time [s] in which a node that has been asked to end takes what has already arrived."""


def run(make: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Spin a node until SIGINT, SIGTERM or shutdown: 0. A node that cannot be used as configured: 2.

    A node joins what it started in its ``destroy_node``.
    """
    rclpy.init(args=None if args is None else list(args))
    node: Node | None = None
    code = 0
    try:
        node = make()
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except ThinshellError as error:
        code = report_error(error)
    except Exception:
        if ok():
            raise
        # else a callback was publishing when a signal shut the context down
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):  # launch sends a second one
            signal.signal(number, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        try_shutdown()
    return code


class FinishingNode(Node):
    """A node whose work is not done when it is asked to end."""

    def stop_requested(self) -> None:
        """What must be done at once; nothing by default."""

    def finish(self) -> int:
        """Bring the work to its end; returns the exit code."""
        raise NotImplementedError


def run_and_finish(make: Callable[[], FinishingNode], args: Sequence[str] | None = None) -> int:
    """Like :func:`run`, but a signal does not cut the node off from what has already arrived.

    Its ``stop_requested`` is called at once; it goes on for ``DRAIN_S``, then its ``finish`` gives the exit code.
    """
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda which, frame: signals.append(which))
    rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
    node: FinishingNode | None = None
    code = 0
    try:
        node = make()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not signals and ok():
            executor.spin_once(timeout_sec=0.1)
        if ok():
            node.stop_requested()
        end = time.monotonic() + DRAIN_S
        while time.monotonic() < end and ok():
            executor.spin_once(timeout_sec=0.02)
        code = node.finish()
    except ExternalShutdownException:
        pass
    except ThinshellError as error:
        code = report_error(error)
    finally:
        if node is not None:
            node.destroy_node()
        try_shutdown()
    return code
