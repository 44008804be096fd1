"""Where and when a model misses the recordings: which channel, which windows, which phase of the motion.

Structured misfit: the whitened residuals of each column are summed over blocks of time. For a model that
is right these sums, over the root of their length, are independent standard normal numbers; what a
missing law leaves behind is smooth in time and adds up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_core.rigs.trajectory import PoseTrajectory
from sysid.diagnosis.result import Located, LocatedChannel
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import quantities
from sysid.noise.stillness import moving
from sysid.observations.observations import Measured, Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


@dataclass(frozen=True)
class Part:
    """Structured misfit of one quantity of one channel in one run. ``excess``: sum of squared block scores
    less their number; ``count``: number of scores; ``own``: the same sum for the discretisation error; ``size``: mean
    over a block of time, rms over the columns, in units of what a single reading may be off by noise, mesh, time step,
    and as careful models are; of the largest block, or where less, of the second largest of the quantity in all
    runs."""

    excess: float
    count: int
    own: float
    size: float = np.inf
    run: str = ""
    channel: str = ""
    quantity: str = ""

    @property
    def per_score(self) -> float:
        """Mean squared score (1 = noise)."""
        return 1.0 + self.excess / max(self.count, 1)

    @property
    def significant(self) -> bool:
        """More than noise leaves: squared scores have mean 1 and standard deviation sqrt(2)."""
        return self.per_score > DIAGNOSIS.misfit_per_score and self.excess > DIAGNOSIS.misfit_sd * np.sqrt(
            2.0 * self.count
        )

    @property
    def stands_out(self) -> bool:
        """Significant, and large enough to be seen."""
        return self.significant and self.size > DIAGNOSIS.least_size

    @property
    def beyond_discretisation(self) -> bool:
        """More than noise and the discretisation error leave."""
        return self.stands_out and self.excess > DIAGNOSIS.discretisation_share * self.own


@dataclass(frozen=True)
class Structure:
    """Structured misfit by quantity (see :class:`Part`), so that a loud one is not drowned by quiet ones."""

    parts: tuple[Part, ...]

    @property
    def whole(self) -> Part:
        return _together(self.parts)

    @property
    def missing(self) -> bool:
        """Something is missing: some quantity, or all that are large enough to be seen, are beyond noise and the
        discretisation error."""
        seen = [p for p in self.parts if p.size > DIAGNOSIS.least_size]
        return any(p.beyond_discretisation for p in (*seen, _together(seen)))


def _together(parts: Sequence[Part]) -> Part:
    size = max((p.size for p in parts), default=0.0)
    return Part(sum(p.excess for p in parts), sum(p.count for p in parts), sum(p.own for p in parts), size)


def block_scores(run: Run, measured: Measured, white: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scores ``(blocks, columns)``, NaN where a block is empty, and the edges of the blocks [s]."""
    edges = np.linspace(0.0, run.end + 1e-9, DIAGNOSIS.time_blocks + 1)
    block = np.clip(np.searchsorted(edges, measured.t, side="right") - 1, 0, DIAGNOSIS.time_blocks - 1)
    total = np.zeros((DIAGNOSIS.time_blocks, white.shape[1]))
    count = np.zeros_like(total)
    good = np.isfinite(white)
    np.add.at(total, block, np.where(good, white, 0.0))
    np.add.at(count, block, good.astype(float))
    with np.errstate(invalid="ignore"):
        return np.where(count > 0, total / np.sqrt(np.maximum(count, 1.0)), np.nan), edges


def whitened(problem: Problem, fitted: Fitted, run: int, measured: Measured) -> np.ndarray:
    """Whitened residual of one channel ``(n, m)``, as much of the discretisation error as is believed taken out; NaN
    where that changes unforeseen."""
    miss = measured.values - problem.explained(fitted, run, measured)
    return problem.judged(run, measured, miss)


def structure(problem: Problem, fitted: Fitted) -> Structure:
    """Structured misfit of a model.

    The discretisation error enters with the sizes expected from refinement, not the fitted ones, which may
    have taken up missing physics.
    """
    parts: list[Part] = []
    blocks: dict[tuple[str, str], list[float]] = {}
    for i, run in enumerate(problem.runs):
        for m in run.measured:
            scored = whitened(problem, fitted, i, m)
            scores, _ = block_scores(run, m, scored)
            # What is not measured has no noise to compare with.
            shift = np.where(np.isfinite(m.values), problem.basis(i, m).expected, np.nan)
            own, _ = block_scores(run, m, problem.judged(i, m, shift))
            miss = np.where(np.isfinite(scored), m.values - problem.explained(fitted, i, m), np.nan)
            squares = _squared_means(run, m, miss, off_by(problem, i, m), problem.noise[m.channel])
            for name, group in quantities(m):
                good = np.isfinite(scores[:, group])
                excess = float(np.sum(scores[:, group][good] ** 2 - 1.0))
                sizes = _rms(squares[:, group])
                blocks.setdefault((m.channel, name), []).extend(sizes)
                from_own = float(np.nansum(own[:, group] ** 2))
                largest = max(sizes, default=0.0)
                parts.append(Part(excess, int(good.sum()), from_own, largest, run.name, m.channel, name))
    second = {key: _second_largest(sizes) for key, sizes in blocks.items()}
    return Structure(tuple(replace(p, size=min(p.size, second[(p.channel, p.quantity)])) for p in parts))


