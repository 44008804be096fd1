"""When the end effectors of a recording stand still: what a sensor shows then is its noise."""

from __future__ import annotations

import numpy as np

from sim_core.rigs.trajectory import PoseTrajectory
from sysid.noise.estimate import by_differences
from sysid.noise.stillness import still_at
from sysid.recording import Recording
from sysid.recording.streams import WrenchStream
from sysid.settings.observations import OBSERVATIONS


def at_rest(recording: Recording, t: np.ndarray) -> np.ndarray:
    """At which of the times [s] ``(n,)`` no end effector moves; at none where there are no poses, for then nothing is
    known of motion."""
    if not recording.poses:
        return np.zeros(len(t), dtype=bool)
    streams = [stream for stream in recording.poses.values() if len(stream) > 1]
    still = still_at([PoseTrajectory.from_samples(s.t, s.position, s.quaternion) for s in streams], t)
    for stream in streams:
        still &= (t >= stream.t[0]) & (t <= stream.t[-1])
    return still


def components(wrench: WrenchStream) -> np.ndarray:
    """Forces and torques ``(n, 6)``."""
    return np.hstack([wrench.force, wrench.torque])


WORDS = ("force x", "force y", "force z", "torque x", "torque y", "torque z")
"""Components of a wrench."""


def unit(component: int) -> str:
    """Unit of a component of a wrench."""
    return "N" if component < 3 else "N m"


def noisy(values: np.ndarray, t: np.ndarray) -> bool:
    """Whether readings ``(n, m)`` at ``t`` [s] ``(n,)`` have noise that shows while they change. What moves smoothly
    has third differences far below its steps."""
    steps = np.abs(np.diff(values, axis=0))
    steps = steps[steps > 0.0]
    noise = by_differences(values, t)
    return bool(len(steps) and noise and noise[0] > OBSERVATIONS.noise_over_step * np.median(steps))


def repeats_at_rest(same: np.ndarray, still: np.ndarray) -> float | None:
    """Share of readings at rest that are exactly those before; None where there are fewer than ten.

    A sensor with noise repeats itself by chance only. One without noise (a simulator's, or a display of few digits)
    repeats itself whenever nothing happens, which is no fault. ``same`` ``(n - 1,)``: a reading is that before;
    ``still`` ``(n,)``.
    """
    both = still[1:] & still[:-1]
    return float(same[both].mean()) if both.sum() >= 10 else None
