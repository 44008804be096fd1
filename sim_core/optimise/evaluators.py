"""Where the rollouts of a search are made: in this process, or in several at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from sim_core.batch import worker_pool
from sim_core.tasks.load import MadeTask
from sim_core.tasks.rollout import Outcome, TaskRollouts

Parameters = Mapping[str, float]
"""Values of named parameters of a rig."""


@dataclass(frozen=True)
class Request:
    """A rollout to be made: of an ``action`` ``(size,)`` on a rig with ``parameters``, with or without ``gradient``."""

    action: np.ndarray
    gradient: bool = False
    parameters: Parameters | None = None


class Evaluator(Protocol):
    """Makes rollouts. ``size``: of an action."""

    size: int
    workers: int

    def outcomes(self, requests: Sequence[Request]) -> list[Outcome]:
        """Of all requests, in their order."""


class LocalEvaluator:
    """Makes rollouts one after the other in this process."""

    workers = 1

    def __init__(self, rollouts: TaskRollouts) -> None:
        self._rollouts, self.size = rollouts, rollouts.space.size

    def outcomes(self, requests: Sequence[Request]) -> list[Outcome]:
        """Of all requests, in their order."""
        return [answer(self._rollouts, request) for request in requests]


def answer(rollouts: TaskRollouts, request: Request) -> Outcome:
    """The outcome of one request."""
    if request.parameters is not None:
        rollouts.use(request.parameters)
    return rollouts.gradient(request.action) if request.gradient else rollouts.outcome(request.action)


_own: list[TaskRollouts] = []
"""The rollouts of a worker process."""


def _open(made: MadeTask, coarse: bool) -> None:
    _own[:] = [TaskRollouts(made, coarse)]


def _answer(request: Request) -> Outcome:
    return answer(_own[0], request)


class _PoolEvaluator:
    def __init__(self, pool: ProcessPoolExecutor, workers: int, size: int) -> None:
        self._pool, self.workers, self.size = pool, workers, size

    def outcomes(self, requests: Sequence[Request]) -> list[Outcome]:
        return [future.result() for future in [self._pool.submit(_answer, request) for request in requests]]


@contextmanager
def evaluator(made: MadeTask, workers: int, coarse: bool, size: int) -> Iterator[Evaluator]:
    """An evaluator with so many processes; with one worker rollouts are made in this process."""
    if workers <= 1:
        yield LocalEvaluator(TaskRollouts(made, coarse))
        return
    with worker_pool(workers, partial(_open, made, coarse)) as pool:
        yield _PoolEvaluator(pool, workers, size)
