"""The time that is left of some work, as it says itself or from the shares of it that are done."""

from __future__ import annotations

import math

from sysid.settings.progress import PROGRESS


class TimeLeft:
    """How long work goes on, at instants [s] since it began."""

    def __init__(self) -> None:
        self._done = [(0.0, 0.0)]
        self._estimate: tuple[float, float] | None = None

    def update(self, now: float, share: float) -> None:
        """So much is done."""
        if share > self._done[-1][1]:
            self._done.append((now, share))

    def set_estimate(self, now: float, seconds: float) -> None:
        """Estimate by the work itself of how long [s] it goes on."""
        self._estimate = (now, seconds)

    def seconds(self, now: float) -> float | None:
        """Time left [s]; None where nothing is known of it yet, or all is done.

        Where the work has not said it, it is the geometric mean of what follows from the rates over all of the time,
        over its later half, and over that of the work. Of what goes on for longer than expected some is left.
        """
        at, share = self._done[-1]
        if share >= 1.0:
            return None
        if self._estimate is not None:
            at, left = self._estimate
        elif share > 0.0 and at >= PROGRESS.least_time_s:
            late = [next(d for d in reversed(self._done) if d[k] <= 0.5 * self._done[-1][k]) for k in (0, 1)]
            rates = [(1.0 - share) * (at - t) / (share - s) for t, s in ((0.0, 0.0), *late)]
            left = math.prod(rates) ** (1.0 / len(rates))
        else:
            return None
        return max(left - (now - at), PROGRESS.overdue_share * left)


def in_words(seconds: float | None, share: float) -> str:
    """A time left [s] in words; nothing where a ``share`` of 1 of the work is done."""
    if share >= 1.0:
        return ""
    if seconds is None:
        return "time left known once simulations have begun"
    if seconds < 100.0:
        return f"about {max(seconds, 1.0):.0f} s left"
    minutes = seconds / 60.0
    return f"about {minutes:.0f} min left" if minutes < 100.0 else f"about {minutes / 60.0:.1f} h left"
