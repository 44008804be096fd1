"""What pools of threads and processes have in common: an interrupt ends them, and they leave each other the cores."""

import os
import signal
import subprocess
import sys
import time

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from sim_core.processes import worker_pool
from sim_core.threads import worker_threads

INTERRUPTED = """
import sys, time
from pathlib import Path
from sim_core.processes import worker_pool
from sim_core.threads import end_if_unwanted, worker_threads

def work(folder, k):
    Path(folder, str(k)).touch()
    for _ in range(500):
        time.sleep(0.01)
        end_if_unwanted()

def main():
    with {pool}(2) as pool:
        for future in [pool.submit(work, sys.argv[1], k) for k in range(40)]:
            future.result()

{guard}main()
"""


def heard():
    """A shell lets what it runs in the background ignore Ctrl-C, and children inherit that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.parametrize(
    ("pool", "guard", "begun"), [("worker_threads", "", 2), ("worker_pool", 'if __name__ == "__main__": ', 4)]
)
def test_an_interrupt_ends_what_runs_and_what_waits(tmp_path, pool, guard, begun):
    """All 40 would take 100 s. A script with threads needs no ``if __name__``."""
    script, started = tmp_path / "batch.py", tmp_path / "started"
    script.write_text(INTERRUPTED.format(pool=pool, guard=guard))
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
    assert 2 <= len(list(started.iterdir())) <= begun


@pytest.mark.parametrize(("pool", "in_parent"), [(worker_threads, False), (worker_pool, True)])
def test_workers_leave_the_other_cores_to_each_other(pool, in_parent):
    """One thread of linear algebra each, and one in the parent of processes, where a library would take all cores."""
    with threadpool_limits(2):
        with pool(1) as workers:
            threads = [*workers.submit(_threads).result(), *(_threads() if in_parent else [])]
        assert threads and set(threads) == {1}
        assert set(_threads()) == {2}


def _threads() -> list[int]:
    return [library["num_threads"] for library in threadpool_info()]
