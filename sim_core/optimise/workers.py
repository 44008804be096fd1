"""Who makes the rollouts of a search: this thread, several threads, or the workers of a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sim_core.optimise.cluster import cluster_evaluator
from sim_core.optimise.evaluators import Evaluator, LocalEvaluator, ThreadsEvaluator
from sim_core.tasks.load import MadeTask
from sim_core.tasks.rollout import TaskRollouts
from sim_core.threads import worker_threads


@contextmanager
def evaluator(made: MadeTask, workers: int, coarse: bool, size: int, cluster: str = "") -> Iterator[Evaluator]:
    """An evaluator with so many threads; with one worker rollouts are made on that of the caller. ``cluster``: the
    address of a scheduler, in place of threads (:mod:`sim_core.optimise.cluster`)."""
    if cluster:
        with cluster_evaluator(cluster, made, workers, coarse, size) as found:
            yield found
    elif workers <= 1:
        yield LocalEvaluator(TaskRollouts(made, coarse))
    else:
        with worker_threads(workers) as threads:
            yield ThreadsEvaluator(threads, made, workers, coarse, size)
