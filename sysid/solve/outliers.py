"""Readings that are mistakes: of a tracker, misdetections, exchanged numbers, jumps that come back; of a force sensor,
single spikes (:mod:`sysid.solve.wrench_spikes`). What follows is about markers.

Least squares trusts every reading, and one that is 50 noise deviations off counts 2500 times. Readings are therefore
looked at one by one, as vectors of a marker in a frame, and those that are mistakes get the weight 0, all others 1.
A loss with long tails would shrink what honest readings say, and would take away from a law that is missing what makes
it known. A reading is where another marker should be that is elsewhere itself, which no motion explains, or it stands
out in time: its miss (measured minus predicted, and minus the median of the picture, which a shaking camera shifts) is
far from what the misses of that marker before it let expect, from what those after it do, as a level and as a straight
line, and from the mean of both, so that neither a step nor a drift of the miss counts, and a marker that stays away for
more than four frames has moved. One that stands out is kept where it may be physics:

- several markers of the frame, or of the nearest ones, miss by a similar vector, more of them than mistakes that are
  as frequent as those of the recording would by chance (binomial), even if half of them were alike;
- the same marker stands out again and again, more often than mistakes that fall on any marker would;
- more than ``SOLVE.outlier_frame_share`` of the markers of that frame stand out at once, as where a model misses a
  snap or a landing, and it misses what the nearest markers miss, as these do of theirs.

What is far, the recording says: the least of these squared distances, of what is not kept for these reasons, is taken
for a mixture of the noise and of a rare, wide scatter (a contaminated normal distribution, Tukey 1960), whose share and
widths are found by expectation maximisation; a mistake is more probably of the latter.

Nothing is left out where fewer than ``SOLVE.outlier_markers`` markers are seen, which are too few to compare. How far a
model is off has no part in it: readings are compared with what it misses before and after. What remains in doubt is a
lone marker that is displaced for at most four frames and is so seldom: it is taken for a mistake, whatever moved it.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.stats import binom, chi2

from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.solve import SOLVE
from sysid.solve.wrench_spikes import spikes

DIMENSIONS = {"markers": 3, "tracks": 2}
"""Of the vectors that a channel of markers reads."""

WRENCH = "wrench"

Mask = np.ndarray
"""Which readings are mistakes, ``(frames, markers)``."""


@dataclass(frozen=True)
class Outliers:
    """Mistakes in one channel of one run. ``share``: of its readings; ``markers``: their numbers with the times [s] of
    each, of a wrench its components; ``kept``: they are too many to be exceptions, and were not left out; ``kind``: of
    the channel."""

    run: str
    channel: str
    share: float
    markers: dict[str, list[float]]
    kept: bool = False
    kind: str = "markers"

    @property
    def _percent(self) -> str:
        return f"{100.0 * self.share:.2g} %"

    @property
    def sentence_of_score(self) -> str:
        """What is wrong with a held-out recording, which is scored with all of its readings, in words."""
        number = sum(len(times) for times in self.markers.values())
        what, whose = ("readings", "the sensor") if self.kind == WRENCH else ("marker readings", "the tracker")
        return (
            f"{self.run}: {number} of the {what} of {self.channel} ({self._percent}) look like mistakes of "
            f"{whose}. The scores of this held-out recording count them all the same."
        )

    @property
    def sentence(self) -> str:
        """What was left out, in words."""
        percent = self._percent
        if self.kept:
            return (
                f"{self.run}: {percent} of the marker readings of {self.channel} jump about, too many to be "
                "exceptions. They are kept: look at the tracking."
            )
        most = sorted(self.markers, key=lambda m: -len(self.markers[m]))
        shown = ", ".join(
            f"{m} ({len(self.markers[m])} from {min(self.markers[m]):.2f} s)"
            if len(self.markers[m]) > 1
            else f"{m} (at {self.markers[m][0]:.2f} s)"
            for m in most[:5]
        )
        more = f" and {len(most) - 5} more" if len(most) > 5 else ""
        if self.kind == WRENCH:
            return (
                f"{self.run}: {percent} of the readings of {self.channel} are single spikes, treated as outliers: "
                f"{shown}{more}."
            )
        number = "markers" if len(most) > 1 else "marker"
        return (
            f"{self.run}: {percent} of the marker readings of {self.channel} are treated as outliers: "
            f"{number} {shown}{more}."
        )


def without_outliers(
    runs: Sequence[Run], predictions: Sequence[Prediction], noise: Mapping[str, ChannelNoise]
) -> tuple[list[Run], list[Outliers]]:
    """The runs with mistakes as missing, and what they are; ``noise``: of each channel."""
    clean, found = [], []
    for run, prediction in zip(runs, predictions, strict=True):
        measured = []
        for m in run.measured:
            there = prediction.values[m.channel]
            mask = _mask(m, there, noise[m.channel])
            if not mask.any():
                measured.append(m)
                continue
            excluded = _outliers_of(run.name, m, mask)
            found.append(excluded)
            gone = np.repeat(mask & (not excluded.kept), DIMENSIONS.get(m.kind, 1), axis=1)
            measured.append(replace(m, values=np.where(gone, np.nan, m.values)))
        clean.append(replace(run, measured=tuple(measured)))
    return clean, found


def _mask(measured: Measured, predicted: np.ndarray, noise: ChannelNoise) -> Mask:
    """Mistakes of a channel of any kind, by marker or component."""
    if measured.kind == WRENCH:
        return spikes(measured, predicted, noise.sigma)
    if measured.kind not in DIMENSIONS:
        return np.zeros((len(measured.t), 0), dtype=bool)
    return mistakes(measured, predicted)


def worth_another_fit(before: Sequence[Run], after: Sequence[Run]) -> bool:
    """Whether mistakes were found that had not been left out, or a tenth of those that had are none."""
    new = back = gone = 0
    for a, b in zip(before, after, strict=True):
        for m, n in zip(a.measured, b.measured, strict=True):
            had, has = np.isfinite(m.values), np.isfinite(n.values)
            new, back, gone = new + int((had & ~has).sum()), back + int((has & ~had).sum()), gone + int((~had).sum())
    return new > 0 or back > 0.1 * gone


def mistakes(measured: Measured, predicted: np.ndarray) -> Mask:
    """Which readings of a channel of markers are mistakes; ``predicted`` ``(n, m)``."""
    d = DIMENSIONS[measured.kind]
    seen = measured.values.reshape(len(measured.t), -1, d)
    place = predicted.reshape(seen.shape)
    miss = seen - place
    there = np.isfinite(miss).all(axis=2)
    miss = _without_common_motion(miss)
    jumps = np.linalg.norm(np.diff(miss, axis=0), axis=2)
    jumps = jumps[np.isfinite(jumps) & (jumps > 0.0)]
    if len(jumps) < 3 * SOLVE.outlier_frames:
        return np.zeros(there.shape, dtype=bool)
    # Differences of two readings: twice the variance of one.
    sigma = float(np.median(jumps) / np.sqrt(2.0 * chi2.median(d)))
    forward = _levels(miss)
    backward = [level[::-1] for level in _levels(miss[::-1])]
    between = [0.5 * (forward[0] + backward[0])]
    apart = [_square(miss - level) for level in (*forward, *backward, *between)]
    # Next to the first and the last reading there is only one side to compare with.
    q = np.min(np.nan_to_num(apart, nan=np.inf), axis=0)
    q = np.where(there & np.isfinite(q), q, 0.0) / _usual(np.where(there, q, np.nan), sigma, d)
    far = q > SOLVE.outlier_sd**2
    one_side = np.where(np.isfinite(forward[0]), forward[0], backward[0])
    away = miss - np.where(np.isfinite(between[0]), between[0], one_side)
    kept = _maybe_physics(far, away, there, place)
    alone = there & ~kept
    found = far & ~kept & (_of_the_rare(q[alone], d, q) > 0.5)
    others = _of_others(seen, place, there, SOLVE.outlier_sd * sigma)
    most = np.maximum(2.0, SOLVE.outlier_frame_share * there.sum(axis=1))
    restless = (q > (0.5 * SOLVE.outlier_sd) ** 2).sum(axis=1) > most
    crowded = others.sum(axis=1) > most
    lone = _lone(miss, there, place, sigma, restless & found.any(axis=1))
    mask = (found & (~restless[:, None] | lone)) | (others & ~crowded[:, None])
    return np.asarray(mask & (there.sum(axis=1) >= SOLVE.outlier_markers)[:, None])


def _without_common_motion(miss: np.ndarray) -> np.ndarray:
    """The misses of a picture ``(n, m, d)`` without their median: what a camera shakes by is no mistake of any marker,
    and would hide those that are."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="All-NaN slice")
        return np.asarray(miss - np.nanmedian(miss, axis=1, keepdims=True))


