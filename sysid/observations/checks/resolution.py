"""Wrenches that come in coarse steps: a converter with few bits, a display, a file with few digits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.noise.quantisation import common_step
from sysid.observations.checks.finding import Finding
from sysid.observations.checks.motion import components
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def resolution(recording: Recording) -> Iterator[Finding]:
    """Steps of forces and torques, and of positions in pictures."""
    for name, wrench in recording.wrenches.items():
        values = components(wrench)
        for quantity, unit, group in (("force", "N", slice(0, 3)), ("torque", "N m", slice(3, 6))):
            yield from _coarse(name, wrench.topic, quantity, unit, values[:, group])
    for name, tracks in recording.tracks.items():
        yield from _coarse(name, tracks.topic, "position", "px", tracks.uv.reshape(len(tracks), -1))


def _coarse(name: str, topic: str, quantity: str, unit: str, values: np.ndarray) -> Iterator[Finding]:
    values = values[:, np.isfinite(values).any(axis=0)]
    if len(values) < 20 or not values.size:
        return
    step = common_step(values.T)
    extent = float(np.max(np.nanmax(values, axis=0) - np.nanmin(values, axis=0)))
    if step > OBSERVATIONS.coarse_step_share * extent > 0.0:
        yield Finding(
            "coarse_steps",
            topic,
            "note",
            f"The {quantity} comes in steps of {step:.3g} {unit}, {100 * step / extent:.0f} % of all that it changes "
            f"by ({extent:.3g} {unit}).",
            "A fit counts the steps as noise. Record with more digits or a finer range.",
            values=(step,),
            bound=OBSERVATIONS.coarse_step_share * extent,
            part=name,
        )
