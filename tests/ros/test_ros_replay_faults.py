"""Replays with random faults without ROS: no limit is exceeded by more than one control period, whatever fails."""

from __future__ import annotations

import math
import random
import re
from dataclasses import dataclass
from itertools import pairwise

import pytest
from replay_bench import HELD_M, PEAK_M_S
from replay_plant import (
    CAUSES,
    FAULTS,
    JITTER_S,
    PERIOD_S,
    SENSOR_PERIOD_S,
    SETTINGS,
    STEP_S,
    STIFFNESS_N_PER_M,
    Fault,
    Log,
    first_violation,
    simulate,
)

from thinshell_ros.replay.session import CATCH_UP


def assert_nothing_is_exceeded(log: Log) -> float:
    """What must hold of every replay, whatever failed. Returns how many periods after it could be known it ended."""
    limits = SETTINGS.limits
    assert limits.workspace_min_m is not None
    assert limits.workspace_max_m is not None
    assert limits.max_speed_m_s is not None
    assert limits.max_force_n is not None
    periods = 0.0
    if log.fault != "commander_killed":
        surely, perhaps = first_violation(log, margin=0.03), first_violation(log, margin=-0.03)
        if log.state == "aborted":
            assert log.ended >= perhaps, "it does not end before a limit is exceeded"
            late = sum(surely < t <= log.ended for t, *_ in log.ticks)
            assert late <= 1, "it ends in the period in which a limit is exceeded, or in the next one"
            periods = float(late)
        else:
            assert math.isinf(surely) or surely > log.ended
            assert log.state == "succeeded", log.reason
    commands = [(t, z) for t, _, z, _ in log.ticks if z is not None]
    held = [z for t, z in commands if t >= log.ended]
    assert len(set(held)) <= 1, "what is held does not move"
    assert all(limits.workspace_min_m[2] <= z <= limits.workspace_max_m[2] for _, z in commands)
    for (before, start), (now, end) in pairwise(commands):
        if now == log.ended and log.state == "aborted":
            assert abs(end - start) <= HELD_M
        else:
            most = min(now - before, CATCH_UP * PERIOD_S)
            assert abs(end - start) <= limits.max_speed_m_s * most + 1e-12
    if log.fault != "jump":  # the wall's answer to a jump is at once, before anyone can know
        seen_after_s = STEP_S + SENSOR_PERIOD_S + log.latency + PERIOD_S + 2.0 * JITTER_S
        most = limits.max_force_n + STIFFNESS_N_PER_M * PEAK_M_S * seen_after_s
        assert max(force for _, force in log.forces) <= most
    return periods


@dataclass
class Ends:
    """How the replays with one kind of fault ended."""

    replays: int = 0
    aborted: int = 0
    periods: float = 0.0
    named: int = 0
    alarms: int = 0


def replays(count: int) -> dict[str, Ends]:
    """Replays with faults by seed; how those with each kind of fault ended."""
    ends = {kind: Ends() for kind in FAULTS}
    for seed in range(count):
        rng = random.Random(seed)
        fault = Fault.drawn(FAULTS[seed % len(FAULTS)], rng)
        log = simulate(fault, rng)
        try:
            periods = assert_nothing_is_exceeded(log)
        except AssertionError as error:
            raise AssertionError(f"seed {seed}, {fault}: {log.state}, {log.reason!r}: {error}") from error
        end = ends[fault.kind]
        end.replays += 1
        end.alarms += bool(log.alarm)
        if log.state == "aborted":
            end.aborted += 1
            end.periods = max(end.periods, periods)
            end.named += re.search(CAUSES[fault.kind], log.reason) is not None
            assert (log.reason.endswith(".") and log.reason[0].isupper()) or log.reason.startswith("hand "), log.reason
    return ends


def table(ends: dict[str, Ends]) -> str:
    """What docs/replay.md shows."""
    lines = [
        "| fault | replays | aborted | at most so many periods late | sentence names the cause |",
        "| --- | --- | --- | --- | --- |",
    ]
    for kind, end in ends.items():
        share = f"{100.0 * end.named / end.aborted:.0f} %" if end.aborted else ""
        late = f"{end.periods:.0f}" if end.aborted else ""
        lines.append(f"| {kind} | {end.replays} | {end.aborted} | {late} | {share} |")
    return "\n".join(lines)


def test_some_random_faults_exceed_nothing_by_more_than_a_period() -> None:
    ends = replays(3 * len(FAULTS))
    assert ends["none"].aborted == 0
    assert sum(end.named for end in ends.values()) >= 0.95 * sum(end.aborted for end in ends.values())


@pytest.mark.slow
def test_a_thousand_random_faults_exceed_nothing_by_more_than_a_period() -> None:
    ends = replays(1000)
    print(table(ends))
    for kind, end in ends.items():
        if kind not in ("none", "commander_killed"):
            assert end.aborted >= 5, f"{kind}: {end}"
            assert end.named >= 0.9 * end.aborted, f"{kind}: {end}"
    assert sum(end.named for end in ends.values()) >= 0.95 * sum(end.aborted for end in ends.values())
    assert ends["none"].aborted == ends["commander_killed"].aborted == ends["none"].alarms == 0
