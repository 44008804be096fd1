"""Work in stages, each weighed by the rollouts that it is expected to need and by what rollouts were measured to cost.

A stage says how many rollouts of which kind each recording needs in it, as counted over fits and diagnoses of several
rigs, and the processor time that goes on between them. What rollouts take is measured while the first ones run, step by
step, so that the time left is known before one has ended. How many processors a command has, next to what else runs on
the machine, is the ratio of the time that has passed to the processor time of the process, over the later half.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from threading import RLock

from sysid.progress.callback import Progress, TimedProgress, silent
from sysid.progress.rollout_costs import Kind, RolloutCosts, kind_of
from sysid.settings.progress import PROGRESS


@dataclass(frozen=True)
class Stage:
    """A stage of some work. ``rollouts``: how many of each kind it needs for each recording, about; ``between_s``:
    processor time [s] that it takes besides."""

    name: str
    rollouts: Mapping[Kind, float]
    between_s: float = 0.0


@dataclass
class _Open:
    """The stage that is on: its number, rollouts of each kind and processor time between rollouts until it began, and
    the rollouts that it needs."""

    number: int
    before: Mapping[Kind, float]
    between: float
    rollouts: Mapping[Kind, float]


def stages_of(rollouts: Mapping[str, Mapping[str, float]], between_s: Mapping[str, float]) -> list[Stage]:
    """Stages in their order from how many rollouts of each kind each of them needs for a recording, and the processor
    time [s] besides."""
    return [
        Stage(name, {kind_of(words): count for words, count in kinds.items()}, between_s[name])
        for name, kinds in rollouts.items()
    ]


class Work:
    """Reports how far the work of some stages is, to ``report``. ``recordings``: how many it is about.

    Stages are entered in their order; some may be left out. ``costs``: measures rollouts.
    """

    def __init__(
        self,
        report: Progress | None,
        stages: Sequence[Stage],
        recordings: int,
        *,
        clock: Callable[[], float] = time.monotonic,
        processor: Callable[[], float] = time.process_time,
    ) -> None:
        self._report, self._stages, self._recordings = report or silent, list(stages), recordings
        self._clock, self._processor = clock, processor
        self._started, self._spent = clock(), processor()
        self._course = [(self._started, self._spent)]
        self._lock = RLock()
        self._said, self._share, self._text = float("-inf"), 0.0, ""
        self.costs = RolloutCosts(self._news)
        self._open = _Open(0, {}, 0.0, self._stages[0].rollouts)

    def enter(self, stage: str, text: str = "") -> None:
        """A stage begins; those before it have ended. ``text``: what is being done, the name of the stage if empty."""
        with self._lock:
            number = [s.name for s in self._stages].index(stage)
            before = {k: self.costs.count(k) for s in self._stages for k in s.rollouts}
            self._open = _Open(number, before, self._between(), self._stages[number].rollouts)
            self._text = text or stage
            self._say()

    def say(self, text: str, rollouts: Mapping[Kind, float] | None = None) -> None:
        """What is being done now. ``rollouts``: how many the stage that is on needs in all for each recording, where
        more is known of it."""
        with self._lock:
            self._text = text
            self._open.rollouts = rollouts or self._open.rollouts
            self._say()

    def done(self) -> None:
        """All of it is done."""
        with self._lock:
            self._report(1.0, "done")

    def remaining(self) -> float | None:
        """Time left [s], None where no rollout has shown what it costs."""
        with self._lock:
            left = 0.0
            for number, stage in enumerate(self._stages[self._open.number :], self._open.number):
                on = number == self._open.number
                done = self._between() - self._open.between if on else 0.0
                left += _left(stage.between_s, done)
                for kind, count in (self._open.rollouts if on else stage.rollouts).items():
                    seconds = self.costs.seconds(kind)
                    if seconds is None:
                        return None
                    done = self.costs.count(kind) - self._open.before.get(kind, 0.0) if on else 0.0
                    left += seconds * _left(count * self._recordings, done)
            return left * self._pace()

    def _pace(self) -> float:
        """Time that passes for each second of the process, over the later half of the time."""
        now, spent = self._clock(), self._processor()
        middle = 0.5 * (self._started + now)
        at, then = next(known for known in reversed(self._course) if known[0] <= middle)
        return (now - at) / (spent - then) if spent > then else 1.0

    def _between(self) -> float:
        """Processor time [s] between rollouts until now."""
        return self._processor() - self._spent - self.costs.busy()

    def _news(self) -> None:
        """Something new of rollouts."""
        if self._clock() - self._said >= PROGRESS.least_pause_s:
            with self._lock:
                self._say()

    def _say(self) -> None:
        now = self._clock()
        self._said = now
        self._course.append((now, self._processor()))
        left = self.remaining()
        if left is not None:
            passed = now - self._started
            self._share = max(self._share, min(passed / max(passed + left, 1e-9), PROGRESS.most_share))
            if isinstance(self._report, TimedProgress):
                self._report.time_left(left)
        self._report(self._share, self._text)


def work_of(
    progress: Progress | Work | None,
    rollouts: Mapping[str, Mapping[str, float]],
    between_s: Mapping[str, float],
    recordings: int,
) -> Work:
    """The work that is going on, or new work of some stages (:func:`stages_of`) that reports to ``progress``."""
    return progress if isinstance(progress, Work) else Work(progress, stages_of(rollouts, between_s), recordings)


def _left(expected: float, done: float) -> float:
    """What is left of what a stage is expected to need: some, while it goes on."""
    return max(expected - done, PROGRESS.overdue_share * expected)
