"""Markers that land on one another, exchange their numbers, or are numbered anew."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from sysid.observations.checks.finding import Finding, runs_of, when
from sysid.observations.checks.lost_markers import last_seen, placed_markers
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def coincident_markers(recording: Recording) -> Iterator[Finding]:
    """Two numbers at one place: the tracker has followed one marker with both."""
    for role, name, topic, t, places in placed_markers(recording):
        spacing = usual_spacing(places)
        if spacing is None:
            continue
        ids = (recording.markers if role == "markers" else recording.tracks)[name].ids
        at = np.zeros((len(places), places.shape[1]), dtype=bool)
        for k, frame in enumerate(places):
            seen = np.flatnonzero(np.isfinite(frame).all(axis=1))
            if len(seen) > 1:
                for pair in cKDTree(frame[seen]).query_pairs(OBSERVATIONS.same_detection_share * spacing):
                    at[k, seen[list(pair)]] = True
        for column in range(at.shape[1]):
            kept = np.zeros(len(at), dtype=bool)
            for a, b in runs_of(at[:, column]):
                kept[a:b] = b - a >= OBSERVATIONS.same_detection_frames
            at[:, column] = kept
        shown = np.asarray(at.any(axis=1))
        if len(t[shown]):
            numbers = ", ".join(map(str, ids[at.any(axis=0)][:8].tolist()))
            yield Finding(
                "markers_coincide",
                topic,
                "warning",
                f"The markers {numbers} are at the same place as another one, within "
                f"{OBSERVATIONS.same_detection_share * spacing:.2g} {'px' if role == 'tracks' else 'm'} where "
                f"neighbours are {spacing:.3g} apart, {when(t, runs_of(shown))}: the tracker followed "
                "one marker twice.",
                "They are left out there.",
                times=tuple(t[shown]),
                values=(OBSERVATIONS.same_detection_share * spacing,),
                bound=spacing,
                role=role,
                part=name,
                faulty=at,
            )


def exchanged_markers(recording: Recording) -> Iterator[Finding]:
    """Markers that jump to where another one was in the frame before, in a circle."""
    for role, name, topic, t, places in placed_markers(recording):
        spacing = usual_spacing(places)
        if spacing is None:
            continue
        ids = (recording.markers if role == "markers" else recording.tracks)[name].ids
        faulty = np.zeros(places.shape[:2], dtype=bool)
        own = np.arange(places.shape[1])  # which marker each number stands for
        instants, largest = [], 0
        before = last_seen(places)  # markers may change places while they are out of sight
        for k in range(1, len(places)):
            taken = _taken(before[k - 1], places[k], spacing)
            if taken:
                instants.append(k)
                largest = max(largest, len(taken))
                own[list(taken)] = own[list(taken.values())]
            faulty[k] = own != np.arange(len(own))
        if not instants:
            continue
        faulty &= np.isfinite(places).all(axis=-1)
        changed = ids[faulty.any(axis=0)]
        numbers = ", ".join(map(str, changed[:8].tolist())) + (", ..." if len(changed) > 8 else "")
        renumbered = largest > 2
        yield Finding(
            "markers_renumbered" if renumbered else "markers_exchanged",
            topic,
            "warning",
            f"The markers {numbers} jump by {spacing:.3g} {'px' if role == 'tracks' else 'm'} and more to where others "
            f"of them were in the frame before, at {when(t, [(k, k + 1) for k in instants])}: "
            + ("the tracker numbered them anew." if renumbered else "the tracker exchanged their numbers."),
            "Their readings from there on are left out, until they are exchanged back.",
            times=tuple(float(t[k]) for k in instants),
            values=(spacing,),
            bound=OBSERVATIONS.exchanged_jump_share * spacing,
            role=role,
            part=name,
            faulty=faulty,
        )


def usual_spacing(places: np.ndarray) -> float | None:
    """Distance of neighbouring markers, the median over markers in the frame that shows most of them; None for one
    marker."""
    seen = np.isfinite(places).all(axis=-1)
    frame = places[int(np.argmax(seen.sum(axis=1)))]
    frame = frame[np.isfinite(frame).all(axis=1)]
    if len(frame) < 2:
        return None
    spacing = float(np.median(cKDTree(frame).query(frame, k=2)[0][:, 1]))
    return spacing if spacing > 0.0 else None


def _taken(before: np.ndarray, now: np.ndarray, spacing: float) -> dict[int, int]:
    """Which markers have taken whose places from one frame ``(m, d)`` to the next, each place once."""
    step = np.linalg.norm(now - before, axis=1)
    jumped = np.flatnonzero(np.nan_to_num(step) > OBSERVATIONS.exchanged_jump_share * spacing)
    if len(jumped) < 2:
        return {}
    # What all do is motion: a jump is relative to the median of the others.
    there = np.isfinite(step)
    common = np.median((now - before)[there], axis=0)
    deviation = np.linalg.norm(now[jumped] - before[jumped] - common, axis=1)
    if len(jumped) == there.sum() and np.median(deviation) < OBSERVATIONS.exchanged_jump_share * spacing:
        return {}
    distance = np.linalg.norm(now[jumped, None] - before[None, jumped], axis=-1)
    nearest = np.argmin(distance, axis=1)
    near = distance[np.arange(len(jumped)), nearest] < OBSERVATIONS.exchanged_place_share * step[jumped]
    places = jumped[nearest]
    taken = {int(i): int(j) for i, j, good in zip(jumped, places, near, strict=True) if good and i != j}
    while taken and set(taken) != set(taken.values()):  # only whole circles
        taken = {i: j for i, j in taken.items() if i in taken.values() and j in taken}
        if len(set(taken.values())) < len(taken):
            return {}
    return taken
