"""The summary of a run says what the tests of each folder used of the processor."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

BURNS = """
import subprocess, sys, time
BURN = "import time\\nwhile time.process_time() < 0.5: pass\\n"
def test_itself():
    end = time.process_time() + 0.3
    while time.process_time() < end: pass
def test_by_a_child_that_goes_on():
    code = BURN + "print(flush=True); import sys; sys.stdin.read()"
    global child
    child = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    child.stdout.readline()
"""


def test_folders_have_the_processor_time_of_their_tests_and_of_child_processes(tmp_path: Path) -> None:
    for folder, code in (("idle", "def test_nothing():\n    pass\n"), ("busy", BURNS)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / f"test_{folder}.py").write_text(code)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1] / "support")}
    command = [sys.executable, "-m", "pytest", "-n", "1", "-p", "processor_time", "-p", "no:cacheprovider"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = re.findall(r"^ +([\d.]+) s +(\d+) tests  (\w+)$", done.stdout, re.MULTILINE)
    assert [(int(count), folder) for _, count, folder in rows] == [(2, "busy"), (1, "idle"), (3, "all")]
    busy, idle, both = (float(used) for used, _, _ in rows)
    assert busy >= 0.8 and idle < 0.3
    assert abs(both - busy - idle) < 0.11
