"""Samples are compared only while somebody recorded where the hand was."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim_core.rigs.trajectory import PoseTrajectory
from sysid.model.load import while_posed
from sysid.observations.observations import Measured

T = np.arange(0.0, 5.0, 0.1)


def hand(*times: float) -> dict[str, PoseTrajectory]:
    n = len(times)
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    return {"finger": PoseTrajectory.from_samples(np.array(times), np.zeros((n, 3)), quaternions)}


@pytest.fixture
def gauge() -> Measured:
    return Measured("wrench", "wrench", T, np.ones((len(T), 6)), tuple("abcdef"))


def test_samples_that_no_pose_belongs_to_are_not_compared(small_rig: Any, gauge: Measured) -> None:
    (kept,), notes = while_posed(small_rig(), hand(0.55, 1.0, 2.05), [gauge])
    np.testing.assert_array_equal(np.isfinite(kept.values[:, 0]), (T > 0.55) & (T < 3.05))
    assert notes == (
        "wrench: 6 samples from 0.000 to 0.500 s are not compared, before the first pose of finger at 0.550 s. "
        "Start recording poses first.",
        "wrench: 19 samples from 3.100 to 4.900 s are not compared, more than 1 s after the last pose of finger at "
        "2.050 s. Record poses to the end, or raise topics.max_gap_s where it stands still.",
    )


def test_what_is_covered_stays_as_it_is(small_rig: Any, gauge: Measured) -> None:
    for poses in (hand(0.0, 4.5), hand(2.0)):
        (kept,), notes = while_posed(small_rig(), poses, [gauge])
        np.testing.assert_array_equal(kept.values, gauge.values)
        assert notes == ()


def test_a_channel_that_is_never_covered_is_left_out(small_rig: Any, gauge: Measured) -> None:
    early = replace(gauge, channel="markers", t=T[:3], values=gauge.values[:3])
    kept, notes = while_posed(small_rig(), hand(1.0, 4.5), [early, gauge])
    assert [m.channel for m in kept] == ["wrench"]
    assert [note.split(":")[0] for note in notes] == ["markers", "wrench"]
