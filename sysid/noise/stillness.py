"""When the hands of a recording stand still, move or creep, by poses that have noise."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs.trajectory import PoseTrajectory
from sysid.observations.observations import Run
from sysid.settings.noise import NOISE

STILL_WITHIN = np.repeat([NOISE.still_shift_m, NOISE.still_turn_rad], 3)
"""Shifts [m] and turns [rad] in ``NOISE.still_window_s`` from which something moves, and in a whole stretch from which
it creeps."""


def quiet(run: Run, t: np.ndarray) -> list[np.ndarray]:
    """Stretches of sample indices in which every end effector stands still: none moves (:func:`moving`) or creeps
    (:func:`creeping`)."""
    return [
        stretch for stretch in _stretches(still_at(run.poses.values(), t)) if len(stretch) >= NOISE.min_rest_samples
    ]


def still_at(poses: Collection[PoseTrajectory], t: np.ndarray) -> np.ndarray:
    """At which of the times [s] ``(n,)`` every end effector stands still, and has done so for
    ``NOISE.rest_margin_s``."""
    still = np.ones(len(t), dtype=bool)
    for trajectory in poses:
        spans = np.array(moving(trajectory)).reshape(-1, 2)
        begun = np.bincount(np.searchsorted(t, spans[:, 0]), minlength=len(t) + 1)
        over = np.bincount(np.searchsorted(t, spans[:, 1] + NOISE.rest_margin_s, side="right"), minlength=len(t) + 1)
        still &= np.cumsum(begun - over)[:-1] == 0
    for trajectory in poses:
        path, noise = _path(trajectory)
        for stretch in _stretches(still):
            still[stretch] &= ~creeping(trajectory.times, path, noise, t[stretch])
    return still


def _stretches(mask: np.ndarray) -> list[np.ndarray]:
    """Indices in a row at which ``mask`` holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [np.arange(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _path(trajectory: PoseTrajectory) -> tuple[np.ndarray, np.ndarray]:
    """Positions [m] and turns [rad] against the first pose ``(n, 6)``, and the noise of each."""
    rotation = Rotation.from_quat(trajectory.quaternions)
    path = np.column_stack([trajectory.positions, (rotation * rotation[0].inv()).as_rotvec()])
    second = np.diff(path, n=2, axis=0)
    return path, 1.4826 * np.median(np.abs(second), axis=0) / np.sqrt(6.0) if len(second) else np.zeros(6)


def creeping(stamps: np.ndarray, path: np.ndarray, noise: np.ndarray, t: np.ndarray) -> np.ndarray:
    """At which of the times ``t`` ``(n,)`` of a stretch without motion an end effector creeps: it gets farther than
    :data:`STILL_WITHIN` in the ``NOISE.creep_window_s`` about them, or in all that is left of the stretch, or drifts as
    far in longer and longer windows.
    ``stamps`` ``(k,)``, ``path`` ``(k, 6)``, ``noise`` ``(6,)``: its poses (:func:`_path`).

    However slow a press is, what it does to readings is no noise. Noisy poses are averaged over
    ``NOISE.still_window_s``; ranges of up to 8 of the deviations that are left are no creep.
    """
    about = slice(max(int(np.searchsorted(stamps, t[0])) - 1, 0), int(np.searchsorted(stamps, t[-1], side="right")) + 1)
    stamps, path = stamps[about], path[about]
    times = np.unique(np.concatenate([t[:1], stamps[(stamps > t[0]) & (stamps < t[-1])], t[-1:]]))
    place = np.column_stack([np.interp(times, stamps, column) for column in path.T])
    total = np.concatenate([np.zeros((1, 6)), np.cumsum(place, axis=0)])
    first, last = _within(times, NOISE.still_window_s)
    place = (total[last] - total[first]) / (last - first)[:, None]
    limit = STILL_WITHIN + 8.0 * noise / np.sqrt(np.min(last - first))
    first, last = _within(times, NOISE.creep_window_s)
    creeps = (np.abs(place[last - 1] - place[first]) > limit).any(axis=1)
    for stretch in _stretches(~creeps):
        creeps[stretch] = (np.ptp(place[stretch], axis=0) > limit).any()
    half = NOISE.creep_window_s
    while half < times[-1] - times[0]:
        creeps |= _drifts(times, place, noise, ~creeps, half)
        half *= 2.0
    return np.asarray(np.interp(t, times, creeps.astype(float)) > 0.0)


def _drifts(times: np.ndarray, path: np.ndarray, noise: np.ndarray, still: np.ndarray, half: float) -> np.ndarray:
    """At which of the times ``(n,)`` that are ``still`` the mean of the path ``(n, 6)`` over the time ``half`` [s]
    before them is farther from that after them than :data:`STILL_WITHIN` and 4 of its standard deviations. What is not
    still counts in neither, so that a rest next to a motion stays one."""
    weight = np.concatenate([[0.0], np.cumsum(still)])
    total = np.concatenate([np.zeros((1, 6)), np.cumsum(np.where(still[:, None], path, 0.0), axis=0)])
    here = np.arange(len(times))
    first, last = np.searchsorted(times, times - half), np.searchsorted(times, times + half, side="right")
    before, after = weight[here + 1] - weight[first], weight[last] - weight[here]
    both = still & (before > 0) & (after > 0)
    change = np.zeros(path.shape)
    change[both] = np.abs(
        (total[last] - total[here])[both] / after[both, None]
        - (total[here + 1] - total[first])[both] / before[both, None]
    )
    scatter = noise * np.sqrt(1.0 / np.maximum(before, 1.0) + 1.0 / np.maximum(after, 1.0))[:, None]
    return np.asarray((change > STILL_WITHIN + 4.0 * scatter).any(axis=1))


def _within(times: np.ndarray, window: float) -> tuple[np.ndarray, np.ndarray]:
    """The first, and one past the last, of the times in the window about each."""
    return np.searchsorted(times, times - 0.5 * window), np.searchsorted(times, times + 0.5 * window, side="right")


def moving(trajectory: PoseTrajectory) -> list[tuple[float, float]]:
    """Spans of time [s] in which an end effector moves, faster than 0.1 mm/s or 1 mrad/s.

    A measured pose has noise, which looks like speed between neighbouring samples. Where it does, the means
    of ``NOISE.still_window_s`` before and after an instant are compared instead. A single pose is that of one that
    stands still.
    """
    t = trajectory.times
    if len(t) < 2:
        return []
    path, noise = _path(trajectory)
    limit = STILL_WITHIN / NOISE.still_window_s
    pause = float(np.median(np.diff(t)))
    if np.all(NOISE.motion_over_noise * noise < limit * pause):
        busy = (np.abs(np.diff(path, axis=0)) > limit * np.diff(t)[:, None]).any(axis=1)
        return [(float(t[k]), float(t[k + 1])) for k in np.flatnonzero(busy)]
    total = np.concatenate([np.zeros((1, 6)), np.cumsum(path, axis=0)])
    first, last = (
        np.searchsorted(t, t - NOISE.still_window_s),
        np.searchsorted(t, t + NOISE.still_window_s, side="right"),
    )
    here = np.arange(len(t))
    before = (total[here + 1] - total[first]) / (here + 1 - first)[:, None]
    after = (total[last] - total[here]) / (last - here)[:, None]
    fewest = np.minimum(here + 1 - first, last - here)[:, None]
    change = np.abs(after - before)
    busy = (change > STILL_WITHIN + 4.0 * noise * np.sqrt(2.0 / fewest)).any(axis=1)
    return [(float(t[k]) - pause, float(t[k]) + pause) for k in np.flatnonzero(busy)]


def standing_still(trajectory: PoseTrajectory, least_s: float) -> list[tuple[float, float]]:
    """Spans of time [s] of at least ``least_s`` in which an end effector stands still: it neither moves nor creeps,
    however slowly and at whatever rate its poses come."""
    t = trajectory.times
    path, noise = _path(trajectory)
    spans, since = [], float(t[0])
    for begin, end in [*moving(trajectory), (float(t[-1]), float(t[-1]))]:
        inside = t[(t >= since) & (t <= begin)]
        if begin - since >= least_s and len(inside) > 1:
            for stretch in _stretches(~creeping(t, path, noise, inside)):
                # What a span lacks at its ends between two poses is none of motion.
                low = since if stretch[0] == 0 else float(inside[stretch[0]])
                high = begin if stretch[-1] == len(inside) - 1 else float(inside[stretch[-1]])
                if high - low >= least_s:
                    spans.append((low, high))
        elif begin - since >= least_s:
            spans.append((since, begin))
        since = max(since, end)
    return spans


def moves(trajectory: PoseTrajectory) -> bool:
    """Whether an end effector gets anywhere in all of the time that its poses are of, however slowly."""
    if len(trajectory.times) < 2:
        return False
    path, noise = _path(trajectory)
    return bool(moving(trajectory)) or bool(creeping(trajectory.times, path, noise, trajectory.times).any())
