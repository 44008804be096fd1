"""All that a recording measured, as rows of numbers: poses, wrenches, markers and tracks, for checks that judge every
stream alike."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sysid.observations.checks.motion import components
from sysid.recording import Recording


@dataclass(frozen=True)
class Rows:
    """One stream. ``role``: 'pose', 'wrench', 'markers' or 'tracks'; ``values`` ``(n, m)``; ``columns``: how many
    readings of :attr:`Finding.faulty` each row has, 0 for poses, which are left out whole."""

    role: str
    name: str
    topic: str
    t: np.ndarray
    values: np.ndarray
    columns: int

    def faulty(self, rows: np.ndarray) -> np.ndarray:
        """Readings of the given rows ``(n,)``, as a finding has them."""
        return np.repeat(rows[:, None], self.columns, axis=1) if self.columns else rows


def streams_of(recording: Recording) -> Iterator[Rows]:
    """Every stream of measured readings."""
    for name, pose in recording.poses.items():
        yield Rows("pose", name, pose.topic, pose.t, np.hstack([pose.position, pose.quaternion]), 0)
    for name, wrench in recording.wrenches.items():
        yield Rows("wrench", name, wrench.topic, wrench.t, components(wrench), 6)
    for name, m in recording.markers.items():
        yield Rows("markers", name, m.topic, m.t, m.position.reshape(len(m), -1), m.position.shape[1])
    for name, k in recording.tracks.items():
        yield Rows("tracks", name, k.topic, k.t, k.uv.reshape(len(k), -1), k.uv.shape[1])
