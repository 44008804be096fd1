"""Readings that are there several times under new stamps: a driver that publishes faster than its sensor reads."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from sysid.observations.checks.finding import Finding, runs_of
from sysid.observations.checks.frozen import same_as_before
from sysid.observations.checks.streams import streams_of
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def repeated(recording: Recording) -> Iterator[Finding]:
    """Streams in which a share of the rows is exactly the row before, again and again, for a reading or two."""
    exact = any(event.exact_poses for event in recording.events)
    for stream in streams_of(recording):
        if exact and stream.role == "pose":
            continue
        again = repeats(stream.values)
        if not again.any():
            continue
        count = int(again.sum())
        rate = (len(stream.t) - 1) / max(float(stream.t[-1] - stream.t[0]), 1e-9)
        yield Finding(
            "repeated",
            stream.topic,
            "warning",
            f"{count} of {len(again)} messages repeat all that the one before says, under a new stamp, a few at a time "
            f"and throughout: {stream.name} measured {rate * (1.0 - count / len(again)):.3g} times a second and was "
            f"published {rate:.3g} times.",
            "The repetitions are left out. Publish each reading once, with the stamp at which it was taken.",
            times=tuple(stream.t[again]),
            values=(count / len(again),),
            bound=OBSERVATIONS.repeated_share,
            role=stream.role,
            part=stream.name,
            faulty=stream.faulty(again),
        )


def repeats(values: np.ndarray) -> np.ndarray:
    """Which rows ``(n,)`` repeat the one before where that is none of chance, standstill or coarse steps; none if they
    are few.

    A row repeats by chance where each of its columns does. How often a column does is taken from the rows that are
    another reading as a whole. Columns that stand still together, as those of a pose without noise, do so for long,
    not for every second message. At a standstill without noise, and where a driver is stuck, more rows are the same in
    a row than a faster publisher makes.
    """
    none = np.zeros(len(values), dtype=bool)
    finite = np.isfinite(values)
    low = np.where(finite, values, np.inf).min(axis=0, initial=np.inf)
    high = np.where(finite, values, -np.inf).max(axis=0, initial=-np.inf)
    values = values[:, high > low]
    if len(values) < 4 * OBSERVATIONS.repeated_fewest or not values.shape[1]:
        return none
    same = same_as_before(values)
    short = np.zeros(len(same), dtype=bool)
    for a, b in runs_of(same):
        if b - a < OBSERVATIONS.frozen_in_a_row:
            short[a:b] = True
    fresh = ~same
    if short.sum() < OBSERVATIONS.repeated_fewest or short.sum() < OBSERVATIONS.repeated_share * (short | fresh).sum():
        return none
    columns = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    usual = (columns[fresh].sum(axis=0) + 1.0) / (fresh.sum() + 2.0)
    chance = float(np.exp(np.log(usual).sum()))
    if len(same) * chance > OBSERVATIONS.repeated_chance * short.sum() and not _regular(same):
        return none
    return np.concatenate([[False], short])


def _regular(same: np.ndarray) -> bool:
    """Whether repetitions ``(n,)`` and new readings take turns, nearly always so many of the one after so many of the
    other, while anything changes."""
    again = [(a, b) for a, b in runs_of(same) if b - a < OBSERVATIONS.frozen_in_a_row]
    turns = [(b - a, after - b) for (a, b), (after, _) in pairwise(again)]
    turns = [turn for turn in turns if turn[1] < OBSERVATIONS.frozen_in_a_row]
    usual = max(turns.count(turn) for turn in set(turns)) if turns else 0
    return usual >= max(OBSERVATIONS.repeated_fewest, OBSERVATIONS.repeated_regular_share * len(turns))
