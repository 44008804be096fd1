"""What work reports while it runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

Progress = Callable[[float, str], None]
"""Called with the share of the work that is done (0 to 1, in proportion to the time that it takes) and a word on what
is being done."""


@runtime_checkable
class TimedProgress(Protocol):
    """Progress that takes the time left as well, from work that estimates it better than its share does."""

    def time_left(self, seconds: float) -> None:
        """So much time [s] is left from now on, about."""

    def __call__(self, share: float, text: str) -> None:
        """As :data:`Progress`."""


def silent(share: float, text: str) -> None:
    """Progress that nobody looks at."""
