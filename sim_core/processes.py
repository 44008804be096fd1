"""Whole jobs side by side in processes: those with much Python of their own, or that are measured by themselves.

Rollouts are made on threads (:mod:`sim_core.batch`), which share what they are made of.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

from sim_core.errors import WorkerError

P = ParamSpec("P")
T = TypeVar("T")


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
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that are started afresh. When the block is left they end at once, whatever
    they are doing. Raises ``WorkerError`` if one of them has ended before.

    Linear algebra has one thread within the block, here too: threads that wait for work take the cores from the
    workers. A script does its work under ``if __name__ == "__main__"``: each process imports it.
    """
    pool = _Pool(workers, multiprocessing.get_context("spawn"), _begin)
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


def _begin() -> None:
    """Start of a worker process: Ctrl-C is for the parent to deal with, and when that is gone, killed even, so is the
    worker."""
    # One process a core: threads of linear algebra on top would wait for each other.
    threadpool_limits(1)
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
