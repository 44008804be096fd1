"""The process of the physics: what it is sent, and that it ends with its node. Needs no ROS."""

import queue
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_live import WAIT_S, is_alive

from thinshell_ros import supervisor
from thinshell_ros.poses import Pose
from thinshell_ros.protocol import Reset, Status, Target
from thinshell_ros.worker import Worker


def test_the_worker_never_swamps_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[Any] = []
    worker = Worker.__new__(Worker)
    worker._targets, worker._listening, worker._number, worker._inbox = {}, True, 0, queue.SimpleQueue()
    monkeypatch.setattr(worker, "_send", sent.append)
    poses = [Pose(np.array([0.0, 0.0, z]), np.array([0.0, 0.0, 0.0, 1.0])) for z in range(100)]
    for pose in poses:
        worker.aim(Target("probe", pose))
    assert [t.pose.position[2] for t in sent] == [0], "one until the process has answered"
    worker._listening = True
    worker._pass_on()
    assert [t.pose.position[2] for t in sent] == [0, 99], "then the latest"
    worker.aim(Target("probe", poses[1]))
    worker.reset()
    worker._listening = True
    worker._pass_on()
    assert sent[-1] == Reset(1), "a reset forgets targets from before"


@pytest.mark.parametrize("paused", [True, False])
def test_another_rig_stands_still_where_the_one_before_did_and_what_hung_goes_on(
    monkeypatch: pytest.MonkeyPatch, paused: bool
) -> None:
    started: list[tuple[Any, bool]] = []

    class Stand:
        def __init__(self, *_: object) -> None: ...
        def stop(self, wait_s: float) -> None: ...

        def start(self, settings: Any, paused: bool) -> None:
            started.append((settings, paused))

    monkeypatch.setattr(supervisor, "Worker", Stand)
    settings: Any = "another rig"
    watched = supervisor.Supervisor(settings, 1.0)
    watched.status = Status(paused, "", 0.0, 1.0)
    watched.restart(settings)
    watched.status = Status(paused, "", 0.0, 1.0)
    watched.restart()
    assert started == [(settings, paused), (None, False)]


ORPHAN = """
import multiprocessing
from thinshell_ros.loop import end_with_parent


def step(started):
    end_with_parent()
    started.set()
    while True:
        pass


if __name__ == "__main__":
    context = multiprocessing.get_context("spawn")
    started = context.Event()
    process = context.Process(target=step, args=(started,), daemon=True)
    process.start()
    started.wait()
    print(process.pid, flush=True)
    process.join()
"""


def test_physics_ends_with_the_node_that_is_killed_in_the_middle_of_a_step(tmp_path: Path) -> None:
    (tmp_path / "node.py").write_text(ORPHAN)
    node = subprocess.Popen([sys.executable, tmp_path / "node.py"], stdout=subprocess.PIPE, text=True)
    assert node.stdout is not None
    physics = int(node.stdout.readline())
    assert is_alive(physics)
    node.kill()
    node.wait()
    end = time.monotonic() + WAIT_S
    while is_alive(physics) and time.monotonic() < end:
        time.sleep(0.05)
    assert not is_alive(physics)
