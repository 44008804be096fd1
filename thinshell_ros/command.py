"""What commands and nodes do with the errors of the package: one paragraph, and an exit code. No ROS."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import wraps

from sim_core.errors import ThinshellError

UNUSABLE = 2
"""Exit code where a command, or a node, cannot be used as it was called."""


def report_error(error: ThinshellError) -> int:
    """Print an error, and return the exit code."""
    print(f"error: {error}", file=sys.stderr)
    return UNUSABLE


def command(work: Callable[[Sequence[str]], None]) -> Callable[..., int]:
    """A command, which takes its arguments (default: those of the command line) and returns its exit code."""

    @wraps(work)
    def main(arguments: Sequence[str] | None = None) -> int:
        try:
            work(sys.argv[1:] if arguments is None else list(arguments))
        except ThinshellError as error:
            return report_error(error)
        return 0

    return main
