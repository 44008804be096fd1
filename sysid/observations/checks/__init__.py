"""What is in a recording against itself and against a rig: small checks, all run by one call.

``examine`` is what ``inspect``, ``fit`` and ``diagnose`` call. Each check is a function of a recording, or of a
recording and a rig, that yields findings; a new one is a file here and a line in one of the two tuples. Checks see the
recording without the readings that those before them found faulty, so that one fault is named once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from sim_core.rigs import Rig
from sysid.observations.checks.cameras import cameras
from sysid.observations.checks.clipped import clipped, constant
from sysid.observations.checks.clocks import clocks
from sysid.observations.checks.coarse_stamps import coarse_stamps
from sysid.observations.checks.displacements import displacements
from sysid.observations.checks.finding import Finding, Severity, without_faulty
from sysid.observations.checks.frozen import frozen, frozen_poses
from sysid.observations.checks.identity import frames, numbers, pose_covariance
from sysid.observations.checks.lost_markers import lost_markers
from sysid.observations.checks.marker_identity import coincident_markers, exchanged_markers
from sysid.observations.checks.marker_layout import marker_layout
from sysid.observations.checks.pictures import pictures
from sysid.observations.checks.rates import rates
from sysid.observations.checks.repeated import repeated
from sysid.observations.checks.resolution import resolution
from sysid.observations.checks.restarts import resets, time_left_out
from sysid.observations.checks.spikes import spikes
from sysid.observations.checks.start_poses import start_poses
from sysid.observations.checks.tares import tares
from sysid.observations.checks.two_publishers import two_publishers
from sysid.observations.checks.wrench_units import wrench_units
from sysid.recording import Recording

__all__ = ["AGAINST_ITSELF", "AGAINST_RIG", "Finding", "Severity", "examine", "without_faulty"]

AGAINST_ITSELF: tuple[Callable[[Recording], Iterable[Finding]], ...] = (
    clocks,
    resets,
    coarse_stamps,
    two_publishers,
    repeated,
    displacements,
    lost_markers,
    frozen_poses,
    frozen,
    constant,
    clipped,
    coincident_markers,
    exchanged_markers,
    spikes,
    tares,
    resolution,
    pictures,
)
AGAINST_RIG: tuple[Callable[[Recording, Rig], Iterable[Finding]], ...] = (
    frames,
    pose_covariance,
    numbers,
    start_poses,
    wrench_units,
    cameras,
    marker_layout,
    rates,
    time_left_out,
)

_ORDER: tuple[Severity, ...] = ("stops a fit", "warning", "note")


def examine(recording: Recording, rig: Rig | None = None) -> tuple[tuple[Finding, ...], Recording]:
    """Everything implausible in a recording, the gravest first, and the recording without the faulty readings.

    ``rig``: what stood on the table; without it the recording is compared with itself only.
    """
    findings: list[Finding] = []
    for check in AGAINST_ITSELF:
        found = list(check(recording))
        recording = without_faulty(recording, found)
        findings += found
    for against in AGAINST_RIG if rig is not None else ():
        assert rig is not None
        findings += against(recording, rig)
    return tuple(sorted(findings, key=lambda f: _ORDER.index(f.severity))), recording
