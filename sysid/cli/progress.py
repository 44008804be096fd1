"""Progress on the terminal: a bar where someone is looking, elsewhere a line at once, every ten percent, and after each
nine seconds of silence.

The time that is left is said only where it can be known: where the work said that its shares take time in proportion,
and the rate of all that is done agrees with the rate of late. Otherwise it is said to be unknown.
"""

from __future__ import annotations

import math
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Lock, Thread, current_thread, main_thread
from types import FrameType

ProgressCallback = Callable[[float, str], None]
"""Called with the share of the work that is done (0 to 1) and a word on what is being done."""

_pressed = Event()
"""Ctrl-C was pressed while :func:`interrupts_remembered`."""

SILENCE_S = 9.0
"""A line comes after so long without one."""

AGREE = 1.5
"""Factor within which the rate of all that is done and that of late must agree for the time left to be known."""

LEAST_SHARE, LEAST_S = 0.1, 2.0
"""What must be done, and how long that took, before the time left is estimated."""


def warn(text: str) -> None:
    """Say a warning on stderr, at once."""
    print(f"warning: {text}", file=sys.stderr, flush=True)


class TimeLeft:
    """How long work goes on, from the shares that are done at instants [s] since it began."""

    def __init__(self) -> None:
        self._done = [(0.0, 0.0)]

    def update(self, now: float, share: float) -> None:
        """So much is done."""
        if share > self._done[-1][1]:
            self._done.append((now, share))

    def seconds(self, now: float) -> float | None:
        """Time left [s] at an instant; None where it is not known: too little is done, the rates over all, over the
        later half of the time and over that of the work do not agree, or nothing has come for longer than they let
        expect."""
        at, share = self._done[-1]
        if share < LEAST_SHARE or at < LEAST_S or share >= 1.0:
            return None
        late = [next(d for d in reversed(self._done) if d[k] <= 0.5 * self._done[-1][k]) for k in (0, 1)]
        estimates = [(1.0 - share) * (at - t) / (share - s) for t, s in ((0.0, 0.0), *late)]
        if max(estimates) > AGREE * min(estimates):
            return None
        left = math.prod(estimates) ** (1.0 / len(estimates)) - (now - at)
        return left if left > 0.0 else None


@contextmanager
def progress(title: str, timed: bool = True) -> Iterator[ProgressCallback]:
    """Show progress on stderr while the block runs. ``timed``: shares of the work take time in proportion, so that the
    time left may be estimated. Raises ``KeyboardInterrupt`` for one that was swallowed before."""
    if _pressed.is_set():
        raise KeyboardInterrupt
    if sys.stderr.isatty():
        with _bar(title, timed) as report:
            yield report
        return
    lines = Lines(title, timed)
    ended = Event()
    watch = Thread(target=_watch, args=(lines, ended), daemon=True)
    watch.start()
    try:
        yield lines.report
    finally:
        ended.set()
        watch.join()


def _watch(lines: Lines, ended: Event) -> None:
    """Says where work stands after each silence, until it has ended."""
    while not ended.wait(max(0.1, lines.silent_for())):
        lines.still()


@contextmanager
def _bar(title: str, timed: bool) -> Iterator[ProgressCallback]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.table import Column

    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=16, table_column=Column(min_width=16)),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
        TextColumn("{task.fields[words]}", table_column=Column(no_wrap=True)),  # cut where the terminal is narrow
    )
    clock, started = TimeLeft(), time.monotonic()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=1.0, words="", left="")

        def report(share: float, text: str) -> None:
            now = time.monotonic() - started
            clock.update(now, share)
            bar.update(task, completed=share, words=text, left=_left(clock.seconds(now) if timed else None, share))

        yield report


class Lines:
    """Lines on stderr. ``clock``: seconds."""

    def __init__(self, title: str, timed: bool = True, clock: Callable[[], float] = time.monotonic) -> None:
        self._title, self._timed, self._clock = title, timed, clock
        self._started = self._heard = clock()
        self._tenth, self._share, self._text = -1, 0.0, ""
        self._left = TimeLeft()
        self._lock = Lock()

    def report(self, share: float, text: str) -> None:
        """So much is done; what is being done."""
        with self._lock:
            now = self._clock()
            self._share, self._text = share, text
            self._left.update(now - self._started, share)
            if int(10 * share) > self._tenth or now - self._heard >= SILENCE_S:
                self._say(now)

    def still(self) -> None:
        """Nothing was reported; a line where the last one is long ago."""
        with self._lock:
            now = self._clock()
            if now - self._heard >= SILENCE_S and self._share < 1.0:
                self._say(now)

    def silent_for(self) -> float:
        """Seconds until a line is due."""
        return self._heard + SILENCE_S - self._clock()

    def _say(self, now: float) -> None:
        self._tenth, self._heard = max(int(10 * self._share), self._tenth), now
        spent = now - self._started
        left = _left(self._left.seconds(spent) if self._timed else None, self._share)
        line = f"{self._title}: {100 * self._share:.0f} % after {spent:.0f} s{left and f', {left}'}: {self._text}"
        print(line.removesuffix(": "), file=sys.stderr, flush=True)


def _left(seconds: float | None, share: float) -> str:
    """The time left in words; nothing at the end."""
    if share >= 1.0:
        return ""
    return "time left unknown" if seconds is None else f"about {seconds:.0f} s left"


@contextmanager
def interrupts_remembered() -> Iterator[None]:
    """What swallows Ctrl-C in the block, as decorators of kernels do in imports, delays it until :func:`progress`."""
    try:
        with _answered(lambda: None, _pressed):
            yield
    finally:
        _pressed.clear()


@contextmanager
def interrupts_reported(words: str) -> Iterator[Event]:
    """Ctrl-C within the block is answered with ``words`` on stderr and sets the event, before it does anything. Pressed
    a second time, while what was found is written, it does nothing but that."""
    pressed = Event()
    with _answered(lambda: print(f"\n{words}", file=sys.stderr, flush=True), pressed, once=True):
        yield pressed


@contextmanager
def _answered(say: Callable[[], None], pressed: Event, once: bool = False) -> Iterator[None]:
    """Ctrl-C within the block sets the event and calls ``say`` before it does what it did; where it did nothing, or in
    a thread, it does nothing here. ``once``: pressed a second time it does not do what it did."""
    presses = 0
    before = signal.getsignal(signal.SIGINT)
    if not callable(before) or current_thread() is not main_thread():
        yield
        return

    def answered(number: int, frame: FrameType | None) -> None:
        nonlocal presses
        presses += 1
        pressed.set()
        with suppress(OSError, RuntimeError):  # nobody reads it any more, or it is being written to
            say()
        if not (once and presses == 2):
            before(number, frame)

    signal.signal(signal.SIGINT, answered)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
