"""Readings that stop at one level: the range of the sensor, or of its converter, was left."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.noise.estimate import by_differences
from sysid.noise.quantisation import step_of
from sysid.observations.checks.finding import Finding, runs_of, when
from sysid.observations.checks.motion import WORDS, at_rest, components, noisy, repeats_at_rest, unit
from sysid.observations.checks.streams import Rows, streams_of
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def clipped(recording: Recording) -> Iterator[Finding]:
    """Columns of any stream whose largest or smallest value is read exactly many times in a row."""
    for stream in streams_of(recording):
        still = at_rest(recording, stream.t)
        width = stream.values.shape[1] // max(stream.columns, 1)
        for column in range(stream.values.shape[1]):
            values = stream.values[:, column]
            for level in _levels(values, stream.t, still):
                at = values == level
                word, shown = _named(stream, column, width)
                left_out = stream.role != "pose"
                yield Finding(
                    "clipped",
                    stream.topic,
                    "warning",
                    f"{word} reads exactly {level:.6g} {shown}, never beyond it, in {int(at.sum())} of "
                    f"{int(np.isfinite(values).sum())} readings, {when(stream.t, runs_of(at))}: the sensor was at the "
                    "end of its range.",
                    "They are left out." if left_out else "Fit windows of the recording without these times.",
                    times=tuple(stream.t[at]),
                    values=(float(level),),
                    bound=float(level),
                    role=stream.role if left_out else "",
                    part=stream.name,
                    faulty=at[:, None] & (np.arange(stream.columns) == column // width) if left_out else None,
                )


def _named(stream: Rows, column: int, width: int) -> tuple[str, str]:
    """A column in words, and its unit."""
    if stream.role == "wrench":
        return WORDS[column], unit(column)
    if stream.role == "pose":
        names = ("x", "y", "z", "qx", "qy", "qz", "qw")
        return f"{names[column]} of {stream.name}", "m" if column < len("xyz") else ""
    axes, shown = ("uv", "px") if stream.role == "tracks" else ("xyz", "m")
    return f"{axes[column % width]} of a marker of {stream.name}", shown


def constant(recording: Recording) -> Iterator[Finding]:
    """Components of a wrench that have one value throughout, next to others with noise: nothing measures them."""
    for name, wrench in recording.wrenches.items():
        values = components(wrench)
        if len(values) < 4 * OBSERVATIONS.clipped_in_a_row:
            continue
        finite = np.isfinite(values).all(axis=0)
        same = finite & (np.ptp(np.where(np.isfinite(values), values, 0.0), axis=0) == 0.0)
        others = values[:, finite & ~same]
        if not same.any() or not others.size or not noisy(others, wrench.t):
            continue
        if any((step_of(c) or 0.0) > max(by_differences(c[:, None], wrench.t), default=0.0) for c in others.T):
            continue  # less than a step is read as nothing
        words = [f"{WORDS[k]} ({values[0, k]:.4g} {unit(int(k))})" for k in np.flatnonzero(same)]
        yield Finding(
            "constant",
            wrench.topic,
            "note",
            f"{', '.join(words)} of {name} never change in {len(values)} readings, while the others have noise: the "
            "sensor does not measure them.",
            "They are left out. List what it measures under `measures` in the rig.",
            values=tuple(float(v) for v in values[0, same]),
            role="wrench",
            part=name,
            faulty=np.broadcast_to(same, values.shape).copy(),
        )


def _levels(column: np.ndarray, t: np.ndarray, still: np.ndarray) -> Iterator[float]:
    """Ends of the range of a component at which it stays."""
    finite = np.isfinite(column)
    if finite.sum() < 4 * OBSERVATIONS.clipped_in_a_row or np.nanmax(column) == np.nanmin(column):
        return
    for level in (float(np.nanmax(column)), float(np.nanmin(column))):
        at = column == level
        longest = max((b - a for a, b in runs_of(at)), default=0)
        if longest < OBSERVATIONS.clipped_in_a_row:
            continue
        same = column[1:] == column[:-1]
        outside = ~(at[1:] | at[:-1])
        rest = repeats_at_rest(same, still & ~at)
        if rest is None:
            rest = 0.0 if noisy(np.where(at, np.nan, column)[:, None], t) else 1.0
        if rest > OBSERVATIONS.noisy_repeated_share or outside.sum() < 4 * OBSERVATIONS.clipped_in_a_row:
            continue
        chance = max(float(same[outside].mean()), rest, 1.0 / len(column))
        if len(column) * chance ** (longest - 1) < OBSERVATIONS.frozen_chance:
            yield level
