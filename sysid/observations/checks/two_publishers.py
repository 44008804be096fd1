"""Two sources on one topic: a second driver, a replayed bag next to a live robot, a commanded pose remapped onto a
measured one. Their messages interleave, and what is read jumps to and fro."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.noise.quantisation import common_step
from sysid.observations.checks.finding import Finding
from sysid.observations.checks.motion import components
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def two_publishers(recording: Recording) -> Iterator[Finding]:
    """Two levels between which poses or wrenches jump to and fro."""
    groups = (("pose", recording.poses), ("target pose", recording.target_poses))
    for _, poses in groups:
        for name, stream in poses.items():
            yield from _interleaved(name, stream.topic, stream.t, stream.position, "m", "mm", 1e3)
    for name, wrench in recording.wrenches.items():
        yield from _interleaved(name, wrench.topic, wrench.t, components(wrench)[:, :3], "N", "N", 1.0)


def _interleaved(
    name: str, topic: str, t: np.ndarray, values: np.ndarray, unit: str, shown: str, scale: float
) -> Iterator[Finding]:
    found = two_levels(values)
    if found is None:
        return
    second, apart = found
    late = second_after_first(t, second)
    yield Finding(
        "two_publishers",
        topic,
        "stops a fit",
        f"Messages of two sources are interleaved on this topic: {int((~second).sum())} and {int(second.sum())} "
        f"samples {scale * apart:.3g} {shown} and {1e3 * late:.3g} ms apart, where those of each are continuous.",
        "Stop the second publisher and record again, or write a copy of the recording with one of them.",
        times=(float(t[0]), float(t[-1])),
        values=(apart, late),
        bound=0.0,
        part=name,
    )


def two_levels(values: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Which of the samples ``(n, c)`` are of a second source, and how far the two are apart; None where there is one.

    The residual of each sample from the straight line through its neighbours has two levels where neighbours are of
    the other source and none where they are of the same.
    """
    values = values[:, np.isfinite(values).all(axis=0)]
    if len(values) < OBSERVATIONS.two_source_samples or not values.shape[1]:
        return None
    window = 8
    # The midrange of a few samples lies between the two sources, whatever their pattern.
    padded = np.pad(values, ((window // 2, window // 2 - 1), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, window, axis=0)
    centred = values - 0.5 * (windows.max(axis=-1) + windows.min(axis=-1))
    column = int(np.argmax(np.median(np.abs(centred), axis=0)))
    levels = centred[:, column]
    second = levels > 0.0
    share = float(second.mean())
    if (
        not OBSERVATIONS.two_source_share < share < 1.0 - OBSERVATIONS.two_source_share
        or np.mean(second[1:] != second[:-1]) < OBSERVATIONS.two_source_turns_share
    ):
        return None
    apart = float(np.median(levels[second]) - np.median(levels[~second]))
    # Each source by itself is continuous: it goes on from its own last sample by far less than the two are apart.
    own = np.concatenate([np.abs(np.diff(values[which, column], n=2)) for which in (second, ~second)])
    mixed = np.abs(np.diff(values[:, column], n=2))
    if (
        apart < OBSERVATIONS.two_source_distance
        or np.median(own) ** 2 > OBSERVATIONS.two_source_variance_share * np.median(mixed) ** 2
        or np.median(own) > 0.2 * apart
    ):
        return None
    step = common_step([values[:, column]])
    if step and apart < 1.5 * step:
        return None
    return second, apart


def second_after_first(t: np.ndarray, second: np.ndarray) -> float:
    """How long after the last sample of the first source one of the second comes [s], the median."""
    first = t[~second]
    before = np.searchsorted(first, t[second], side="right") - 1
    return float(np.median((t[second] - first[np.maximum(before, 0)])[before >= 0]))
