"""Single readings that are far from those on both sides."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.noise.quantisation import common_step
from sysid.observations.checks.finding import Finding, when
from sysid.observations.checks.lost_markers import placed_markers
from sysid.observations.checks.marker_identity import usual_spacing
from sysid.observations.checks.motion import WORDS, components, unit
from sysid.recording import Recording
from sysid.recording.notes import plural
from sysid.settings.observations import OBSERVATIONS


def spikes(recording: Recording) -> Iterator[Finding]:
    """Spikes of poses, which are left out, and of sensors, which fits find and leave out by themselves."""
    for name, pose in recording.poses.items():
        at = np.asarray(
            single(pose.position, 3, OBSERVATIONS.pose_spike_m / OBSERVATIONS.spike_resolution_steps).any(axis=1)
        )
        if at.any():
            height = _height(pose.position)[at].max()
            yield Finding(
                "pose_spike",
                pose.topic,
                "warning",
                f"{plural(int(at.sum()), 'position')} of {len(at)} jump away by up to {height:.3g} m and back with the "
                f"next message, {when(pose.t, [(int(k), int(k) + 1) for k in np.flatnonzero(at)])}.",
                "They are left out.",
                times=tuple(pose.t[at]),
                values=(float(height),),
                bound=OBSERVATIONS.pose_spike_m,
                role="pose",
                part=name,
                faulty=at,
            )
    for wrench in recording.wrenches.values():
        values = components(wrench)
        at = single(values, 3, np.repeat([common_step(values[:, :3].T), common_step(values[:, 3:].T)], 3))
        for k in np.flatnonzero(at.any(axis=0)):
            height = float(_height(values)[at[:, k], k].max())
            yield _of_sensor(wrench.topic, wrench.t, at[:, k], WORDS[k], height, unit(int(k)))
    for role, _, topic, t, places in placed_markers(recording):
        flat = places.reshape(len(places), -1)
        at = single(
            flat,
            places.shape[-1],
            OBSERVATIONS.marker_spike_share / OBSERVATIONS.spike_resolution_steps * (usual_spacing(places) or np.inf),
        )
        if at.any():
            height = float(_height(flat)[at].max())
            yield _of_sensor(
                topic, t, np.asarray(at.any(axis=1)), "a marker", height, "px" if role == "tracks" else "m"
            )


def single(values: np.ndarray, size: int, least: float | np.ndarray) -> np.ndarray:
    """Which readings ``(n, c)`` are spikes, of more than ``least`` (one number, or one for each column).

    Every ``size`` columns are the components of one vector.
    """
    at = np.zeros(values.shape, dtype=bool)
    if len(values) < 10:
        return at
    inner = _height(values)[1:-1]
    enough = np.isfinite(inner).sum(axis=0) > 5
    usual = np.full(values.shape[1], np.inf)
    usual[enough] = np.nanmedian(inner[:, enough], axis=0)
    # A column that mostly repeats has no usual distance of its own.
    usual = np.maximum(usual, np.median(usual[enough]) if enough.any() else np.inf)
    change = (values[2:] - values[:-2]).reshape(len(inner), -1, size)
    apart = np.repeat(np.linalg.norm(change, axis=2), size, axis=1)
    with np.errstate(invalid="ignore"):
        at[1:-1] = (
            (inner > OBSERVATIONS.spike_distance_ratio * usual)
            & (inner > OBSERVATIONS.spike_resolution_steps * least)
            & (apart < OBSERVATIONS.spike_return_share * inner)
        )
    return at


def _height(values: np.ndarray) -> np.ndarray:
    """Distance from the middle of the neighbours ``(n, c)``, 0 at the ends, NaN next to what is missing."""
    height = np.zeros(values.shape)
    height[1:-1] = np.abs(values[1:-1] - 0.5 * (values[2:] + values[:-2]))
    return height


def _of_sensor(topic: str, t: np.ndarray, at: np.ndarray, words: str, height: float, unit_: str) -> Finding:
    return Finding(
        "spike",
        topic,
        "note",
        f"{plural(int(at.sum()), 'reading')} of {words} jump away by up to {height:.3g} {unit_} and back, "
        f"{when(t, [(int(k), int(k) + 1) for k in np.flatnonzero(at)])}.",
        "A fit leaves out single mistakes by itself (--robust).",
        times=tuple(t[at]),
        values=(height,),
        bound=OBSERVATIONS.spike_distance_ratio,
    )
