"""Random faults of real replays, of a ``replay_node`` with its recorder over loopback: no limit is exceeded by more
than one control period, the recording is kept, and the sentence names the cause.

python -m pytest -n 0 -s -m slow tests/ros/test_ros_live_faults.py
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from ros_faults import KINDS, Ended, Lockstep, drawn, table

pytestmark = pytest.mark.ros

COUNT = int(os.environ.get("THINSHELL_FAULTS", "200"))
FEW = ("pose_late", "wrench_constant", "clock_back", "two_commanders", "sigkill")


def assert_held(ends: list[Ended]) -> None:
    """What must hold of each replay, and of most."""
    for end in ends:
        assert end.exceeded <= 1, end
        assert not end.early, end
        assert not end.lacks, end
        if end.fault.kind in ("none", "recorder_killed"):
            assert end.state == "succeeded", end
    said = [end for end in ends if end.state == "aborted" and KINDS[end.fault.kind]]
    assert sum(end.names for end in said) >= 0.95 * len(said), [end for end in said if not end.names]


def test_a_few_random_faults_exceed_nothing_by_more_than_a_period(ros: None, tmp_path: Path) -> None:
    with Lockstep(tmp_path) as plant:
        assert_held([plant.replay(*drawn(list(KINDS).index(kind), seed=2)) for kind in FEW])


@pytest.mark.slow
@pytest.mark.timeout(10800)
def test_two_hundred_random_faults_exceed_nothing_by_more_than_a_period(ros: None, tmp_path: Path) -> None:
    ends = []
    with Lockstep(tmp_path) as plant:
        for number in range(COUNT):
            ends.append(plant.replay(*drawn(number, seed=1)))
            print(ends[-1], flush=True)
    print(table(ends))
    assert_held(ends)
