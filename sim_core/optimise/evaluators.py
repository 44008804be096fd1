"""Where the rollouts of a search are made: one after the other, or several at once."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import numpy as np

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
    """Makes rollouts one after the other."""

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


class ThreadsEvaluator:
    """Makes rollouts on threads, each of which has a scene of its own."""

    def __init__(self, threads: ThreadPoolExecutor, made: MadeTask, workers: int, coarse: bool, size: int) -> None:
        self._threads, self._made, self._coarse = threads, made, coarse
        self.workers, self.size = workers, size
        self._own = threading.local()

    def _answer(self, request: Request) -> Outcome:
        if not hasattr(self._own, "rollouts"):
            self._own.rollouts = TaskRollouts(self._made, self._coarse)
        return answer(self._own.rollouts, request)

    def outcomes(self, requests: Sequence[Request]) -> list[Outcome]:
        """Of all requests, in their order."""
        return [future.result() for future in [self._threads.submit(self._answer, request) for request in requests]]
