"""Progress on the terminal: a bar where someone is looking, elsewhere a line at once, every ten percent, and after each
minute of silence.

Both estimate the time that is left from the share that is done.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, current_thread, main_thread
from types import FrameType

ProgressCallback = Callable[[float, str], None]
"""Called with the share of the work that is done (0 to 1) and a word on what is being done."""

_pressed = Event()
"""Ctrl-C was pressed while :func:`interrupts_remembered`."""

SILENCE_S = 60.0
"""A line comes after so long without one."""


def warn(text: str) -> None:
    """Say a warning on stderr, at once."""
    print(f"warning: {text}", file=sys.stderr, flush=True)


@contextmanager
def progress(title: str) -> Iterator[ProgressCallback]:
    """Show progress on stderr while the block runs. Raises ``KeyboardInterrupt`` for one that was swallowed before."""
    if _pressed.is_set():
        raise KeyboardInterrupt
    if sys.stderr.isatty():
        with _bar(title) as report:
            yield report
    else:
        yield _lines(title)


@contextmanager
def _bar(title: str) -> Iterator[ProgressCallback]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
    from rich.table import Column

    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=16, table_column=Column(min_width=16)),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(table_column=Column(min_width=7)),
        TextColumn("{task.fields[words]}", table_column=Column(no_wrap=True)),  # cut where the terminal is narrow
    )
    speed_over_s = 3600.0  # of the whole: shares may come far apart
    with Progress(*columns, console=Console(stderr=True), transient=True, speed_estimate_period=speed_over_s) as bar:
        task = bar.add_task(title, total=1.0, words="")
        yield lambda share, text: bar.update(task, completed=share, words=text)


def _lines(title: str) -> ProgressCallback:
    started = heard = time.monotonic()
    last = -1

    def report(share: float, text: str) -> None:
        nonlocal last, heard
        tenth, now = int(10 * share), time.monotonic()
        if tenth > last or now - heard > SILENCE_S:
            last, heard = max(tenth, last), now
            spent = now - started
            left = f", about {spent * (1.0 / share - 1.0):.0f} s left" if tenth and share < 1.0 else ""
            print(f"{title}: {100 * share:.0f} % after {spent:.0f} s{left}: {text}".removesuffix(": "), file=sys.stderr)

    return report


@contextmanager
def interrupts_remembered() -> Iterator[None]:
    """What swallows Ctrl-C in the block, as decorators of kernels do in imports, delays it until :func:`progress`."""
    try:
        with _answered(lambda: None, _pressed):
            yield
    finally:
        _pressed.clear()


@contextmanager
def interrupts_told(words: str) -> Iterator[Event]:
    """Ctrl-C within the block is answered with ``words`` on stderr and sets the event, before it does anything."""
    pressed = Event()
    with _answered(lambda: print(f"\n{words}", file=sys.stderr, flush=True), pressed):
        yield pressed


@contextmanager
def _answered(say: Callable[[], None], pressed: Event) -> Iterator[None]:
    """Ctrl-C within the block sets the event and calls ``say`` before it does what it did; where it did nothing, or in
    a thread, it does nothing here."""
    before = signal.getsignal(signal.SIGINT)
    if not callable(before) or current_thread() is not main_thread():
        yield
        return

    def answered(number: int, frame: FrameType | None) -> None:
        pressed.set()
        with suppress(OSError, RuntimeError):  # nobody reads it any more, or it is being written to
            say()
        before(number, frame)

    signal.signal(signal.SIGINT, answered)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
