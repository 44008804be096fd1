"""What rollouts cost, measured while they run: by kind, since one with derivatives or on finer cells takes longer."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock

from sysid.settings.progress import PROGRESS

OnStep = Callable[[int, int], None]
"""Called after each step of a rollout, with the number of those made and of all."""


@dataclass(frozen=True)
class Kind:
    """Kind of a rollout. ``derivatives``: with derivatives by parameters; ``responses``: with responses to effects as
    well; ``finer``: on cells half as large; ``shorter``: with shorter time steps; ``beginning``: of the first instants
    of a recording alone."""

    derivatives: bool = False
    responses: bool = False
    beginning: bool = False
    finer: bool = False
    shorter: bool = False

    @property
    def expected_ratio(self) -> float:
        """Its cost over that of a plain rollout, before any of the kind has run."""
        ratio = PROGRESS.finer_cost_ratio if self.finer else 1.0
        ratio *= PROGRESS.shorter_cost_ratio if self.shorter else 1.0
        ratio *= PROGRESS.beginning_cost_ratio if self.beginning else 1.0
        if self.responses:
            return ratio * PROGRESS.responses_cost_ratio
        return ratio * (PROGRESS.derivatives_cost_ratio if self.derivatives else 1.0)


def kind_of(words: str) -> Kind:
    """The kind of such a name: "plain", or what it has, as "finer derivatives"."""
    return Kind(**dict.fromkeys(words.split(), True)) if words != "plain" else Kind()


@dataclass
class Running:
    """A rollout that runs. ``since``, ``spent`` [s]: processor time of its thread when it began, and since then;
    ``share``: of its steps that are made, 0 to 1; ``first``: both after its first step."""

    kind: Kind
    since: float
    spent: float = 0.0
    share: float = 0.0
    first: tuple[float, float] | None = None

    def stepped(self, spent: float, share: float) -> None:
        """A step was made."""
        self.spent, self.share = spent, share
        self.first = self.first or (spent, share)

    def seconds(self) -> float | None:
        """What all of it takes [s], by its steps after the first one, before which its scene is built. None before the
        second one."""
        if self.first is None or self.share <= self.first[1]:
            return None
        spent, share = self.first
        return spent + (self.spent - spent) * (1.0 - share) / (self.share - share)


class RolloutCosts:
    """Rollouts of a command that ran and that run, and the processor time that they took: other work on the machine
    does not change it. Each rollout is measured on the thread that makes it.

    ``on_news``: called where there is something new, on that thread. ``clock``: processor time [s] of a thread.
    """

    def __init__(
        self, on_news: Callable[[], None] | None = None, clock: Callable[[], float] = time.thread_time
    ) -> None:
        self._on_news, self._clock = on_news, clock
        self._lock = Lock()
        self._running: list[Running] = []
        self._took: dict[Kind, list[float]] = {}

    @contextmanager
    def rollout(self, kind: Kind) -> Iterator[OnStep]:
        """A rollout is made within the block; what is to be called after each of its steps."""
        here = Running(kind, self._clock())
        with self._lock:
            self._running.append(here)

        def on_step(done: int, total: int) -> None:
            here.stepped(self._clock() - here.since, done / max(total, 1))
            self._notify()

        try:
            yield on_step
        finally:
            with self._lock:
                self._running.remove(here)
                self._took.setdefault(kind, []).append(self._clock() - here.since)
            self._notify()

    def _notify(self) -> None:
        if self._on_news is not None:
            self._on_news()

    def count(self, kind: Kind) -> float:
        """Rollouts of a kind that were made, those that run with the share of their steps."""
        with self._lock:
            return len(self._took.get(kind, ())) + sum(r.share for r in self._running if r.kind == kind)

    def busy(self) -> float:
        """Processor time [s] of all rollouts together until now."""
        with self._lock:
            return sum(map(sum, self._took.values())) + sum(r.spent for r in self._running)

    def seconds(self, kind: Kind) -> float | None:
        """What a rollout of a kind takes [s]: the mean over the later half of those of its kind, where none has been
        made from one that runs or from other kinds; None where nothing is known yet."""
        with self._lock:
            late = {k: t[len(t) // 2 :] for k, t in self._took.items()}
            running = {r.kind: s for r in self._running if (s := r.seconds()) is not None}
        known = running | {k: sum(t) / len(t) for k, t in late.items()}
        if kind in known or not known:
            return known.get(kind)
        ratios = [seconds * kind.expected_ratio / k.expected_ratio for k, seconds in known.items()]
        return sum(ratios) / len(ratios)
