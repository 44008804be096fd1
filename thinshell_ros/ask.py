"""Ask a running ``sysid_node`` for a job, and wait for its end.

    python -m thinshell_ros.ask fit bag_uri=recording fit.parameters=[strip.E] --node /tactile_sysid

Parameters of the node are set first; they stay set. Progress goes to the standard error stream and the folder of the
results to the standard output, so that a shell can keep it. SIGINT and SIGTERM cancel the job.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from collections.abc import Sequence
from typing import Any

from sim_core.errors import ConfigError, WorkerError
from thinshell_ros.command import command
from thinshell_ros.node_client import SERVICE_S, NodeClient

SERVICES = {name: name for name in ("diagnose", "plan", "optimise", "resume")} | {"fit": "start"}
"""Services of the node by the jobs that they begin."""

OVER = ("succeeded", "cancelled", "failed")
JOB_S = 7 * 86400.0
"""Longest time [s] for a job."""

REPORT_S = 10.0
"""Time [s] after which progress is printed again."""


def ask(client: NodeClient, node: str, job: str) -> dict[str, Any]:
    """Begin a job and wait for its end: its result, as ``~/result`` has it. ``node``: name of the ``sysid_node``.

    Raises:
        ConfigError: the job is refused.
        WorkerError: it failed, was cancelled, or the node does not respond.
    """
    from diagnostic_msgs.msg import DiagnosticStatus
    from std_msgs.msg import String

    from thinshell_ros.qos import LATCHED

    statuses: list[Any] = []
    results: list[Any] = []
    client.node.create_subscription(DiagnosticStatus, f"{node}/status", statuses.append, LATCHED)
    client.node.create_subscription(String, f"{node}/result", results.append, LATCHED)
    begun = client.trigger(f"{node}/{SERVICES[job]}")
    if not begun.success:
        raise ConfigError(begun.message)
    number, shown = begun.message, Shown()

    def over() -> bool:
        mine = [(s.message, v) for s in statuses if (v := {p.key: p.value for p in s.values})["job_id"] == number]
        statuses.clear()
        for state, values in mine:
            if state in OVER:
                ended.append((state, values["detail"]))
            else:
                shown.say(values)
        return bool(ended)

    def result() -> dict[str, Any] | None:
        found = (json.loads(message.data) for message in results)
        return next((one for one in found if one["job_id"] == number), None)

    ended: list[tuple[str, str]] = []
    try:
        client.until(over, f"end of {number}", JOB_S)
    except KeyboardInterrupt:
        print(client.trigger(f"{node}/cancel").message, file=sys.stderr)
        raise
    state, detail = ended[-1]
    if state != "succeeded":
        raise WorkerError(f"{number} {'was ' if state == 'cancelled' else ''}{state}: {detail}")
    print(f"{number} succeeded: {detail}", file=sys.stderr, flush=True)
    client.until(lambda: result() is not None, f"result of {number}", SERVICE_S)
    return result() or {}


class Shown:
    """Prints progress where it is new, or some time has passed."""

    def __init__(self) -> None:
        self._last, self._at = "", 0.0

    def say(self, values: dict[str, str]) -> None:
        """Print what a status says: what is being done, and the time left if it is known."""
        doing, now = values["detail"], time.monotonic()
        if doing == self._last and now - self._at < REPORT_S:
            return
        self._last, self._at = doing, now
        left = float(values["eta_s"])
        rest = f", about {left:.0f} s left" if left == left else ""
        print(f"{values['job_id']}: {doing}{rest}", file=sys.stderr, flush=True)


def assigned(words: Sequence[str]) -> dict[str, str]:
    """Values of parameters by name, of words NAME=VALUE.

    Raises:
        ConfigError: a word is none.
    """
    found = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not (name and equals):
            raise ConfigError(f"{word!r} sets no parameter.", "Write NAME=VALUE, as in bag_uri=recording.")
        found[name] = value
    return found


def _interrupted(*_: object) -> None:
    raise KeyboardInterrupt


@command
def main(arguments: Sequence[str]) -> None:
    """Ask, report, and print the folder of the results."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0] if __doc__ else "")
    parser.add_argument("job", choices=sorted(SERVICES), help="what is asked for")
    parser.add_argument("values", nargs="*", metavar="NAME=VALUE", help="parameters of the node to set before")
    parser.add_argument("--node", default="/tactile_sysid", help="full name of the node (default: %(default)s)")
    given = parser.parse_args(arguments)
    values = assigned(given.values)
    with NodeClient("job_client") as client:
        for number in (signal.SIGINT, signal.SIGTERM):  # handlers of ROS would end its context before the job
            signal.signal(number, _interrupted)
        try:
            client.set_parameters(given.node, values)
            found = ask(client, given.node, given.job)
        except KeyboardInterrupt:
            raise WorkerError(
                "The wait for the job was interrupted.", "Ask for 'resume' to go on with a fit or a search."
            ) from None
    print(found["output_dir"], flush=True)


if __name__ == "__main__":
    sys.exit(main())
