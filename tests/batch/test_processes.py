"""Workers of a process that is killed or interrupted do not stay behind."""

import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from sim_core.errors import WorkerError
from sim_core.processes import worker_pool

PARENT = textwrap.dedent(
    """
    import os, sys, time
    from sim_core.processes import worker_pool

    if __name__ == "__main__":
        with worker_pool(1) as pool:
            print(pool.submit(os.getpid).result(), flush=True)
            pool.submit(time.sleep, 600)
            time.sleep(600)
    """
)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat") as stat:
        return stat.read().rsplit(")", 1)[1].split()[0] != "Z"


def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    worker = int(parent.stdout.readline())
    assert alive(worker)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    for _ in range(200):
        if not alive(worker):
            return
        time.sleep(0.1)
    os.kill(worker, signal.SIGKILL)
    raise AssertionError("the worker goes on working for nobody")


UNGUARDED = """
from sim_core.processes import worker_pool

with worker_pool(1) as pool:
    pool.submit(print, "never").result()
"""


def test_a_script_that_every_worker_runs_again_is_refused_with_what_it_lacks(tmp_path):
    script = tmp_path / "unguarded.py"
    script.write_text(UNGUARDED)
    ended = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=300)
    assert ended.returncode == 1
    assert "WorkerError" in ended.stderr.splitlines()[-1]
    assert 'under if __name__ == "__main__"' in ended.stderr.splitlines()[-1]


def test_a_worker_that_is_killed_is_reported():
    with pytest.raises(WorkerError, match="before its work was done"), worker_pool(1) as pool:
        os.kill(pool.submit(os.getpid).result(), signal.SIGKILL)
        pool.submit(time.sleep, 60).result()


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="Python ends no pool there while a process is being started.")
def test_a_process_that_ends_while_another_is_being_started_is_reported_as_one_that_ended():
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
