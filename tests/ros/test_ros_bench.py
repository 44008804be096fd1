"""The bench of latencies, as a user runs it."""

import re
import subprocess
import sys

import pytest
from ros_live import START_S

pytestmark = pytest.mark.ros


def test_it_measures_latency_losses_and_memory(ros: None) -> None:
    command = [sys.executable, "-m", "thinshell_ros.bench", "--seconds", "2"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=2.0 * START_S)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert [line.partition(":")[0] for line in lines] == [
        "command to markers", "markers", "age of stamps in the last 3 s", "memory of node and physics",
        "processor time for each cloud of markers", "machine",
    ]  # fmt: skip
    changes = int(lines[0].split(" of ")[-1].split()[0])
    assert changes >= 1 and "nan" not in lines[0]
    assert int(lines[1].split(": ")[1].split()[0]) > 10
    node_ms, physics_ms = map(float, re.findall(r"([\d.]+) ms of the", lines[4]))
    assert 0.0 < node_ms < 1e3 and 0.0 < physics_ms < 1e3
