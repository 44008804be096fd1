"""What a check says of a recording."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS

Severity = Literal["note", "warning", "stops a fit"]


@dataclass(frozen=True, eq=False)
class Finding:
    """One thing that is implausible in a recording, or that contradicts the rig.

    Attributes:
        name: of the kind of fault, as ``--despite`` takes it.
        channel: the topic.
        severity: 'note' for what a fit allows for, 'warning' for what may change its result, 'stops a fit' for what
            makes it meaningless.
        problem: a sentence with the values found and the bound or the value of the rig.
        remedy: what to do about it.
        times: instants that it is about [s], of the recording's own time; empty for all of it.
        values: what was found, SI units or px.
        bound: what it was compared with, in the same unit.
        role: 'pose', 'wrench', 'markers' or 'tracks', where single readings are faulty.
        part: name of the end effector, sensor or camera.
        faulty: readings that are left out: ``(n,)`` of poses, ``(n, 6)`` of a wrench, ``(n, m)`` of markers.
        of_another_rig: it may be that the recording was made with another rig.
        breaks: the recording begins anew at ``times``; a window without them in it is not concerned.
    """

    name: str
    channel: str
    severity: Severity
    problem: str
    remedy: str
    times: tuple[float, ...] = ()
    values: tuple[float, ...] = ()
    bound: float | None = None
    role: str = ""
    part: str = ""
    faulty: np.ndarray | None = None
    of_another_rig: bool = False
    breaks: bool = False

    @property
    def text(self) -> str:
        """Problem and remedy."""
        return f"{self.problem} {self.remedy}".strip()

    def __str__(self) -> str:
        return f"{self.severity}: {self.channel}: {self.name}: {self.text}"


def without_faulty(recording: Recording, findings: Iterable[Finding]) -> Recording:
    """The recording without the readings that findings say are faulty: NaN, or for poses no sample."""
    poses, wrenches = dict(recording.poses), dict(recording.wrenches)
    markers, tracks = dict(recording.markers), dict(recording.tracks)
    for found in findings:
        faulty = found.faulty
        if faulty is None:
            continue
        if found.role == "pose":
            poses[found.part] = poses[found.part].take(~faulty)
        elif found.role == "wrench":
            w = wrenches[found.part]
            wrenches[found.part] = replace(
                w,
                force=np.where(faulty[:, :3], np.nan, w.force),
                torque=np.where(faulty[:, 3:], np.nan, w.torque),
                mask=w.mask & ~faulty,
            )
        elif found.role == "markers":
            m = markers[found.part]
            position, displacement, force = (
                None if v is None else np.where(faulty[..., None], np.nan, v)
                for v in (m.position, m.displacement, m.force)
            )
            assert position is not None
            markers[found.part] = replace(m, position=position, displacement=displacement, force=force)
        else:
            t = tracks[found.part]
            uv = np.where(faulty[..., None], np.nan, t.uv)
            tracks[found.part] = replace(t, uv=uv, confidence=np.where(faulty, 0.0, t.confidence))
    return replace(recording, poses=poses, wrenches=wrenches, markers=markers, tracks=tracks)


def runs_of(mask: np.ndarray) -> list[tuple[int, int]]:
    """First index and one past the last of each stretch in which ``mask`` ``(n,)`` holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask, dtype=np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def when(t: np.ndarray, stretches: Sequence[tuple[int, int]]) -> str:
    """The times [s] of stretches of indices, the longest ones, in words."""
    longest = sorted(sorted(stretches, key=lambda s: s[0] - s[1])[: OBSERVATIONS.named_spans])
    spans = [f"{t[a]:.3f} to {t[b - 1]:.3f} s" if b - a > 1 else f"{t[a]:.3f} s" for a, b in longest]
    more = len(stretches) - len(longest)
    return ", ".join(spans) + (f" and {more} more times" if more else "")