def _maybe_physics(far: Mask, away: np.ndarray, there: Mask, place: np.ndarray) -> Mask:
    """Readings of ``far`` that others are like, or of markers that recur; ``away`` ``(n, m, d)``: from the level of the
    frames about. How frequent mistakes are is known once what is kept is not counted, so this goes round."""
    in_frame, nearby = _alike(far, away, there, place)
    others = np.broadcast_to(there.sum(axis=1, keepdims=True) - 1, far.shape)
    kept = np.zeros(far.shape, dtype=bool)
    while True:
        left = far & ~kept
        chance = 0.5 * left.sum() / max(int(there.sum()), 1)
        more = (in_frame > 1) & (binom.sf(in_frame - 1, others, chance) < SOLVE.outlier_chance)
        more |= (nearby > 0) & (binom.sf(nearby - 1, SOLVE.outlier_neighbours, chance) < SOLVE.outlier_chance)
        more |= _recurring(left)
        if not (left & more).any():
            return kept
        kept |= left & more


def _alike(far: Mask, away: np.ndarray, there: Mask, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How many other readings of the frame, and of the ``SOLVE.outlier_neighbours`` nearest markers, each of ``far`` is
    like."""
    count = np.zeros((2, *far.shape), dtype=int)
    size = np.linalg.norm(away, axis=2)
    for k in np.flatnonzero(far.any(axis=1)):
        own = np.flatnonzero(far[k])
        apart = np.linalg.norm(away[k][own, None] - away[k][None], axis=2)
        alike = (apart < SOLVE.alike_vector_share * np.maximum(size[k][own, None], size[k][None])) & there[k]
        alike[np.arange(len(own)), own] = False
        count[0, k, own] = alike.sum(axis=1)
        distance = np.linalg.norm(place[k][own, None] - place[k][None], axis=2)
        distance[np.arange(len(own)), own] = np.inf
        distance = np.where(there[k], distance, np.inf)
        nearest = np.argsort(distance, axis=1, kind="stable")[:, : SOLVE.outlier_neighbours]
        count[1, k, own] = np.take_along_axis(alike, nearest, axis=1).sum(axis=1)
    return count[0], count[1]


def _lone(miss: np.ndarray, there: Mask, place: np.ndarray, sigma: float, frames: np.ndarray) -> Mask:
    """Readings of some ``frames`` ``(n,)`` whose miss ``(n, m, d)`` is far from the median of those of the
    ``SOLVE.outlier_neighbours`` nearest markers, relative to how far the misses of the frame usually are from that."""
    out = np.zeros(there.shape, dtype=bool)
    for k in np.flatnonzero(frames):
        seen = np.flatnonzero(there[k])
        distance = np.linalg.norm(place[k][seen, None] - place[k][None, seen], axis=2)
        np.fill_diagonal(distance, np.inf)
        nearest = np.argsort(distance, axis=1, kind="stable")[:, : SOLVE.outlier_neighbours]
        away = np.sum((miss[k][seen] - np.median(miss[k][seen][nearest], axis=1)) ** 2, axis=1)
        usual = max(float(np.median(away)) / float(chi2.median(miss.shape[2])), sigma**2)
        out[k, seen] = away > SOLVE.outlier_sd**2 * usual
    return out


def _recurring(far: Mask) -> Mask:
    """Readings of markers that stand out more often than their share of all times (frames in a row are one)."""
    before = np.concatenate([np.zeros((1, far.shape[1]), dtype=bool), far[:-1]])
    times = (far & ~before).sum(axis=0)
    seldom = binom.sf(times - 1, times.sum(), 1.0 / len(times)) < SOLVE.outlier_chance / len(times)
    return np.asarray(far & seldom & (times >= SOLVE.outlier_repetitions))


def _usual(q: np.ndarray, sigma: float, d: int) -> np.ndarray:
    """Variance of a component that a marker has about each frame ``(n, m)``, at least that of the noise: one that
    trembles, or whose miss is strongly curved, is far only where it is farther than it usually is."""
    edge = np.full((SOLVE.outlier_frames, q.shape[1]), np.nan)
    about = sliding_window_view(
        np.concatenate([edge, np.where(np.isfinite(q), q, np.nan), edge]), 2 * SOLVE.outlier_frames + 1, axis=0
    )
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="All-NaN slice")
        usual = np.nanmedian(about, axis=2) / chi2.median(d)
    return np.asarray(np.fmax(usual, sigma**2))


def _square(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(np.sum(vectors**2, axis=2))


def _levels(miss: np.ndarray) -> list[np.ndarray]:
    """What the ``SOLVE.outlier_frames`` misses before each frame let expect there, as their median and on a straight
    line (of repeated medians, Siegel 1982: both bear it that almost half of them are mistakes), ``(n, m, d)`` each."""
    missing = np.full((SOLVE.outlier_frames, *miss.shape[1:]), np.nan)
    before = np.moveaxis(sliding_window_view(np.concatenate([missing, miss])[:-1], SOLVE.outlier_frames, axis=0), -1, 0)
    ago = np.arange(SOLVE.outlier_frames, 0.0, -1.0).reshape(-1, 1, 1, 1)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="All-NaN slice")
        flat = np.nanmedian(before, axis=0)
        slopes = []
        for j in range(SOLVE.outlier_frames):
            others = np.delete(np.arange(SOLVE.outlier_frames), j)
            slopes.append(np.nanmedian((before[others] - before[j]) / (ago[j] - ago[others]), axis=0))
        slope = np.nanmedian(slopes, axis=0)
        steep = np.nanmedian(before + slope * ago, axis=0)
    return [flat, np.asarray(steep)]


def _of_the_rare(q: np.ndarray, d: int, at: np.ndarray, rounds: int = 50) -> np.ndarray:
    """Probability that squared distances ``at`` are of the rare part of the mixture that ``q`` is of."""
    noise = float(np.median(q) / chi2.median(d)) or 1e-300
    share, wide = 0.01, max(100.0 * noise, float(np.max(q)) / d)

    def rare(values: np.ndarray) -> np.ndarray:
        ratio = np.log(share / (1.0 - share)) + 0.5 * d * np.log(noise / wide)
        ratio = ratio + 0.5 * values * (1.0 / noise - 1.0 / wide)
        return np.asarray(1.0 / (1.0 + np.exp(-np.clip(ratio, -500.0, 500.0))))

    for _ in range(rounds):
        p = rare(q)
        if p.sum() < 0.5:
            return np.zeros(at.shape)
        share = float(np.clip(np.mean(p), 1e-6, 0.5))
        noise = float((1.0 - p) @ q / (d * np.sum(1.0 - p)))
        wide = max(float(p @ q / (d * np.sum(p))), 4.0 * noise)
    return rare(at)


def _of_others(seen: np.ndarray, place: np.ndarray, there: Mask, far: float) -> Mask:
    """Readings that are where another marker should be, whose own is elsewhere as well: numbers are exchanged."""
    out = np.zeros(there.shape, dtype=bool)
    own = np.linalg.norm(np.where(there[:, :, None], seen - place, 0.0), axis=2)
    for k in np.flatnonzero((own > far).any(axis=1)):
        off = np.flatnonzero(own[k] > far)
        apart = np.linalg.norm(seen[k][off, None] - place[k][None, off], axis=2)
        np.fill_diagonal(apart, np.inf)
        nearest = np.argmin(np.nan_to_num(apart, nan=np.inf), axis=1)
        takes = apart[np.arange(len(off)), nearest] < SOLVE.exchanged_marker_share * own[k, off]
        # A place that is taken by one whose own place is taken by another, and so on round.
        while True:
            closed = takes & takes[nearest] & np.isin(np.arange(len(off)), nearest[takes])
            if np.array_equal(closed, takes):
                break
            takes = closed
        out[k, off[takes]] = True
    return out


def _outliers_of(run: str, measured: Measured, mask: Mask) -> Outliers:
    """What was found, by marker."""
    d = DIMENSIONS.get(measured.kind, 1)
    number = int(np.isfinite(measured.values[:, ::d]).sum())
    names = list(measured.labels)
    if measured.kind != WRENCH:
        names = [label.removeprefix("marker ").rsplit(" ", 1)[0] for label in names[::d]]
    markers = {names[k]: measured.t[mask[:, k]].tolist() for k in np.flatnonzero(mask.any(axis=0))}
    share = float(mask.sum()) / max(number, 1)
    return Outliers(run, measured.channel, share, markers, share > SOLVE.outlier_channel_share, measured.kind)
