"""Rows that repeat the one before: of a driver that publishes too often, not of a hand that stands still."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from sysid.observations.checks.repeated import repeated, repeats
from sysid.recording import Recording
from sysid.recording.events import Event


def test_a_hand_that_stands_still_is_not_left_out_where_its_motion_repeats_itself() -> None:
    """Each pose three times while it moves, and 110 times the same one then: that is no gap."""
    moving = np.repeat(np.random.default_rng(0).standard_normal((60, 7)), 3, axis=0)
    again = repeats(np.vstack([moving, np.repeat(moving[-1:], 110, axis=0), moving[::-1]]))
    assert again[:177].sum() == 2 * 59
    assert not again[180:288].any()
    assert again[-177:].sum() == 2 * 59


def uneven(events: tuple[Event, ...]) -> Recording:
    """A hand that now and then stands still for two poses and then goes on, which nothing else shows."""
    rng = np.random.default_rng(1)
    steps = np.ones(400)
    for k in rng.choice(np.arange(2, 398), 40, replace=False):
        steps[k : k + 2] = 0.0
    position = np.cumsum(steps)[:, None] * np.array([1e-5, 2e-5, 1e-4])
    t, turn = 0.01 * np.arange(400), np.tile([0.0, 0.0, 0.0, 1.0], (400, 1))
    pose = SimpleNamespace(topic="current_pose", t=t, position=position, quaternion=turn)
    none: Any = {}
    found: Any = SimpleNamespace(poses={"finger": pose}, wrenches=none, markers=none, tracks=none, events=events)
    return cast(Recording, found)


def test_poses_of_a_simulator_that_stood_still_are_kept() -> None:
    assert [f.role for f in repeated(uneven(()))] == ["pose"]
    assert [f.role for f in repeated(uneven((Event("reset", 0.0, {}),)))] == ["pose"]
    assert not list(repeated(uneven((Event("reset", 0.0, {}, exact_poses=True),))))
