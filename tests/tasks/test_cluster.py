"""Searches on the workers of a dask scheduler: the same to the bit as on threads, also where workers are killed."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_task import small_task

from sim_core.errors import ConfigError, WorkerError
from sim_core.optimise import Settings, optimise
from sim_core.optimise.cluster import ClusterEvaluator, cluster_evaluator, on_worker, versions
from sim_core.optimise.evaluators import Request
from sim_core.optimise.problem import read_log
from sim_core.rigs import with_parameters
from sim_core.tasks import MadeTask
from sysid.bench.tasks import benchmark

distributed = pytest.importorskip("distributed")
CommClosedError = pytest.importorskip("distributed.comm").CommClosedError

KILLED = 10


def found(made: MadeTask, folder: Path, cluster: str) -> list[tuple[list[float], float, str]]:
    """All that a search tried, with what came of it."""
    optimise(made, Settings(method="cma", rollouts=40, workers=2, cluster=cluster), folder)
    return [(e.action.tolist(), e.fitness, e.phase) for e in read_log(folder / "evaluations.jsonl")]


@contextmanager
def scheduler() -> Iterator[object]:
    """One with one process that simulates: nobody goes on while it is started anew."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
    ) as cluster:
        yield cluster


@contextmanager
def killing(cluster: object) -> Iterator[list[int]]:
    """Kills a worker as soon as it is at work, again and again. Gives those that were killed."""
    killed: list[int] = []
    over = threading.Event()

    def kill() -> None:
        with distributed.Client(cluster, set_as_default=False) as client:
            while len(killed) < KILLED and not over.wait(0.05):
                busy = [name for name, tasks in client.processing().items() if tasks]
                ids = client.run(os.getpid, workers=busy[:1], on_error="ignore") if busy else {}
                for pid in ids.values():
                    if pid not in killed:
                        os.kill(pid, signal.SIGKILL)
                        killed.append(pid)
                        time.sleep(0.5)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        over.set()
        thread.join()


@pytest.mark.slow
@pytest.mark.timeout(3600)  # ten workers are started anew, one after the other
def test_a_search_whose_workers_are_killed_finds_to_the_bit_what_it_finds_undisturbed(tmp_path: Path) -> None:
    made = small_task(tmp_path)
    on_threads = found(made, tmp_path / "threads", "")
    with scheduler() as cluster, killing(cluster) as killed:
        address: str = cluster.scheduler_address  # type: ignore[attr-defined]
        disturbed = found(made, tmp_path / "killed", address)
    assert len(killed) == KILLED
    assert disturbed == on_threads and len(on_threads) == 40


def end(made: MadeTask, coarse: bool, request: Request, expected: dict[str, str]) -> None:
    """A rollout that takes its worker with it."""
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_a_rollout_that_ends_every_worker_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = small_task(tmp_path)
    monkeypatch.setattr("sim_core.optimise.cluster.on_worker", end)
    monkeypatch.setattr("sim_core.optimise.cluster.AGAIN", 1)
    with scheduler() as cluster, distributed.Client(cluster, set_as_default=False) as client:
        evaluator = ClusterEvaluator(client, made, 1, False, 12)
        with pytest.raises(WorkerError, match=r"A rollout of small ended every worker.*memory"):
            evaluator.outcomes([Request(np.zeros(12))])


def test_a_worker_with_other_versions_is_refused(tmp_path: Path) -> None:
    made = small_task(tmp_path)
    with pytest.raises(ConfigError, match=r"A worker has numpy .* in place of 0.1.*same versions"):
        on_worker(made, False, Request(np.zeros(12)), {**versions(), "numpy": "0.1"})


def test_a_worker_makes_each_rollout_on_the_rig_that_it_is_for(tmp_path: Path) -> None:
    made = small_task(tmp_path)
    heavier = replace(made, rig=with_parameters(made.rig, {"card.density_kg_m3": 800.0}))
    request = Request(np.zeros(12))
    first, other, again = (on_worker(m, False, request, versions()).reward for m in (made, heavier, made))
    assert first == again != other


class Connected:
    """Stands in for the client of a scheduler."""

    def __init__(self, cluster: object, **options: object) -> None:
        self.closed = False

    def wait_for_workers(self, count: int, timeout: float) -> None:
        pass

    def close(self) -> None:
        self.closed = True

    def __enter__(self) -> Connected:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


@pytest.mark.parametrize("error", [OSError("no space left"), ConfigError("A worker has numpy 0.1.", "Install it.")])
def test_what_fails_in_a_search_is_not_said_of_its_scheduler(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(distributed, "Client", Connected)
    with (
        pytest.raises(type(error), match=r"no space left|A worker has numpy 0.1") as raised,
        cluster_evaluator("tcp://there:1", small_task(tmp_path), 1, False, 12),
    ):
        raise error
    assert raised.value is error


def test_a_scheduler_without_workers_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Connected] = []

    class Alone(Connected):
        def wait_for_workers(self, count: int, timeout: float) -> None:
            made.append(self)
            raise asyncio.TimeoutError

    monkeypatch.setattr(distributed, "Client", Alone)
    with (
        pytest.raises(ConfigError, match=r"The scheduler 'tcp://there:1' cannot be used: .*TimeoutError.*dask worker"),
        cluster_evaluator("tcp://there:1", small_task(tmp_path), 1, False, 12),
    ):
        pytest.fail("there is nobody to work")
    assert made[0].closed


def test_a_scheduler_that_is_not_there_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_core.optimise.cluster.WAIT_S", 0.5)
    made = small_task(tmp_path)
    with pytest.raises(ConfigError, match=r"The scheduler 'tcp://127.0.0.1:9' cannot be used.*tcp://HOST:PORT"):
        optimise(made, Settings(rollouts=2, cluster="tcp://127.0.0.1:9"))


@pytest.mark.parametrize("address", ["nonsense://x:1", "localhost", "tcp://a:", "tcp://a:70000", "tcp://:8786"])
def test_what_is_no_address_is_refused_before_anything_is_written_or_asked(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def client(*_: object, **__: object) -> None:
        raise AssertionError("a client that cannot connect prints a traceback when it is collected, after a minute")

    monkeypatch.setattr(distributed, "Client", client)
    made = small_task(tmp_path)
    settings = Settings(rollouts=2, cluster=address)
    with pytest.raises(ConfigError, match=rf"The scheduler '{address}' cannot be used.*tcp://HOST:PORT"):
        optimise(made, settings, tmp_path / "run")
    with pytest.raises(ConfigError, match=rf"The scheduler '{address}' cannot be used.*tcp://HOST:PORT"):
        benchmark(["lifting"], ["cma"], [0], settings, tmp_path / "bench")
    assert not (tmp_path / "run").exists() and not (tmp_path / "bench").exists()


@pytest.mark.parametrize("error", [CancelledError(), CommClosedError("gone")])
def test_a_scheduler_that_is_lost_is_an_error_that_says_how_to_go_on(error: Exception, tmp_path: Path) -> None:
    class Lost:
        """A client, and what it hands out, of a scheduler that has ended."""

        def submit(self, *_: object, **__: object) -> Lost:
            return self

        def result(self) -> None:
            raise error

    evaluator = ClusterEvaluator(Lost(), small_task(tmp_path), 1, False, 12)
    with pytest.raises(WorkerError, match=r"The scheduler was lost during a rollout of small.*goes on"):
        evaluator.outcomes([Request(np.zeros(12))])
