"""Markers that were lost and yet have a place: (0, 0) or another fixed one, or the one where they were last seen."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.noise.quantisation import common_step
from sysid.observations.checks.finding import Finding, runs_of
from sysid.observations.checks.motion import at_rest, noisy, repeats_at_rest
from sysid.recording import Recording
from sysid.recording.notes import plural
from sysid.settings.observations import OBSERVATIONS


def lost_markers(recording: Recording) -> Iterator[Finding]:
    """Places that several markers take exactly, and markers that repeat exactly while others move on."""
    for role, name, topic, t, places in placed_markers(recording):
        at, place = _fixed_place(places)
        if at.any():
            where = "(" + ", ".join(f"{value:g}" for value in place) + ")"
            yield Finding(
                "lost_as_a_place",
                topic,
                "warning",
                f"{plural(int(at.sum()), 'reading')} of {plural(int(at.any(axis=0).sum()), 'marker')} of "
                f"{int(np.isfinite(places[..., 0]).sum())} in all are exactly {where}, where no marker was before or "
                "after: the tracker writes that for lost markers.",
                "They are left out. Let it leave out lost markers.",
                times=tuple(t[at.any(axis=1)]),
                values=tuple(float(v) for v in place),
                role=role,
                part=name,
                faulty=at,
            )
        repeated = _repeated(recording, t, np.where(at[..., None], np.nan, places))
        if repeated.any():
            yield Finding(
                "lost_and_repeated",
                topic,
                "warning",
                f"{plural(int(repeated.sum()), 'reading')} of {plural(int(repeated.any(axis=0).sum()), 'marker')} "
                "repeat the place before exactly while other markers have moved on: the tracker repeats the last "
                "place of lost markers.",
                "They are left out. Let it leave out lost markers.",
                times=tuple(t[repeated.any(axis=1)]),
                role=role,
                part=name,
                faulty=repeated,
            )


def _beyond_chance(repeated: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Those of the repetitions ``(n, m)`` of readings in coarse steps that are more in a row than chance makes."""
    chance = float(repeated.sum()) / max(int(seen.sum()), 1)
    kept = np.zeros_like(repeated)
    for column in range(repeated.shape[1]):
        for a, b in runs_of(repeated[:, column]):
            kept[a:b, column] = seen.sum() * chance ** (b - a) < OBSERVATIONS.lost_chance
    return kept


def placed_markers(recording: Recording) -> Iterator[tuple[str, str, str, np.ndarray, np.ndarray]]:
    """Role, name, topic, times [s] ``(n,)`` and places ``(n, m, d)`` of all markers, in space [m] or a picture [px]."""
    for name, m in recording.markers.items():
        yield "markers", name, m.topic, m.t, m.position
    for name, k in recording.tracks.items():
        yield "tracks", name, k.topic, k.t, k.uv


def _fixed_place(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Readings ``(n, m)`` at the exact place ``(d,)`` that most readings share, if no marker is there otherwise."""
    none = np.zeros(places.shape[:2], dtype=bool)
    seen = np.isfinite(places).all(axis=-1)
    if seen.sum() < 4 * OBSERVATIONS.lost_at_one_place:
        return none, np.zeros(places.shape[-1])
    found, count = np.unique(places[seen], axis=0, return_counts=True)
    zero = np.flatnonzero((found == 0.0).all(axis=1))
    for index in (*zero, int(np.argmax(count))):
        at = (places == found[index]).all(axis=-1) & seen
        usual = np.where((seen & ~at)[..., None], places, np.nan)
        own = at.any(axis=0) & (seen & ~at).any(axis=0)
        middle = np.full((places.shape[1], places.shape[2]), np.nan)
        middle[own] = np.nanmedian(usual[:, own], axis=0)
        spread = np.nanmedian(np.linalg.norm(usual - middle, axis=-1)[:, own], axis=0) if own.any() else np.zeros(0)
        off = np.linalg.norm(middle - found[index], axis=-1)
        far = np.zeros(len(own), dtype=bool)
        far[own] = off[own] > OBSERVATIONS.lost_distance_ratio * np.maximum(
            spread, 1e-3 * max(float(np.nanmax(off, initial=0.0)), 1e-12)
        )
        # Of a marker that is nowhere else nothing is known but that others are there too.
        shared = at.any(axis=0) & ~own & (far.any() or bool(at.any(axis=0).sum() > 1))
        at = at & (far | shared)
        if at.sum() >= OBSERVATIONS.lost_at_one_place:
            return at, found[index]
    return none, np.zeros(places.shape[-1])


def _repeated(recording: Recording, t: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Readings ``(n, m)`` that are exactly those before of the same marker, in a stream with noise."""
    repeated = np.zeros(places.shape[:2], dtype=bool)
    if len(places) < OBSERVATIONS.lost_at_one_place or places.shape[1] < OBSERVATIONS.lost_at_one_place:
        return repeated
    before = last_seen(places)
    repeated[1:] = (places[1:] == before[:-1]).all(axis=-1)
    seen = np.isfinite(places).all(axis=-1)
    share = repeated.sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    mostly = share > 0.5
    others = repeated[1:][~mostly[1:]]
    still = at_rest(recording, t)
    usual = float(np.median(repeated[1:].mean(axis=0)))
    rest = repeats_at_rest(share[1:] > OBSERVATIONS.lost_repeated_share, still)
    if rest is None:
        rest = 0.0 if noisy(places.reshape(len(places), -1), t) else 1.0
    steps = np.abs(np.diff(places, axis=0)).max(axis=-1)
    steps = steps[steps > 0.0]
    nearly = int((steps < OBSERVATIONS.no_step_share * np.median(steps)).sum()) if len(steps) else 0
    if max(usual, rest) > OBSERVATIONS.lost_repeated_share or others.sum() < max(
        OBSERVATIONS.lost_at_one_place, OBSERVATIONS.lost_repetitions_ratio * nearly
    ):
        return np.zeros_like(repeated)
    if common_step(places.reshape(len(places), -1).T) > OBSERVATIONS.no_step_share * float(np.median(steps)):
        repeated = _beyond_chance(repeated, seen)
    repeated[mostly] = False
    repeated[:, repeated.sum(axis=0) > 0.5 * seen.sum(axis=0)] = False  # what never moves is not lost
    return repeated if repeated.sum() >= OBSERVATIONS.lost_at_one_place else np.zeros_like(repeated)


def last_seen(places: np.ndarray) -> np.ndarray:
    """Where each marker was last seen, up to each reading ``(n, m, d)``."""
    seen = np.isfinite(places).all(axis=-1)
    index = np.where(seen, np.arange(len(places))[:, None], 0)
    np.maximum.accumulate(index, axis=0, out=index)
    return np.asarray(places[index, np.arange(places.shape[1])])