def off_by(problem: Problem, index: int, measured: Measured) -> np.ndarray:
    """What single readings may be off by noise, mesh, time step, and as careful models are, measured units ``(n,
    m)``."""
    own = [shape.shapes[index][measured.channel] for shape in problem.error_shapes]
    return np.asarray(np.sqrt(problem.noise[measured.channel].sigma ** 2 + np.sum(np.square(own), axis=0)))


def _block_means(run: Run, measured: Measured, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of values ``(n, m)`` over each block of time ``(b, m)``, NaN where there is none, and their number."""
    scores, _ = block_scores(run, measured, values)
    root, _ = block_scores(run, measured, np.where(np.isfinite(values), 1.0, np.nan))
    return np.asarray(scores / root), np.asarray(root**2)


def _squared_means(run: Run, measured: Measured, miss: np.ndarray, off: np.ndarray, noise: ChannelNoise) -> np.ndarray:
    """Square of the mean of what is missed ``(n, m)`` over what it may be off, by blocks of time ``(b, m)``, less what
    noise makes of it."""
    mean, number = _block_means(run, measured, miss / off)
    share, _ = _block_means(run, measured, np.where(np.isfinite(miss), (noise.sigma / off) ** 2, np.nan))
    return np.asarray(mean**2 - share * np.minimum(noise.long_run / number, 1.0))


def _rms(squares: np.ndarray) -> list[float]:
    """Root of the mean of squares over the columns of those rows ``(n, m)`` that have any, 0 where it is negative."""
    return [float(np.sqrt(max(np.nanmean(row), 0.0))) for row in squares if np.isfinite(row).any()]


def _second_largest(sizes: Sequence[float]) -> float:
    return sorted(sizes)[-2] if len(sizes) > 1 else 0.0


def locate(problem: Problem, fitted: Fitted, answer: Fitted | None = None) -> Located:
    """Channels, time windows and phase of what the model misses; of what an ``answer`` adds to its predictions, where
    there is one: the discretisation error may have taken part of that up."""
    shares: list[tuple[str, str, float]] = []
    windows: dict[str, tuple[tuple[float, float], ...]] = {}
    phases = {k: 0.0 for k in ("moving in contact", "holding in contact", "moving freely", "at rest without contact")}
    for i, run in enumerate(problem.runs):
        energy = np.zeros(DIAGNOSIS.time_blocks)
        columns = np.zeros(DIAGNOSIS.time_blocks)
        for m in run.measured:
            if answer is None:
                white, chance = whitened(problem, fitted, i, m), 1.0
            else:
                added = answer.predictions[i].values[m.channel] - fitted.predictions[i].values[m.channel]
                white, chance = problem.whiten(i, m, np.where(np.isfinite(m.values), added, np.nan)), 0.0
            scores, edges = block_scores(run, m, white)
            for name, group in quantities(m):
                part = scores[:, group]
                shares.append((m.channel, name, float(np.nansum(part**2 - chance))))
            energy += np.nansum(np.where(np.isfinite(scores), scores**2 - chance, 0.0), axis=1)
            columns += np.isfinite(scores).sum(axis=1)
        hot = energy > DIAGNOSIS.window_sd * np.sqrt(2.0 * np.maximum(columns, 1.0))
        strong = hot & (energy > DIAGNOSIS.window_energy_share * max(float(energy.max(initial=0.0)), 1e-30))
        windows[run.name] = _intervals(strong, edges)
        for b in np.flatnonzero(strong):
            phases[_phase(run, fitted, i, edges[b], edges[b + 1])] += float(energy[b])
    totals: dict[tuple[str, str], float] = {}
    for channel, name, share in shares:
        totals[(channel, name)] = totals.get((channel, name), 0.0) + max(share, 0.0)
    whole = sum(totals.values()) or 1.0
    channels = sorted((LocatedChannel(c, q, e / whole) for (c, q), e in totals.items()), key=lambda c: -c.share)
    phase = max(phases, key=lambda k: phases[k]) if any(phases.values()) else "nowhere in particular"
    return Located(tuple(channels), windows, phase)


def _intervals(hot: np.ndarray, edges: np.ndarray) -> tuple[tuple[float, float], ...]:
    change = np.flatnonzero(np.diff(np.concatenate([[0], hot.astype(int), [0]])))
    return tuple((float(edges[a]), float(edges[b])) for a, b in zip(change[::2], change[1::2], strict=True))


def _phase(run: Run, fitted: Fitted, index: int, start: float, end: float) -> str:
    """What was going on in a window: the motion from the poses, contact from the simulation."""
    trace = fitted.predictions[index].trace
    inside = (trace.times[1:] > start) & (trace.times[1:] <= end)
    touching = any(r.contacts > 0 for r, k in zip(trace.reports, inside, strict=True) if k)
    busy = any(_moves(trajectory, start, end) for trajectory in run.poses.values())
    if touching:
        return "moving in contact" if busy else "holding in contact"
    return "moving freely" if busy else "at rest without contact"


def _moves(trajectory: PoseTrajectory, start: float, end: float) -> bool:
    """Whether an end effector moves or turns for at least half of a window."""
    if len(trajectory.times) < 2:
        return False
    instants = (
        np.linspace(start, end, DIAGNOSIS.window_parts, endpoint=False) + 0.5 * (end - start) / DIAGNOSIS.window_parts
    )
    spans = np.array(moving(trajectory)).reshape(-1, 2)
    inside = (instants[:, None] >= spans[:, 0]) & (instants[:, None] <= spans[:, 1])
    return bool(np.mean(inside.any(axis=1)) >= 0.5)
