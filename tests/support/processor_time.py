"""Processor seconds of the tests of each folder, at the end of a run: what they and their child processes used.

Seconds of the processor do not depend on how busy the machine is, as those of the clock do. What several tests share
(fixtures of a session, compiled kernels) counts for the first that needs it; importing test modules counts for none.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
_began = 0.0


def used_s() -> float:
    """Processor time [s] of this process and its children, those included that still run (on Linux)."""
    return sum(os.times()[:4]) + sum(map(_of_running, _children("self")))


def _children(pid: str) -> Iterator[str]:
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            yield from path.read_text().split()
        except OSError:  # the thread has ended
            continue


def _of_running(pid: str) -> float:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:  # the process has ended
        return 0.0
    return _TICK_S * sum(map(int, fields[11:15])) + sum(map(_of_running, _children(pid)))


def pytest_runtest_logstart() -> None:
    """Take the time before the fixtures of a test."""
    global _began
    _began = used_s()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(call: pytest.CallInfo[None]) -> Iterator[None]:
    """Add what a test used to its last report, with which it gets from the workers of xdist to the summary."""
    report = yield
    if call.when == "teardown":
        report.processor_s = used_s() - _began
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the folders, the dearest first."""
    seconds: Counter[str] = Counter()
    tests: Counter[str] = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if hasattr(report, "processor_s"):
                folder = report.nodeid.rpartition("::")[0].partition("::")[0].rpartition("/")[0]
                seconds[folder] += report.processor_s
                tests[folder] += 1
    if seconds:
        terminalreporter.section("processor time")
        for folder, used in [*seconds.most_common(), ("all", seconds.total())]:
            count = tests[folder] if folder in tests else tests.total()
            terminalreporter.line(f"{used:10.1f} s {count:6} tests  {folder}")
