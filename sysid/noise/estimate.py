"""The noise of each channel, from the recording itself.

Where the robot stands still and nothing moves, the scatter about the mean of a column is its noise; the
correlation there tells coloured from white, and where both go together how much is of each
(:mod:`sysid.noise.mixture`). Without such a stretch the third differences do

    var(x_{k+3} - 3 x_{k+2} + 3 x_{k+1} - x_k) = 20 sigma^2    for white noise,

by the median of their size, so that jumps do not count (differences: Gasser, Sroka & Jennen-Steinmetz, Biometrika
73, 1986). They cannot see colour, and what the readings themselves do within four samples counts as noise. In the
channels of simulated presses and rubs that have no rest and move fast, that adds 6 % on average and 16 % at most;
second differences, in which a steady acceleration shows, see 9 % too much. Columns of a kind (forces,
torques, markers) share one level and one colour. A stretch that is far above the declared noise and far smoother
than such noise would be is no rest, though no hand moves: something falls there. Readings that come in steps have at
least the noise of their rounding, step / sqrt(12) (:mod:`sysid.noise.quantisation`).

A recording shows how much neighbouring samples scatter, but not what was smoothed, interpolated or rounded
away before it was written: a much larger noise that the rig declares takes its place. So it does where every reading
is far from all others in time (single images at rest).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sim_core.rigs import MarkerSensor, Rig, WrenchSensor
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.common_mode import CommonMode
from sysid.noise.common_mode_estimate import common_mode
from sysid.noise.mixture import mixtures_of
from sysid.noise.quantisation import common_step
from sysid.noise.sampling_interval import in_sampling_intervals
from sysid.noise.scatter import Stretch, line_residual, scatter_of, without_mistakes
from sysid.noise.stillness import quiet
from sysid.observations.observations import UNITS, Measured, Run
from sysid.settings.noise import NOISE

DECLARED = "declared by the rig"
FROM_DIFFERENCES = "third differences"
"""How a noise was found, where it is not from a rest."""


def column_groups(measured: Measured) -> list[np.ndarray]:
    """Columns that share a unit: forces and torques apart, else all."""
    if measured.kind == "wrench":
        return [np.arange(3), np.arange(3, 6)]
    return [np.arange(measured.values.shape[1])]


def quantities(measured: Measured) -> list[tuple[str, np.ndarray]]:
    """Columns that share a unit, with what they are."""
    names = ("force", "torque") if measured.kind == "wrench" else ("position",)
    return list(zip(names, column_groups(measured), strict=True))


def channel_noise(rig: Rig, runs: Sequence[Run], held_out: Sequence[Run] = ()) -> dict[str, ChannelNoise]:
    """Noise of every channel that the runs have: estimated, or declared where that is much larger.

    ``held_out``: runs that are not fitted. They tell the noise only of channels that no other has.
    """
    found = channel_noise(rig, held_out) if held_out else {}
    for channel in sorted({m.channel for run in runs for m in run.measured}):
        declared = declared_noise(rig, channel)
        if declared.all() and _far_apart(rig, runs, channel):
            found[channel] = as_declared(rig, next(m for run in runs for m in run.measured if m.channel == channel))
        else:
            found[channel] = unless_larger(estimate_noise(list(runs), channel, declared), declared)
    return found


def _far_apart(rig: Rig, runs: Sequence[Run], channel: str) -> bool:
    """Whether no reading of a channel has a neighbour within ``NOISE.neighbour_intervals`` of its sampling
    intervals."""
    rate = (rig.sensors.get(channel) or rig.cameras[channel]).rate_hz
    pauses = [np.diff(m.t) for run in runs for m in run.measured if m.channel == channel]
    return all((pause > NOISE.neighbour_intervals / rate).all() for pause in pauses)


def declared_noise(rig: Rig, channel: str) -> np.ndarray:
    """Standard deviation that a rig declares for a channel in its units: six components, or one number."""
    levels = list(_declared(rig, channel).values())
    return np.repeat(levels, 3) if len(levels) == 2 else np.array(levels)


def _declared(rig: Rig, channel: str) -> dict[str, float]:
    """The same by the keys of the rig."""
    if channel in rig.cameras:
        return {"position_px": rig.cameras[channel].noise.position_px}
    sensor = rig.sensors[channel]
    if isinstance(sensor, WrenchSensor):
        return {"force_n": sensor.noise.force_n, "torque_nm": sensor.noise.torque_nm}
    assert isinstance(sensor, MarkerSensor)
    return {"position_m": sensor.noise.position_m}


def as_declared(rig: Rig, measured: Measured) -> ChannelNoise:
    """The noise that a rig declares for each column of a channel, white; 1 where it declares none, which it need not
    for components that are not measured."""
    columns = measured.values.shape[1:]
    sigma = np.broadcast_to(declared_noise(rig, measured.channel), columns)
    return ChannelNoise(np.where(sigma > 0.0, sigma, 1.0), np.zeros(columns), DECLARED)


def undeclared(rig: Rig) -> list[str]:
    """Sensors and cameras of a rig, with what they measure, for which it declares no noise."""
    return [
        f"{channel} ({quantity})"
        for channel in (*rig.sensors, *rig.cameras)
        for quantity, sigma in _declared(rig, channel).items()
        if sigma == 0.0 and _measures(rig, channel, quantity)
    ]


def _measures(rig: Rig, channel: str, quantity: str) -> bool:
    """Whether a channel measures a quantity: a gauge of forces has no torques."""
    sensor = rig.sensors.get(channel)
    if not isinstance(sensor, WrenchSensor):
        return True
    return any(component.startswith(quantity.split("_")[0]) for component in sensor.measures)


def unless_larger(noise: ChannelNoise, declared: np.ndarray) -> ChannelNoise:
    """The estimated noise, unless the declared one is much larger.

    A declared noise that is much larger than the estimate replaces it, and is white in those columns: the estimate was
    then found in a scatter (of interpolated or smoothed samples) that is not the noise.
    """
    floor = np.broadcast_to(declared, noise.sigma.shape)
    larger = floor > NOISE.declared_noise_ratio * noise.sigma
    if larger.any():
        sigma = np.maximum(noise.sigma, floor)
        rho, white = (np.where(larger, 0.0, values) for values in (noise.rho, noise.white))
        return ChannelNoise(sigma, rho, DECLARED, noise.sigma, white=white)
    return noise


def overruled(runs: Sequence[Run], noise: Mapping[str, ChannelNoise]) -> list[str]:
    """A sentence for each quantity whose declared noise took the place of the estimated one, if that tells anything."""
    said: dict[tuple[str, str], str] = {}
    for m in (m for run in runs for m in run.measured):
        found = noise[m.channel]
        if found.estimated is None or len(m.t) < NOISE.min_rest_samples:
            continue
        for unit, (quantity, group) in zip(UNITS[m.kind], quantities(m), strict=False):
            seen = group[np.isfinite(m.values[:, group]).any(axis=0)]
            declared, shown = (np.median(sigma[seen]) if len(seen) else 0.0 for sigma in (found.sigma, found.estimated))
            if declared > NOISE.declared_noise_ratio * shown > 1e-9 * declared:
                said[(m.channel, quantity)] = (
                    f"The noise of the {quantity} of {m.channel} is {declared:.3g} {unit}, as the rig declares; "
                    f"recordings show {shown:.2g} {unit}. Unless they were smoothed or interpolated, correct the rig."
                )
    return list(said.values())


def estimate_noise(runs: list[Run], channel: str, declared: np.ndarray | None = None) -> ChannelNoise:
    """Noise of one channel over all runs that have it. ``declared``: standard deviation by the rig
    (:func:`declared_noise`), without which every stretch in which no hand moves is at rest."""
    found = [(r, m) for r in runs for m in r.measured if m.channel == channel]
    columns = found[0][1].values.shape[1]
    sigma, rho, white = np.zeros((3, columns))
    given = np.broadcast_to(0.0 if declared is None else declared, columns)
    common = _common(found, float(given[0]))
    seen = [_seen(found, group, float(given[group[0]])) for group in column_groups(found[0][1])]
    mixed = [s for s in seen if s.first and not s.unlike] if common is None else []
    parts = mixtures_of([s.begun for s in mixed])
    for s in seen:
        level, colour, source = s.level()
        two = parts[mixed.index(s)] if s in mixed else None
        if two is not None:
            level, colour, white[s.group] = two
        sigma[s.group] = max(level, s.rounding, NOISE.noise_floor_share * s.extent, 1e-12)
        rho[s.group] = min(colour, NOISE.largest_correlation) if colour > NOISE.white_correlation else 0.0
    return ChannelNoise(sigma, rho, source, common=common, white=white)


@dataclass(eq=False)
class _Seen:
    """What recordings show of the noise of one quantity, the columns ``group``. ``first``: rests at the start, whose
    values and times are ``begun``; ``rest``: other ones; ``jumps``: noise by differences; ``extent``: largest range;
    ``rounding``: noise of their steps."""

    group: np.ndarray
    first: list[Stretch] = field(default_factory=list)
    rest: list[Stretch] = field(default_factory=list)
    begun: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    jumps: list[float] = field(default_factory=list)
    extent: float = 0.0
    rounding: float = 0.0

    @property
    def unlike(self) -> bool:
        """Whether something still swings or creeps in some of the rests at the start."""
        levels = [s.level for s in self.first]
        return max(levels) > NOISE.unlike_rests_ratio * min(levels)

    def level(self) -> tuple[float, float, str]:
        """Standard deviation, correlation, and how they were found."""
        if self.first:
            size = [s.size for s in self.first]
            levels, colours = [s.level for s in self.first], [s.rho for s in self.first]
            if self.unlike:
                return _quantile(levels, size, 0.25), _quantile(colours, size, 0.5), "rest at the start"
            level = float(np.sqrt(np.average(np.square(levels), weights=size)))
            return level, float(np.average(colours, weights=size)), "rest at the start"
        if self.rest:
            # Slow decay within a stretch adds to its scatter and to its colour: the quieter half is the noise.
            size = [s.size for s in self.rest]
            level = _quantile([s.level for s in self.rest], size, 0.25)
            return level, _quantile([s.rho for s in self.rest], size, 0.5), "quiet stretches"
        return (float(np.median(self.jumps)) if self.jumps else 0.0), 0.0, FROM_DIFFERENCES


def _seen(found: Sequence[tuple[Run, Measured]], group: np.ndarray, declared: float) -> _Seen:
    """What recordings show of the noise of the columns ``group``, which is ``declared`` by the rig."""
    out = _Seen(group)
    for run, measured in found:
        values = measured.values[:, group]
        values = values[:, np.isfinite(values).any(axis=0)]
        if not values.size:
            continue
        out.extent = max(out.extent, float(np.nanmax(np.nanmax(values, axis=0) - np.nanmin(values, axis=0))))
        out.jumps += by_differences(values, measured.t)
        at = in_sampling_intervals(measured.t)
        for stretch, scatter in rests(run, values, measured.t, declared):
            (out.first if stretch[0] == 0 else out.rest).append(scatter)
            if stretch[0] == 0:
                out.begun.append((without_mistakes(values[stretch], at[stretch]), measured.t[stretch]))
    out.rounding = common_step(column for _, m in found for column in m.values[:, group].T) / np.sqrt(12.0)
    return out


def _common(found: Sequence[tuple[Run, Measured]], declared: float) -> CommonMode | None:
    """What the markers of the pictures have in common while nothing moves. ``declared``: noise [px]."""
    if found[0][1].kind != "tracks":
        return None
    quiet_parts = [(m, stretch) for run, m in found for stretch, _ in rests(run, m.values, m.t, declared)]
    begun = [(m, stretch) for m, stretch in quiet_parts if stretch[0] == 0]
    return common_mode([(m.values[stretch], m.t[stretch]) for m, stretch in begun or quiet_parts])


def by_differences(values: np.ndarray, t: np.ndarray) -> list[float]:
    """Standard deviation of white noise that has the third differences of ``values`` ``(n, m)`` at the times ``t`` [s]
    ``(n,)``; empty without any. Where samples are missing between neighbours, as long as there are others, their
    differences are left out: they are motion."""
    third = np.diff(values, n=3, axis=0)
    there, gap = np.isfinite(third), np.diff(in_sampling_intervals(t)) >= NOISE.gap_interval
    whole = there & ~(gap[:-2] | gap[1:-1] | gap[2:])[:, None]
    third = third[whole if whole.any() else there]
    return [1.4826 * float(np.median(np.abs(third - np.median(third)))) / np.sqrt(20.0)] if len(third) else []


def rests(run: Run, values: np.ndarray, t: np.ndarray, declared: float) -> list[tuple[np.ndarray, Stretch]]:
    """Stretches of sample indices in which every end effector stands still and readings ``(n, m)`` of one unit at the
    times ``t`` [s] follow no trend (:func:`has_trend`), with the noise in each. ``declared``: noise of the readings."""
    at, found = in_sampling_intervals(t), []
    for stretch in quiet(run, t):
        scatter = scatter_of(values[stretch], at[stretch])
        if scatter is not None and not (
            0.0 < NOISE.trend_over_declared_noise * declared < scatter.level
            and has_trend(values[stretch], t[stretch], scatter)
        ):
            found.append((stretch, scatter))
    return found


def has_trend(values: np.ndarray, t: np.ndarray, scatter: Stretch) -> bool:
    """Whether readings ``(n, m)`` at the times ``t`` [s] are far smoother than noise of their level and colour, and
    cross a straight line seldom. Third differences of noise with variance ``sigma^2`` and correlation
    ``rho^k`` have the variance

        sigma^2 (20 - 30 rho + 12 rho^2 - 2 rho^3).

    Noise that was smoothed by a filter looks the same in a short stretch: nobody but the rig can tell.
    """
    differences = by_differences(values, t)
    repeated = np.diff(values, axis=0) == 0.0
    if not differences or repeated.mean() > NOISE.held_reading_share:
        return False
    rho = max(scatter.rho, 0.0)
    expected = scatter.level * np.sqrt(1.0 - 1.5 * rho + 0.6 * rho**2 - 0.1 * rho**3)
    if differences[0] >= NOISE.smooth_rest_share * expected:
        return False
    residual = line_residual(values, in_sampling_intervals(t))
    crossings, weight = np.sum(residual[1:] * residual[:-1] < 0.0, axis=0), np.sum(residual**2, axis=0)
    return float(crossings @ weight) <= NOISE.trend_crossings * float(weight.sum())


def _quantile(values: list[float], weights: list[int], share: float) -> float:
    """Value below which this share of the weight is, on a straight line between the middles of the weights."""
    order = np.argsort(values, kind="stable")
    weight = np.asarray(weights, dtype=float)[order]
    middle = (np.cumsum(weight) - 0.5 * weight) / weight.sum()
    return float(np.interp(share, middle, np.asarray(values)[order]))
