"""Progress on the terminal: a bar where someone is looking, elsewhere a line at once, every ten percent, and after each
nine seconds of silence."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Lock, Thread

from sim_core.core.build import on_compiling
from sysid.progress.callback import TimedProgress
from sysid.progress.interrupts import raise_remembered
from sysid.progress.time_left import TimeLeft, in_words
from sysid.settings.progress import PROGRESS


def warn(text: str) -> None:
    """Say a warning on stderr, at once."""
    print(f"warning: {text}", file=sys.stderr, flush=True)


@contextmanager
def progress(title: str) -> Iterator[TimedProgress]:
    """Show progress on stderr while the block runs, and what is compiled for the first time. Raises
    ``KeyboardInterrupt`` for one that was swallowed before."""
    raise_remembered()
    shown: Lines | _Bar
    if sys.stderr.isatty():
        with _bar(title) as shown, _compiling(shown.say):
            yield shown
        return
    shown = Lines(title)
    ended = Event()
    watch = Thread(target=_watch, args=(shown, ended), daemon=True)
    watch.start()
    try:
        with _compiling(shown.say):
            yield shown
    finally:
        ended.set()
        watch.join()


@contextmanager
def _compiling(say: Callable[[str], None]) -> Iterator[None]:
    """Within the block ``say`` is called with what is compiled."""
    on_compiling.append(say)
    try:
        yield
    finally:
        on_compiling.remove(say)


def _watch(lines: Lines, ended: Event) -> None:
    """Says where work stands after each silence, until it has ended."""
    while not ended.wait(max(0.1, lines.silent_for())):
        lines.still()


class _Bar:
    """A bar of ``rich``. ``show``: takes the share, the time left in words, and what is being done; ``say``: a line
    above the bar."""

    def __init__(self, show: Callable[[float, str, str], None], say: Callable[[str], None]) -> None:
        self._show, self._left, self._started = show, TimeLeft(), time.monotonic()
        self.say = say

    def __call__(self, share: float, text: str) -> None:
        """So much is done; what is being done."""
        now = time.monotonic() - self._started
        self._left.update(now, share)
        self._show(share, in_words(self._left.seconds(now), share), text)

    def time_left(self, seconds: float) -> None:
        """So much time [s] is left."""
        self._left.set_estimate(time.monotonic() - self._started, seconds)


@contextmanager
def _bar(title: str) -> Iterator[_Bar]:
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
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=1.0, words="", left="")

        def show(share: float, left: str, text: str) -> None:
            bar.update(task, completed=share, words=text, left=left)

        yield _Bar(show, bar.console.print)


def share_of_line(line: str) -> float | None:
    """The share that is done, of a line that :class:`Lines` has said; None of another line."""
    found = re.match(r"[\w -]+: (\d+) % after \d+ s", line)
    return None if found is None else float(found[1]) / 100.0


class Lines:
    """Lines on stderr. ``clock``: seconds."""

    def __init__(self, title: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._title, self._clock = title, clock
        self._started = self._heard = clock()
        self._tenth, self._share, self._text = -1, 0.0, ""
        self._left = TimeLeft()
        self._lock = Lock()

    def __call__(self, share: float, text: str) -> None:
        """So much is done; what is being done."""
        with self._lock:
            now = self._clock()
            self._share, self._text = share, text
            self._left.update(now - self._started, share)
            if int(10 * share) > self._tenth or now - self._heard >= PROGRESS.silence_s:
                self._say(now)

    def say(self, text: str) -> None:
        """A line with something else than how far it is."""
        with self._lock:
            print(f"{self._title}: {text}", file=sys.stderr, flush=True)

    def time_left(self, seconds: float) -> None:
        """So much time [s] is left."""
        with self._lock:
            self._left.set_estimate(self._clock() - self._started, seconds)

    def still(self) -> None:
        """Nothing was reported; a line where the last one is long ago."""
        with self._lock:
            now = self._clock()
            if now - self._heard >= PROGRESS.silence_s and self._share < 1.0:
                self._say(now)

    def silent_for(self) -> float:
        """Seconds until a line is due."""
        return self._heard + PROGRESS.silence_s - self._clock()

    def _say(self, now: float) -> None:
        self._tenth, self._heard = max(int(10 * self._share), self._tenth), now
        spent = now - self._started
        left = in_words(self._left.seconds(spent), self._share)
        line = f"{self._title}: {100 * self._share:.0f} % after {spent:.0f} s{left and f', {left}'}: {self._text}"
        print(line.removesuffix(": "), file=sys.stderr, flush=True)
