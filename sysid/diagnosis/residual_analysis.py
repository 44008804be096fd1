"""Where and when a model misses the recordings: which channel, which windows, which phase of the motion.

Structured misfit: the whitened residuals of each column are summed over blocks of time. For a model that
is right these sums, over the root of their length, are independent standard normal numbers; what a
missing law leaves behind is smooth in time and adds up.
"""

from __future__ import annotations

import numpy as np

from sim_core.rigs.trajectory import PoseTrajectory
from sysid.diagnosis.result import Located, LocatedChannel
from sysid.noise.estimate import quantities
from sysid.noise.stillness import moving
from sysid.observations.observations import Measured, Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


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
    """Whitened residual of one channel ``(n, m)``, with named errors of their most probable sizes taken out."""
    miss = measured.values - problem.explained(fitted, run, measured)
    return problem.judged(run, measured, miss)


def excess(problem: Problem, fitted: Fitted, index: int) -> float:
    """Sum of the squared scores of recording number ``index`` less their number: about 0 for a model that is right."""
    run = problem.runs[index]
    scores = [block_scores(run, m, whitened(problem, fitted, index, m))[0] for m in run.measured]
    return float(sum(np.nansum(np.where(np.isfinite(s), s**2 - 1.0, 0.0)) for s in scores))


def off_by(problem: Problem, index: int, measured: Measured) -> np.ndarray:
    """What single readings may be off by noise, mesh and time step, measured units ``(n, m)``."""
    own = [shape.shapes[index][measured.channel] for shape in problem.refined]
    return np.asarray(np.sqrt(problem.noise[measured.channel].sigma ** 2 + np.sum(np.square(own), axis=0)))


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
