"""Data-quality warnings, whatever a fit makes of the recordings: faults they were read with, sensors and poses
that are dead, noise that differs between them, too few readings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sim_core.rigs import Rig
from sysid.noise.estimate import by_differences, declared_noise, quantities
from sysid.noise.stillness import moves, quiet
from sysid.observations.observations import UNITS, Measured, Run
from sysid.recording.notes import plural
from sysid.settings.noise import NOISE


def data_quality_warnings(rig: Rig, runs: Sequence[Run]) -> list[str]:
    """A sentence for each such thing."""
    said = []
    for run in runs:
        if run.doubts:
            more = (
                f"; and {len(run.doubts) - NOISE.listed_faults} more, in the notes"
                if len(run.doubts) > NOISE.listed_faults
                else ""
            )
            said.append(
                f"{run.name} was read with {plural(len(run.doubts), 'fault')} that may change the result: "
                f"{'; '.join(run.doubts[: NOISE.listed_faults])}{more}".rstrip(".")
                + "."
            )
        said += _dead(run)
        if run.poses and not any(moves(p) for p in run.poses.values()):
            said += _restless(rig, run)
    said += _apart(runs)
    instants = sum(max(int(np.isfinite(m.values).any(axis=1).sum()) for m in run.measured) for run in runs)
    if instants < NOISE.few_instants:
        said.append(
            f"There are readings of {plural(instants, 'instant')} only. That a rig explains so few says little of it: "
            "record for longer."
        )
    return said


def _dead(run: Run) -> Iterator[str]:
    """Sensors of which every reading is the same."""
    for m in run.measured:
        finite = np.isfinite(m.values)
        seen = m.values[:, finite.sum(axis=0) >= NOISE.few_instants]
        if seen.size and np.all(np.nanmax(seen, axis=0) == np.nanmin(seen, axis=0)):
            count = int(finite.any(axis=1).sum())
            yield f"All {count} readings of {m.channel} in {run.name} are the same: look whether it was on."


def _restless(rig: Rig, run: Run) -> Iterator[str]:
    """Readings that change in a recording in which no end effector moves."""
    for m in run.measured:
        declared = np.broadcast_to(declared_noise(rig, m.channel), m.values.shape[1])
        for quantity, group in quantities(m):
            values = m.values[:, group]
            values = values[:, np.isfinite(values).any(axis=0)]
            if np.isfinite(values).sum() < NOISE.scatter_readings:
                continue
            scatter = float(np.sqrt(np.nanmean((values - np.nanmean(values, axis=0)) ** 2)))
            noise = float(np.median(declared[group])) * NOISE.restless_over_declared
            noise = noise or max([*by_differences(values, m.t), 0.0]) * NOISE.restless_over_neighbours
            if scatter > noise > 0.0:
                yield (
                    f"No end effector moves in {run.name}, and yet the {quantity} of {m.channel} changes by more than "
                    "its noise. Unless something falls, swings or relaxes by itself, its poses are not those of the "
                    "hand: look whether their topic was alive."
                )


def _apart(runs: Sequence[Run]) -> Iterator[str]:
    """Quantities that are much noisier in one recording than in another, by what neighbouring samples show, at rest if
    possible."""
    levels: dict[tuple[str, str, str], list[tuple[float, str]]] = {}
    for run in runs:
        for m in run.measured:
            for quantity, group in quantities(m):
                found = by_differences(*_seen(run, m, group))
                if found and found[0] > 0.0:
                    unit = UNITS[m.kind][1 if quantity == "torque" else 0]
                    levels.setdefault((m.channel, quantity, unit), []).append((found[0], run.name))
    for (channel, quantity, unit), there in levels.items():
        (low, calm), (high, loud) = min(there), max(there)
        if high > NOISE.noise_levels_ratio * low:
            yield (
                f"The {quantity} of {channel} has a noise of {high:.2g} {unit} in {loud} and of {low:.2g} {unit} in "
                f"{calm}, and both are weighed alike. Fit them apart, or leave out what is noisier."
            )


def _seen(run: Run, measured: Measured, group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Readings of a group of columns in the longest rest, or all, empty where there are too few, and their times."""
    rest = max(quiet(run, measured.t), key=len, default=np.arange(len(measured.t)))
    if np.isfinite(measured.values[np.ix_(rest, group)]).sum() < NOISE.scatter_readings:
        rest = rest[:0]
    return measured.values[np.ix_(rest, group)], measured.t[rest]
