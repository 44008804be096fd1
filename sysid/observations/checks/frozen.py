"""Readings and poses that do not change any more: a driver or a bridge that repeats its last message under new
stamps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.observations.checks.finding import Finding, runs_of, when
from sysid.observations.checks.motion import at_rest, noisy, repeats_at_rest
from sysid.observations.checks.streams import Rows, streams_of
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def frozen(recording: Recording) -> Iterator[Finding]:
    """Stretches in which a wrench, or all markers of a sensor or camera, repeat exactly."""
    for stream in streams_of(recording):
        if stream.role != "pose":
            yield from _frozen(recording, stream)


def frozen_poses(recording: Recording) -> Iterator[Finding]:
    """Stretches in which the pose of an end effector repeats exactly, where at rest it otherwise has noise."""
    streams = list(streams_of(recording))
    sensors = [s for s in streams if s.role != "pose"]
    for pose in (s for s in streams if s.role == "pose"):
        name, values = pose.name, pose.values
        if len(values) < 2 * OBSERVATIONS.frozen_in_a_row:
            continue
        same = same_as_before(values)
        found = [(a + 1, b + 1) for a, b in runs_of(same) if b - a >= OBSERVATIONS.frozen_pose_block]
        if not found or not _noise_at_rest(values, same):
            continue
        spans = [(float(pose.t[a - 1]), float(pose.t[b - 1])) for a, b in found]
        felt = [s.name for s in sensors if any(_changes(s.t, s.values, *span) for span in spans)]
        yield Finding(
            "frozen_pose",
            pose.topic,
            "stops a fit" if felt else "warning",
            f"{sum(b - a for a, b in found)} of {len(values)} poses of {name} repeat the one before exactly, "
            f"{when(pose.t, found)}, while it otherwise has noise at rest"
            + (f", and {', '.join(felt)} changes meanwhile" if felt else "")
            + ": its driver was stuck.",
            "Fit windows of the recording without these times, BAG@BEGIN:END.",
            times=tuple(time for span in spans for time in span),
            values=tuple(end - begin for begin, end in spans),
            bound=float(OBSERVATIONS.frozen_in_a_row),
            part=name,
        )


def _noise_at_rest(values: np.ndarray, same: np.ndarray) -> bool:
    """Whether values ``(n, m)`` scatter about places at which they stand still: so does a sensor with noise. One
    without repeats itself there. ``same`` ``(n - 1,)``: values are those before."""
    count = len(values) // OBSERVATIONS.frozen_pose_block
    blocks = values[: count * OBSERVATIONS.frozen_pose_block].reshape(count, OBSERVATIONS.frozen_pose_block, -1)
    repeats = (
        np.append(same, False)[: count * OBSERVATIONS.frozen_pose_block]
        .reshape(count, OBSERVATIONS.frozen_pose_block)
        .any(axis=1)
    )
    noise = np.std(np.diff(blocks, axis=1), axis=1) / np.sqrt(2.0)
    half = OBSERVATIONS.frozen_pose_block // 2
    drift = np.abs(blocks[:, half:].mean(axis=1) - blocks[:, :half].mean(axis=1))
    rest = (
        (drift <= OBSERVATIONS.changed_over_noise * noise * np.sqrt(2.0 / half)).all(axis=1)
        & (noise > 0.0).any(axis=1)
        & ~repeats
    )
    return bool(rest.sum() >= OBSERVATIONS.frozen_pose_rests)


def _changes(t: np.ndarray, values: np.ndarray, begin: float, end: float) -> bool:
    """Whether readings are others in the second half of a stretch of time than in the first, beyond their noise."""
    middle = 0.5 * (begin + end)
    first, second = values[(t >= begin) & (t < middle)], values[(t >= middle) & (t <= end)]
    if min(len(first), len(second)) < OBSERVATIONS.frozen_in_a_row:
        return False
    columns = np.isfinite(first).all(axis=0) & np.isfinite(second).all(axis=0)
    if not columns.any():
        return False
    whole = np.vstack([first, second])[:, columns]
    noise = np.std(np.diff(whole, axis=0), axis=0) / np.sqrt(2.0)
    apart = np.abs(first[:, columns].mean(axis=0) - second[:, columns].mean(axis=0))
    return bool((apart > OBSERVATIONS.changed_over_noise * noise).any())


def same_as_before(values: np.ndarray) -> np.ndarray:
    """Which rows are, in all that was measured, those before ``(n - 1,)``."""
    before, after = values[:-1], values[1:]
    alike = (before == after) | (np.isnan(before) & np.isnan(after))
    return np.asarray(alike.all(axis=1) & np.isfinite(after).any(axis=1))


def stretches(same: np.ndarray, still: np.ndarray, has_noise: bool) -> list[tuple[int, int]]:
    """Stretches of readings that repeat more often in a row than chance makes them: indices of the repeated readings,
    not of the first. ``same`` ``(n - 1,)``, ``still`` ``(n,)``; ``has_noise``: while the readings change."""
    long = [(a, b) for a, b in runs_of(same) if b - a >= OBSERVATIONS.frozen_in_a_row]
    if not long:
        return []
    short = [b - a for a, b in runs_of(same) if b - a < OBSERVATIONS.frozen_in_a_row]
    if len(short) > max(OBSERVATIONS.frozen_in_a_row, len(long)):
        # Readings repeat by themselves, as those of a display or of a coarse converter do.
        return []
    inside = np.zeros(len(same), dtype=bool)
    for a, b in long:
        inside[a:b] = True
    level = repeats_at_rest(same, still & ~np.concatenate([[False], inside]))
    if (level is None and not has_noise) or (level is not None and level > OBSERVATIONS.noisy_repeated_share):
        return []
    usual = float(same[~inside].mean()) if (~inside).any() else 1.0
    chance = max(usual, level or 0.0, 1.0 / len(same))
    return [(a + 1, b + 1) for a, b in long if len(same) * chance ** (b - a) < OBSERVATIONS.frozen_chance]


def _frozen(recording: Recording, stream: Rows) -> Iterator[Finding]:
    t, values = stream.t, stream.values
    if len(values) < 2 * OBSERVATIONS.frozen_in_a_row:
        return
    found = stretches(same_as_before(values), at_rest(recording, t), noisy(values, t))
    if not found:
        return
    rows = np.zeros(len(values), dtype=bool)
    for a, b in found:
        rows[a:b] = True
    yield Finding(
        "frozen",
        stream.topic,
        "warning",
        f"{int(rows.sum())} of {len(rows)} readings repeat the one before exactly, {when(t, found)}, while the others "
        "have noise: the sensor or its driver was stuck.",
        "They are left out.",
        times=tuple(t[rows]),
        values=tuple(float(b - a) for a, b in found),
        bound=float(OBSERVATIONS.frozen_in_a_row),
        role=stream.role,
        part=stream.name,
        faulty=stream.faulty(rows),
    )
