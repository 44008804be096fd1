"""Rollouts and other work on threads, one a core."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import CancelledError

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from sim_core import batch
from sim_core.batch import rollouts
from sim_core.errors import ConfigError, ConvergenceError
from sim_core.rigs import with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sim_core.threads import worker_threads

RUB = [0.0, 0.2, 0.4], [[0.0, 0.0, 0.0], [0.0, 0.0, -0.006], [0.002, 0.0, -0.006]]
"""The finger comes down on the card and moves along it."""

TIMES = step_times(0.0, 0.4, 0.02)
VARIANTS = [{"gel.E_pa": e} for e in (1e5, 1.3e5, 1.6e5)] + [{"card.thickness_m": 4e-4}, {"gel-card.friction": 0.1}]
"""The thickness is of the geometry: another scene."""


@pytest.fixture(scope="module")
def alone(small_rig, visit):
    """Each variant by itself, in a scene that was built for it."""
    rigs = [with_parameters(small_rig(), variant) for variant in VARIANTS]
    return [simulate(build_scene(rig), visit(*RUB), TIMES) for rig in rigs]


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_a_batch_gives_what_single_rollouts_give_bit_for_bit_and_in_order(small_rig, visit, alone, workers):
    done = []
    traces = rollouts(
        small_rig(), VARIANTS, visit(*RUB), TIMES, workers=workers, on_done=lambda k, n: done.append((k, n))
    )
    assert done == [(k, 5) for k in range(1, 6)]
    for trace, own in zip(traces, alone, strict=True):
        assert all(np.array_equal(trace.outputs[c], own.outputs[c]) for c in own.outputs)
    assert min(np.abs(trace.outputs["wrench"] - alone[0].outputs["wrench"]).max() for trace in traces[1:]) > 1e-5


def test_rollouts_at_the_same_time_have_numbers_of_their_own(small_rig, visit, alone, monkeypatch):
    """Two at a time, of which neither is simulated before the scenes of both have their numbers."""
    both = threading.Barrier(2, timeout=300.0)

    def after_both(*given):
        both.wait()
        return simulate(*given)

    monkeypatch.setattr(batch, "simulate", after_both)
    chosen = [0, 1, 0, 1]  # the second two find the scenes that were built for the first
    traces = rollouts(small_rig(), [VARIANTS[k] for k in chosen], visit(*RUB), TIMES, workers=2)
    for k, trace in zip(chosen, traces, strict=True):
        assert np.array_equal(trace.outputs["wrench"], alone[k].outputs["wrench"])


def test_a_rollout_that_fails_does_not_end_the_others(small_rig, visit, alone):
    """Each goes along poses of its own; those of the second one leap through the card."""
    leap = visit([0.0, 0.2, 0.201, 0.4], [[0.0, 0.0, 0.0], [0.0, 0.0, -0.006], [0.0, 0.0, -3.0], [0.0, 0.0, -3.0]])
    first, second, third = rollouts(small_rig(), VARIANTS[:3], [visit(*RUB), leap, visit(*RUB)], TIMES, workers=2)
    assert isinstance(second, ConvergenceError)
    for trace, own in ((first, alone[0]), (third, alone[2])):
        assert np.array_equal(trace.outputs["wrench"], own.outputs["wrench"])


def test_an_empty_batch_and_one_with_too_few_poses(small_rig, visit):
    assert rollouts(small_rig(), [], visit(*RUB), TIMES) == []
    with pytest.raises(ConfigError, match="3 variants and poses for 1 of them"):
        rollouts(small_rig(), VARIANTS[:3], [visit(*RUB)], TIMES)


def test_workers_leave_the_other_cores_to_each_other():
    """One thread of linear algebra, where a library would take as many as there are cores."""
    with threadpool_limits(2):
        with worker_threads(1) as pool:
            threads = pool.submit(_threads).result()
        assert threads and set(threads) == {1}
        assert set(_threads()) == {2}


def _threads() -> list[int]:
    return [library["num_threads"] for library in threadpool_info()]


def test_rollouts_that_are_not_wanted_any_more_end(small_rig, visit):
    """One of an hour, of which the block is left in its first steps; what waits does not begin."""
    scene, going = build_scene(small_rig()), threading.Event()
    times = step_times(0.0, 3600.0, 0.02)

    def rollout():
        simulate(scene, visit([0.0, 3600.0], [[0.0, 0.0, 0.0]] * 2), times, lambda k, n: going.set())

    with worker_threads(1) as pool:
        running, waiting = pool.submit(rollout), pool.submit(rollout)
        assert going.wait(300.0)
    assert isinstance(running.exception(), CancelledError) and waiting.cancelled()


INTERRUPTED = """
import sys, time
from pathlib import Path
from sim_core.threads import end_if_unwanted, worker_threads

def work(folder, k):
    Path(folder, str(k)).touch()
    while True:
        time.sleep(0.01)
        end_if_unwanted()

with worker_threads(2) as pool:
    for future in [pool.submit(work, sys.argv[1], k) for k in range(40)]:
        future.result()
"""


def heard():
    """A shell lets what it runs in the background ignore Ctrl-C, and children inherit that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_an_interrupt_ends_what_runs_and_what_waits(tmp_path):
    """And a script needs no ``if __name__``."""
    script, started = tmp_path / "batch.py", tmp_path / "started"
    script.write_text(INTERRUPTED)
    started.mkdir()
    batch = subprocess.Popen(
        [sys.executable, str(script), str(started)], stderr=subprocess.PIPE, text=True, preexec_fn=heard
    )
    while len(list(started.iterdir())) < 2:
        time.sleep(0.1)
        assert batch.poll() is None
    os.kill(batch.pid, signal.SIGINT)
    _, errors = batch.communicate(timeout=300)
    assert "KeyboardInterrupt" in errors
    assert len(list(started.iterdir())) == 2
