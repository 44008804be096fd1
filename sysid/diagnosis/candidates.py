"""The effects of the library as columns that can be fitted linearly: which sizes and which shapes to look at.

Parameters of an effect are of two kinds. Amplitudes have a value at which the effect vanishes; the others (time
constants, ranges) are its shape. Each point of a grid over the shapes is a :class:`Hypothesis`, with one column an
amplitude: what the readings change when that amplitude alone goes from nothing to a typical size. An amplitude that
vanishes at infinity (a yield curvature) is no factor, so each typical value of it is a point of the grid as well.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_core.effects import Effect, RecordingScales, all_effects, split_key
from sim_core.effects.base import EffectParameter
from sim_core.rigs import Rig
from sysid.observations.observations import Run
from sysid.settings.diagnosis import DIAGNOSIS


@dataclass(frozen=True)
class Amplitude:
    """One column. ``none``: where the effect vanishes; ``typical``: the value of the response."""

    parameter: EffectParameter
    none: float
    typical: float

    @property
    def limits(self) -> tuple[float, float]:
        """Bounds of the factor on the response, 1 at the typical value."""
        if not np.isfinite(self.none):
            return 0.0, 1.5
        ends = sorted(
            (e - self.none) / (self.typical - self.none) for e in (self.parameter.lower, self.parameter.upper)
        )
        low = (
            0.0
            if ends[0] > -1e-9 or (self.parameter.log and ends[0] >= -1e-3)
            else max(ends[0], -DIAGNOSIS.largest_amplitude)
        )
        return low, min(max(ends[1], 1.0), DIAGNOSIS.largest_amplitude)

    @property
    def sd(self) -> float:
        """Standard deviation of the prior of the factor."""
        if not np.isfinite(self.none):
            return 1.0
        if self.parameter.log:
            return 2.0
        return self.parameter.prior_sd / abs(self.typical - self.none)

    def value(self, factor: float) -> float:
        """The value of the parameter at a factor, off the vanishing value and within its bounds."""
        p = self.parameter
        if not np.isfinite(self.none):
            return self.typical
        found = self.none + factor * (self.typical - self.none)
        least = 0.02 * abs(self.typical - self.none)
        if p.log or (self.limits[0] >= 0.0 and abs(found - self.none) < least):
            found = max(found, self.none + least) if self.typical > self.none else min(found, self.none - least)
        return float(min(max(found, p.lower), p.upper))


@dataclass(frozen=True)
class Hypothesis:
    """One effect with one shape. ``key``: as a rig names it; ``drawn``: the shape is one that no diagnosis looks at, in
    which a benchmark may conceal the effect."""

    key: str
    effect: Effect
    shape: Mapping[str, float]
    amplitudes: tuple[Amplitude, ...]
    drawn: bool = False

    def columns(self) -> list[dict[str, dict[str, float]]]:
        """The effect with each amplitude alone at its typical size."""
        out = []
        for amplitude in self.amplitudes:
            values = dict(self.shape)
            for other in self.amplitudes:
                if np.isfinite(other.none):
                    values[other.parameter.name] = other.none
            values[amplitude.parameter.name] = amplitude.typical
            out.append({self.key: {p.name: values[p.name] for p in self.effect.parameters if p.name in values}})
        return out

    def values(self, factors: Sequence[float]) -> dict[str, float]:
        """All parameters with the amplitudes at factors of their typical sizes."""
        found = dict(self.shape)
        for amplitude, factor in zip(self.amplitudes, factors, strict=True):
            found[amplitude.parameter.name] = amplitude.value(float(factor))
        return {p.name: found[p.name] for p in self.effect.parameters if p.name in found}


def hypotheses(rig: Rig, scales: RecordingScales) -> list[Hypothesis]:
    """All effects that the rig may lack, in all the shapes that are looked at."""
    present = {split_key(key)[0] for key in rig.effects}
    found: list[Hypothesis] = []
    for effect in all_effects().values():
        if effect.name in present:
            continue
        fitted = {p.name: p.fitted_to(scales) for p in effect.parameters}
        for variant in effect.variants(rig, scales):
            found += _of_variant(effect, fitted, variant)
    return found


def drawn_shapes(rig: Rig, scales: RecordingScales, rng: np.random.Generator) -> list[Hypothesis]:
    """Each effect of the library that has a shape, in one that is drawn: uniform in the fitted scale between the ends
    of the grid that is looked at, and where that has one value, within the prior of it."""
    looked = hypotheses(rig, scales)
    found = []
    for effect in dict.fromkeys(h.effect for h in looked):
        mine = [h for h in looked if h.effect is effect]
        fitted = {p.name: p.fitted_to(scales) for p in effect.parameters}
        shape = {n: _drawn(fitted[n], [h.shape[n] for h in mine if n in h.shape], rng) for n in mine[0].shape}
        thresholds = len({a.typical for h in mine for a in h.amplitudes if not np.isfinite(a.none)}) > 1
        amplitudes = tuple(
            a if np.isfinite(a.none) else replace(a, typical=_drawn(a.parameter, [_size_of(h, a) for h in mine], rng))
            for a in mine[0].amplitudes
        )
        if shape or thresholds:
            found.append(Hypothesis(effect.name, effect, shape, amplitudes, drawn=True))
    return found


def _size_of(hypothesis: Hypothesis, like: Amplitude) -> float:
    return next(a.typical for a in hypothesis.amplitudes if a.parameter.name == like.parameter.name)


def _drawn(parameter: EffectParameter, looked: Sequence[float], rng: np.random.Generator) -> float:
    ends = np.array([min(looked), max(looked)])
    if parameter.log:
        ends = np.log(ends)
    if ends[0] == ends[1]:
        ends = ends + parameter.prior_sd * np.array([-1.0, 1.0])
    value = rng.uniform(*ends)
    return float(np.clip(np.exp(value) if parameter.log else value, parameter.lower, parameter.upper))


def _of_variant(
    effect: Effect, parameters: Mapping[str, EffectParameter], variant: Mapping[str, tuple[float, ...]]
) -> list[Hypothesis]:
    sizes = [n for n in variant if parameters[n].vanishing is not None]
    shapes = [n for n in variant if n not in sizes]
    grid = {n: variant[n] for n in shapes} | {n: variant[n] for n in sizes if not np.isfinite(_none(parameters[n]))}
    if len(sizes) == 1 and np.isfinite(_none(parameters[sizes[0]])):
        grid[sizes[0]] = tuple(spaced(variant[sizes[0]], DIAGNOSIS.amplitude_sizes))
    threshold = any(not np.isfinite(_none(parameters[n])) for n in sizes)
    points = spaced(
        list(itertools.product(*grid.values())), DIAGNOSIS.threshold_grid_points if threshold else DIAGNOSIS.grid_points
    )
    found = []
    for point in points:
        chosen = dict(zip(grid, point, strict=True))
        starts = {n: chosen.get(n, variant[n][0]) for n in sizes}
        if all(starts[n] == _none(parameters[n]) for n in sizes):
            # Searches begin at nothing; what is looked at is as large as the prior lets expect.
            starts = {n: min(_none(p) + p.prior_sd, p.upper) for n in sizes for p in (parameters[n],)}
        amplitudes = tuple(
            Amplitude(parameters[n], _none(parameters[n]), starts[n])
            for n in sizes
            if starts[n] != _none(parameters[n])
        )
        if amplitudes:
            found.append(Hypothesis(effect.name, effect, {n: chosen[n] for n in shapes}, amplitudes))
    return found


def _none(parameter: EffectParameter) -> float:
    assert parameter.vanishing is not None
    return parameter.vanishing


def spaced(items: Sequence, most: int) -> list:  # type: ignore[type-arg]
    """At most so many of the items, evenly spaced, the first and the last among them."""
    if len(items) <= most:
        return list(items)
    return [items[k] for k in np.unique(np.linspace(0, len(items) - 1, most).round().astype(int))]


def recording_scales(runs: Sequence[Run]) -> RecordingScales:
    """Scales of recordings, to which starting values and priors are fitted."""
    intervals = [float(np.median(np.diff(m.t))) for run in runs for m in run.measured if len(m.t) > 1]
    wrenches = [m.values for run in runs for m in run.measured if m.kind == "wrench"]
    speeds = [
        float(np.max(np.linalg.norm(np.diff(p.positions, axis=0), axis=1) / np.diff(p.times), initial=0.0))
        for run in runs
        for p in run.poses.values()
        if len(p.times) > 1
    ]

    def largest(part: slice) -> float:
        return max((float(np.nanmax(np.abs(np.nan_to_num(w[:, part])), initial=0.0)) for w in wrenches), default=0.0)

    return RecordingScales(
        max((run.end for run in runs), default=0.0),
        max(intervals, default=0.0),
        largest(slice(0, 3)),
        largest(slice(3, 6)),
        max(speeds, default=0.0),
    )
