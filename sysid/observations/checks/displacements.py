"""Positions of markers against their displacements: position minus displacement is where a marker rests, always."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.observations.checks.finding import Finding
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def displacements(recording: Recording) -> Iterator[Finding]:
    """Axes along which displacements change and positions do not, or by other amounts, and displacements that were set
    to zero while positions went on."""
    for name, markers in recording.markers.items():
        if markers.displacement is None or len(markers) < OBSERVATIONS.rate_samples:
            continue
        moved = _changes(markers.displacement)
        places = _changes(markers.position)
        size = float(np.sqrt(np.nanmean(moved**2, axis=(0, 1)).sum()))
        resolution = float(np.spacing(np.nanmax(np.abs(markers.position), initial=0.0)))
        if size <= resolution / OBSERVATIONS.at_rest_share:  # What a position cannot show.
            continue
        still = [
            k
            for k in range(3)
            if _size(places[..., k]) < OBSERVATIONS.at_rest_share * _size(moved[..., k])
            and _size(moved[..., k]) > OBSERVATIONS.at_rest_share * size
        ]
        if still:
            axes = ", ".join("xyz"[k] for k in still)
            stay, go = (1e3 * max(_size(v[..., k]) for k in still) for v in (places, moved))
            yield Finding(
                "markers_at_rest",
                markers.topic,
                "stops a fit",
                f"The positions {axes} of {name} stay where they are within {stay:.2g} mm, while the displacements "
                f"change by {go:.2g} mm: the positions are those at rest.",
                "They are left out. Write the current position into x, y, z: that at rest plus the displacement.",
                values=tuple(_size(places[..., k]) for k in still),
                bound=OBSERVATIONS.at_rest_share,
                role="markers",
                part=name,
                faulty=np.ones(markers.position.shape[:2], dtype=bool),
            )
            continue
        rest = markers.position - markers.displacement
        jumps = np.nanmedian(np.linalg.norm(np.diff(rest, axis=0), axis=-1), axis=1)
        usual = np.nanmedian(np.linalg.norm(np.diff(markers.position, axis=0), axis=-1), axis=1)
        at = int(np.nanargmax(np.nan_to_num(jumps)))
        if jumps[at] > OBSERVATIONS.tare_step_ratio * max(float(usual[at]), float(np.nanmedian(jumps)), 1e-12):
            yield Finding(
                "displacements_zeroed",
                markers.topic,
                "note",
                f"The displacements of {name} step by {1e3 * jumps[at]:.3g} mm at {markers.t[at + 1]:.3f} s while the "
                "positions do not: they were set to zero there.",
                "Positions are compared, so that nothing is lost.",
                times=(float(markers.t[at + 1]),),
                values=(float(jumps[at]),),
                part=name,
            )


def _changes(values: np.ndarray) -> np.ndarray:
    """Values ``(n, m, 3)`` about the first one of each marker that is there."""
    seen = np.isfinite(values).all(axis=-1)
    first = np.where(seen.any(axis=0), np.argmax(seen, axis=0), 0)
    return np.asarray(values - values[first, np.arange(values.shape[1])])


def _size(changes: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(changes**2)))
