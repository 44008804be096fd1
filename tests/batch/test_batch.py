import os
import sys
import time

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from sim_core.batch import Rollout, simulate_batch, worker_pool
from sim_core.errors import ConvergenceError, WorkerError
from sim_core.rigs import with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times

RUB = [0.0, 0.2, 0.4], [[0.0, 0.0, 0.0], [0.0, 0.0, -0.006], [0.002, 0.0, -0.006]]
"""The finger comes down on the card and moves along it."""


def rollouts(small_rig, visit):
    rig, poses, times = small_rig(), visit(*RUB), step_times(0.0, 0.4, 0.02)
    return [Rollout(with_parameters(rig, {"gel.E_pa": e}), poses, times) for e in (1e5, 1.3e5, 1.6e5)]


def test_a_batch_gives_what_single_rollouts_give_bit_for_bit_and_in_order(small_rig, visit):
    jobs, done = rollouts(small_rig, visit), []
    traces = simulate_batch(jobs, workers=2, on_done=lambda k, n: done.append((k, n)))
    assert done == [(1, 3), (2, 3), (3, 3)]
    for job, trace in zip(jobs, traces, strict=True):
        alone = simulate(build_scene(job.rig), job.poses, job.times)
        assert all(np.array_equal(trace.outputs[c], alone.outputs[c]) for c in alone.outputs)
    soft, hard = (trace.outputs["wrench"] for trace in (traces[0], traces[-1]))
    assert np.abs(soft - hard).max() > 1e-5


def test_the_first_failure_is_that_of_the_batch(small_rig, visit):
    jobs = rollouts(small_rig, visit)
    broken = Rollout(jobs[1].rig, jobs[1].poses, np.array([0.0, np.nan]))
    with pytest.raises((ConvergenceError, ValueError)):
        simulate_batch([jobs[0], broken], workers=1)


def test_an_empty_batch_starts_no_process():
    assert simulate_batch([]) == []


def test_workers_leave_the_other_cores_to_each_other():
    """One thread of linear algebra each, and one beside them, where a library would take as many as there are cores."""
    with threadpool_limits(2):
        with worker_pool(1) as pool:
            threads = [*pool.submit(_threads).result(), *_threads()]
        assert threads and set(threads) == {1}
        assert set(_threads()) == {2}


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="Python ends no pool there while a process is being started.")
def test_a_process_that_ends_while_another_is_being_started_is_told_as_one_that_ended():
    with pytest.raises(WorkerError, match="ended before its work was done"), worker_pool(2) as pool:
        pool.submit(time.sleep, 60.0)
        start, reader = pool._adjust_process_count, pool._call_queue._reader

        def start_late():
            next(iter(pool._processes.values())).kill()
            until = time.monotonic() + 300.0
            while not reader.closed and time.monotonic() < until:
                time.sleep(0.01)
            start()

        pool._adjust_process_count = start_late
        pool.submit(os.getpid)


def _threads() -> list[int]:
    return [library["num_threads"] for library in threadpool_info()]
