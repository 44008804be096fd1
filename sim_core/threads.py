"""Work on threads, one a core: the compiled core computes without the lock of Python.

Work that is no longer wanted ends where it calls :func:`end_if_unwanted`, as rollouts do between calls of the core.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

_own = threading.local()


@contextmanager
def worker_threads(workers: int, unwanted: threading.Event | None = None) -> Iterator[ThreadPoolExecutor]:
    """Threads for work side by side. When the block is left, what is pending is cancelled and what runs is asked to
    end, and is waited for. ``unwanted``: set before that, asks what runs to end, and what is begun afterwards. Linear
    algebra has one thread within the block: more would take the cores from the workers."""
    unwanted = unwanted or threading.Event()
    pool = ThreadPoolExecutor(workers, "worker", _serve, (unwanted,))
    try:
        with threadpool_limits(1):
            yield pool
    finally:
        unwanted.set()
        pool.shutdown(cancel_futures=True)


def end_if_unwanted() -> None:
    """Raise ``CancelledError`` on a thread of :func:`worker_threads` whose block was left."""
    unwanted: threading.Event | None = getattr(_own, "unwanted", None)
    if unwanted is not None and unwanted.is_set():
        raise CancelledError


def _serve(unwanted: threading.Event) -> None:
    _own.unwanted = unwanted
