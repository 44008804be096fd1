"""Rollouts of a search on other processes and other machines, by the library dask.distributed (Rocklin 2015).

``local`` starts processes on this machine; ``tcp://HOST:PORT`` is a scheduler that has workers already, in which this
package is installed. A rollout is a pure function of its request, so that one whose worker ends, or is killed, is made
again by another one, and the search goes on as it would have. What a search finds depends on how many rollouts it asks
for at once (``workers``), not on who makes them.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from sim_core.errors import ConfigError, WorkerError
from sim_core.optimise.evaluators import Request, answer
from sim_core.tasks.load import MadeTask
from sim_core.tasks.rollout import Outcome, TaskRollouts

if TYPE_CHECKING:
    from distributed import Client, Future

LOCAL = "local"

AGAIN = 5
"""So often a rollout is asked for again that the scheduler has given up, each time after its workers ended four times:
one that ends every worker, as where their memory does not suffice, is an error."""

WAIT_S = 30.0
"""For the scheduler, and for its first worker [s]."""

LAST_PORT = 65535

SCHEDULER = "Write tcp://HOST:PORT of one that runs ('dask scheduler') and has workers ('dask worker'), or 'local'."

PACKAGES = ("thinshell_ros", "numpy", "scipy")
"""Their versions are the same here and on all workers."""

_own = threading.local()


class ClusterEvaluator:
    """Makes rollouts of a task on the workers of a scheduler, ``workers`` at once."""

    def __init__(self, client: Client, made: MadeTask, workers: int, coarse: bool, size: int) -> None:
        self._client, self._made, self._coarse = client, made, coarse
        self.workers, self.size = workers, size
        self._versions = versions()

    def outcomes(self, requests: Sequence[Request]) -> list[Outcome]:
        """Of all requests, in their order. Raises ``WorkerError`` for one that ends every worker, and where the
        scheduler is lost."""
        futures = [self._submitted(request) for request in requests]
        return [self._result(future, request) for future, request in zip(futures, requests, strict=True)]

    def _submitted(self, request: Request) -> Future:
        return self._client.submit(on_worker, self._made, self._coarse, request, self._versions, pure=False)

    def _result(self, future: Future, request: Request) -> Outcome:
        from distributed import KilledWorker
        from distributed.comm import CommClosedError

        for _ in range(AGAIN):
            try:
                found: Outcome = future.result()
                return found
            except KilledWorker:
                future = self._submitted(request)
            except (CancelledError, CommClosedError):
                raise WorkerError(
                    f"The scheduler was lost during a rollout of {self._made.name}.",
                    "Start it and its workers again: the same command goes on with what was tried.",
                ) from None
        raise WorkerError(
            f"A rollout of {self._made.name} ended every worker that made it.",
            "Usually their memory does not suffice: let each machine have fewer workers.",
        )


def on_worker(made: MadeTask, coarse: bool, request: Request, expected: dict[str, str]) -> Outcome:
    """The outcome of a request, on a worker, each thread of which has a scene of its own. Raises ``ConfigError`` where
    the worker has other versions than are expected."""
    known = getattr(_own, "task", None)
    if known != (made.name, coarse, made.rig):
        differ = [f"{n} {v} in place of {expected[n]}" for n, v in versions().items() if v != expected[n]]
        if differ:
            raise ConfigError(f"A worker has {', '.join(differ)}.", "Install the same versions on all machines.")
        _own.rollouts, _own.task = TaskRollouts(made, coarse), (made.name, coarse, made.rig)
    return answer(_own.rollouts, request)


def versions() -> dict[str, str]:
    """Of the packages on which the digits of a rollout depend."""
    return {name: version(name) for name in PACKAGES}


def check_cluster(address: str) -> None:
    """Whether rollouts can be asked for there, without asking. Raises ``ConfigError`` where the library is missing, and
    for what is no address of a scheduler."""
    try:
        from distributed.comm import get_address_host_port
    except ModuleNotFoundError:
        raise ConfigError(
            "Searches on a cluster need dask.distributed, which is missing.",
            "Install it (pip install 'thinshell_ros[cluster]').",
        ) from None
    if address == LOCAL:
        return
    try:
        host, port = get_address_host_port(address if "://" in address else f"tcp://{address}")
    except ValueError as error:
        raise ConfigError(f"The scheduler {address!r} cannot be used: {error}.", SCHEDULER) from None
    if not host or not 1 <= port <= LAST_PORT:
        raise ConfigError(
            f"The scheduler {address!r} cannot be used: it has no host and port of 1 to {LAST_PORT}.", SCHEDULER
        )


@contextmanager
def _quiet(logger: logging.Logger) -> Iterator[None]:
    """Without the traceback that the library logs where a scheduler is lost, which is an error of the search."""
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)


@contextmanager
def cluster_evaluator(
    address: str, made: MadeTask, workers: int, coarse: bool, size: int
) -> Iterator[ClusterEvaluator]:
    """An evaluator on the workers of the scheduler at an address, or on so many processes that are started here. Raises
    ``ConfigError`` where the library is missing, and where no scheduler or no worker is there."""
    check_cluster(address)
    import distributed

    with ExitStack() as opened:
        opened.enter_context(_quiet(logging.getLogger("distributed.client")))
        place: Any = address
        if address == LOCAL:
            try:
                place = distributed.LocalCluster(
                    n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
                )
            except RuntimeError as error:
                raise ConfigError(
                    f"Processes for the search could not be started: {error}.",
                    'A script of your own must do its work under if __name__ == "__main__", in a file.',
                ) from None
            opened.callback(place.close)
        try:
            client = opened.enter_context(distributed.Client(place, timeout=WAIT_S, set_as_default=False))
            client.wait_for_workers(1, timeout=WAIT_S)
        except (OSError, ValueError, asyncio.TimeoutError) as error:  # in Python 3.10 the last is none of the first
            why = str(error) or type(error).__name__
            raise ConfigError(f"The scheduler {address!r} cannot be used: {why}.", SCHEDULER) from None
        yield ClusterEvaluator(client, made, workers, coarse, size)
