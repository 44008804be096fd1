"""How often sensors read, against the rig."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.rigs import Rig
from sysid.observations.checks.finding import Finding
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def rates(recording: Recording, rig: Rig) -> Iterator[Finding]:
    """Sensors and cameras that read much more or less often than the rig says."""
    for name, source in (*rig.sensors.items(), *rig.cameras.items()):
        stream = recording.wrenches.get(name) or recording.markers.get(name) or recording.tracks.get(name)
        if stream is None or len(stream) < OBSERVATIONS.rate_samples:
            continue
        rate = 1.0 / float(np.median(np.diff(stream.t)))
        ratio = rate / source.rate_hz
        if ratio > OBSERVATIONS.rate_ratio or ratio < 1.0 / OBSERVATIONS.rate_ratio:
            yield Finding(
                "rate",
                stream.topic,
                "warning",
                f"{name} reads {rate:.4g} times a second in the recording, {source.rate_hz:g} times in the rig (more "
                f"than a factor of {OBSERVATIONS.rate_ratio:g} apart).",
                "Look at the stamps (milliseconds for seconds?), or correct `rate_hz` in the rig.",
                values=(rate,),
                bound=source.rate_hz,
                part=name,
            )
