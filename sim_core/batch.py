"""Many rollouts side by side: one process a core, one scene a rollout.

Every rollout gets a scene of its own, so what it gives does not depend on the others, on their order or on
the number of processes.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from typing import ParamSpec, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from sim_core.errors import WorkerError
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import Trace, simulate

__all__ = [
    "Rollout",
    "simulate_batch",
]

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class Rollout:
    """One rollout to be made: as the arguments of :func:`sim_core.simulate.simulate`.

    ``poses``: by end effector. ``times``: of the steps [s] ``(n,)``. ``refine``: factor on cells in each direction.
    """

    rig: Rig
    poses: Mapping[str, PoseTrajectory]
    times: np.ndarray
    refine: int = 1


def simulate_batch(
    rollouts: Sequence[Rollout], *, workers: int | None = None, on_done: Callable[[int, int], None] | None = None
) -> list[Trace]:
    """Traces of all rollouts, in their order, from ``workers`` processes (default: one a core).

    ``on_done(done, total)`` is called as each trace arrives in that order. The first rollout that fails ends the
    batch with its error. Raises ``ConvergenceError``, ``WorkerError``.
    """
    if not rollouts:
        return []
    count = min(workers or os.cpu_count() or 1, len(rollouts))
    traces = []
    with worker_pool(count) as pool:
        for future in [pool.submit(_run, rollout) for rollout in rollouts]:
            traces.append(future.result())
            if on_done is not None:
                on_done(len(traces), len(rollouts))
    return traces


class _Pool(ProcessPoolExecutor):
    """Says that it is broken also where a process ends while another is being started, which before Python 3.12 finds
    the pool's pipes closed."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        try:
            return super().submit(fn, *args, **kwargs)
        except OSError as error:
            if not self._broken:
                raise
            raise BrokenProcessPool(self._broken) from error


@contextmanager
def worker_pool(workers: int, start: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """Processes that are started afresh, and call ``start`` once. When the block is left they end at once, whatever
    they are doing. Raises ``WorkerError`` if one of them has ended before.

    Linear algebra has one thread within the block, here too: threads that wait for work take the cores from the
    workers. A script does its work under ``if __name__ == "__main__"``: each process imports it.
    """
    pool = _Pool(workers, multiprocessing.get_context("spawn"), _begin, (start,))
    try:
        with threadpool_limits(1):
            yield pool
    except BrokenProcessPool as error:
        raise worker_ended() from error
    finally:
        _give_up(pool)


def worker_ended() -> WorkerError:
    """The error for a process of a pool that has ended: within the pool's block it is ``BrokenProcessPool``."""
    return WorkerError(
        "A process that simulates has ended before its work was done.",
        "Usually the machine ran out of memory, which its kernel log says: do less at once, or use coarser "
        'cells. A script of your own must do its work under if __name__ == "__main__".',
    )


def _begin(start: Callable[[], None] | None) -> None:
    serve_parent()
    # One process a core: threads of linear algebra on top would wait for each other.
    threadpool_limits(1)
    if start is not None:
        start()


def serve_parent() -> None:
    """Start of a worker process: Ctrl-C is for the parent to deal with, and when that is gone, killed even, so is the
    worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _give_up(pool: ProcessPoolExecutor) -> None:
    """End the processes of a pool, whatever they are doing; what is pending is cancelled."""
    workers = list((pool._processes or {}).values())
    pool.shutdown(wait=False, cancel_futures=True)
    for worker in workers:
        worker.kill()


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def _run(rollout: Rollout) -> Trace:
    return simulate(build_scene(rollout.rig, rollout.refine), rollout.poses, rollout.times)
