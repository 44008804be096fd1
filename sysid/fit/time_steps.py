"""Steps of the solver where the readings change: short ones in fast motion, the rig's own elsewhere.

Readings between two steps are interpolated linearly. Where nothing has inertia, the error of that is most of the error
of the time step, and it is local: it is told by one more step halfway,

    e = y(t_1/2) - (y(t_0) + y(t_1)) / 2.

Steps are halved where e is above a share of the noise, and their halves again, until none is or the shortest is
reached. With inertia an error made in one place goes on in others; steps are then left as they are, and the error that
is measured by halving all of them is taken into account.

A recording may itself be a simulation with the steps of the rig. It then follows the readings r with these steps, not
those d further on that shorter ones give: they are kept where d . (m - r) / d . d is below a half for the readings m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sim_core.simulate import Trace, step_times
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.noise.estimate import ChannelNoise, quantities
from sysid.observations.observations import Run

OF_NOISE = 1.0 / 3.0
"""Error of the interpolation over the noise, rms over the columns of a quantity, from which a step is halved."""

ROUNDS = 4
"""Times that steps are halved: to a sixteenth of the rig's."""

FAR = 30.0
"""Misfit over noise from which it counts no more: a few readings do not decide."""


def with_steps(
    engine: AnyEngine, rigs: Sequence[Rig], runs: Sequence[Run], noise: dict[str, ChannelNoise]
) -> list[Run]:
    """The runs with steps of the solver that follow their readings, simulated by the rig of each. A run that cannot be
    simulated with shorter steps keeps those that it has."""
    steps = [step_times(0.0, run.end, rig.solver.dt_s) for rig, run in zip(rigs, runs, strict=True)]
    live = [k for k, rig in enumerate(rigs) if not rig.solver.inertia]
    asked = {k: np.ones(len(steps[k]) - 1, dtype=bool) for k in live}
    for _ in range(ROUNDS):
        halved = {k: _halved(steps[k], at) for k, at in asked.items() if at.any()}
        jobs = {k: engine.submit(rigs[k], replace(runs[k], steps=h)) for k, h in halved.items()}
        asked = {}
        for k, job in jobs.items():
            try:
                trace = job.result().trace
            except ThinshellError:
                continue
            steps[k], asked[k] = _kept(trace, steps[k], halved[k], runs[k], noise)
    return [replace(run, steps=steps[k]) if k in live else run for k, run in enumerate(runs)]


def followed(
    runs: Sequence[Run],
    plain: Sequence[Prediction],
    shorter: Sequence[Run],
    there: Sequence[Prediction],
    noise: dict[str, ChannelNoise],
) -> tuple[list[Run], list[Prediction]]:
    """Of each run with the steps that it has and with ``shorter`` ones, that which its readings follow, and its
    prediction. ``plain``, ``there``: of both."""
    found = [
        (b, q) if _share(a, p, q, noise) >= 0.5 else (a, p)
        for a, p, b, q in zip(runs, plain, shorter, there, strict=True)
    ]
    return [run for run, _ in found], [prediction for _, prediction in found]


def _share(run: Run, plain: Prediction, there: Prediction, noise: dict[str, ChannelNoise]) -> float:
    """How far readings have gone from one prediction to the other; 1 where both are alike within the noise."""
    along = across = 0.0
    for m in run.measured:
        sigma = noise[m.channel].sigma
        change = np.nan_to_num((there.values[m.channel] - plain.values[m.channel]) / sigma)
        left = np.nan_to_num((m.values - plain.values[m.channel]) / sigma)
        far = np.abs(change) > OF_NOISE
        along += float(np.sum((change * np.clip(left, -FAR, FAR))[far]))
        across += float(np.sum((change * np.clip(change, -FAR, FAR))[far]))
    return along / across if across > 0.0 else 1.0


def _halved(steps: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Steps ``(n + 1,)`` with the middles of those of the intervals ``at`` ``(n,)``."""
    return np.sort(np.concatenate([steps, 0.5 * (steps[:-1] + steps[1:])[at]]))


def _kept(
    trace: Trace, steps: np.ndarray, halved: np.ndarray, run: Run, noise: dict[str, ChannelNoise]
) -> tuple[np.ndarray, np.ndarray]:
    """The steps with those of the middles that are needed, and which of their intervals came from one."""
    middle = np.flatnonzero(~np.isin(halved, steps))
    needed = np.zeros(len(middle), dtype=bool)
    for m in run.measured:
        values = trace.outputs[m.channel][: len(halved)].reshape(len(halved), -1)
        error = np.abs(values[middle] - 0.5 * (values[middle - 1] + values[middle + 1]))
        for _, group in quantities(m):
            sigma = float(np.median(noise[m.channel].sigma[group]))
            columns = group if m.kind == "wrench" else slice(None)
            rms = np.sqrt(np.mean(np.nan_to_num(error[:, columns]) ** 2, axis=1))
            needed |= rms > OF_NOISE * sigma
    new = halved[middle[needed]]
    found = np.sort(np.concatenate([steps, new]))
    return found, np.isin(found[:-1], new) | np.isin(found[1:], new)
