"""How far work is and how long it takes: what every long command reports, and where it is shown."""

from sysid.progress.callback import Progress, TimedProgress, silent
from sysid.progress.interrupts import interrupts_remembered, interrupts_reported
from sysid.progress.terminal import progress, warn

__all__ = [
    "Progress",
    "TimedProgress",
    "interrupts_remembered",
    "interrupts_reported",
    "progress",
    "silent",
    "warn",
]
