"""Readings of one topic: whether they come, and whether they are new. No ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Instant:
    """The same moment by a steady clock and by that of ROS [s]."""

    steady_s: float
    ros_s: float


@dataclass
class Stream:
    """Readings of one topic. ``heard``: when the last good one arrived; ``fault``: what is wrong with the last one."""

    name: str
    timeout_s: float
    check_stamps: bool
    heard: Instant | None = None
    stamp: float = -math.inf
    fault: str = ""

    def take(self, now: Instant, stamp_s: float, fault: str, running: bool) -> bool:
        """Count a reading that has arrived; returns whether it is a good one.

        In a run, one that is not newer than the last one does not count: a driver that hangs may repeat itself. Before
        a run, time may begin anew.
        """
        if self.check_stamps:
            if stamp_s <= 0.0:
                fault = (
                    fault or f"{head(self.name)} has no stamp. Have its publisher stamp it, or leave check_stamps out."
                )
            elif running and stamp_s <= self.stamp:
                return False
        self.fault = fault
        if fault:
            return False
        self.heard, self.stamp = now, stamp_s
        return True

    def silence(self, now: Instant, simulated_time: bool) -> str:
        """What is wrong with its age, '' if nothing is. With simulated time that is all that ages a reading."""
        if self.heard is None:
            return f"No reading of {self.name} has come. Check its topic and that it is published."
        age = now.ros_s - self.heard.ros_s if simulated_time else now.steady_s - self.heard.steady_s
        most = self.timeout_s
        if age > most:
            return f"The last reading of {self.name} came {age:.3f} s ago, at most {most:g} s is allowed."
        old = now.ros_s - self.stamp
        if self.check_stamps and abs(old) > most:
            if age > 0.5 * old > 0.0:
                return f"The last reading of {self.name} is from {old:.3f} s ago, at most {most:g} s is allowed."
            when = "old" if old > 0.0 else "in the future"
            return (
                f"The stamp of {self.name} is {abs(old):.3f} s {when}, at most {most:g} s is allowed. "
                "Synchronise the clocks of the machines."
            )
        return ""


def head(words: str) -> str:
    """Words that begin a sentence."""
    return words[0].upper() + words[1:]
