"""Steps of the solver where the readings change: short ones in fast motion, the rig's own elsewhere.

Readings between two steps are interpolated linearly. Where nothing has inertia, the error of that is most of the error
of the time step, and it is local: it shows in one more step halfway,

    e = y(t_1/2) - (y(t_0) + y(t_1)) / 2.

Steps are halved where e is above a share of the noise, and their halves again, until none is or the shortest is
reached. With inertia an error made in one place goes on in others, and near a resonance it grows: BDF2 makes a
vibration of frequency omega slower by (omega h)^2 / 3 of it. All steps of a recording are then halved where that
changes its readings by more than noise for more than a quarter of the time; what is left is measured by halving them
once more, and taken into account (Richardson's extrapolation).

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
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import quantities
from sysid.observations.observations import Run
from sysid.settings.discretisation import DISCRETISATION


def with_steps(
    engine: AnyEngine, rigs: Sequence[Rig], runs: Sequence[Run], noise: dict[str, ChannelNoise]
) -> list[Run]:
    """The runs with steps of the solver that follow their readings, simulated by the rig of each. A run that cannot be
    simulated with shorter steps keeps those that it has."""
    if rigs[0].solver.inertia:
        return shorter_throughout(engine, rigs, runs, noise)[0]
    steps = [step_times(0.0, run.end, rig.solver.dt_s) for rig, run in zip(rigs, runs, strict=True)]
    live = list(range(len(rigs)))
    asked = {k: np.ones(len(steps[k]) - 1, dtype=bool) for k in live}
    for _ in range(DISCRETISATION.step_halvings):
        halved = {k: _halved(steps[k], at) for k, at in asked.items() if at.any()}
        jobs = {k: engine.submit(rigs[k], replace(runs[k], steps=h)) for k, h in halved.items()}
        asked = {}
        for k, job in jobs.items():
            try:
                trace = job.result().trace
            except ThinshellError:
                continue
            steps[k], asked[k] = _kept(trace, steps[k], halved[k], runs[k], noise)
    return [replace(run, steps=steps[k]) for k, run in enumerate(runs)]


def shorter_throughout(
    engine: AnyEngine, rigs: Sequence[Rig], runs: Sequence[Run], noise: dict[str, ChannelNoise]
) -> tuple[list[Run], list[Prediction]]:
    """The runs, with all steps halved where that changes their readings, and their predictions."""
    shorter = [replace(run, steps=_all_halved(rig, run)) for rig, run in zip(rigs, runs, strict=True)]
    given = [engine.submit(rig, run) for rig, run in zip(rigs, runs, strict=True)]
    jobs = [engine.submit(rig, run) for rig, run in zip(rigs, shorter, strict=True)]
    found, predictions = list(runs), []
    for k, run in enumerate(runs):
        there = given[k].result()
        try:
            halved = jobs[k].result()
            if _changes(run, there, halved, noise) > DISCRETISATION.halving_over_noise:
                found[k], there = shorter[k], halved
        except ThinshellError:
            pass
        predictions.append(there)
    return found, predictions


def _all_halved(rig: Rig, run: Run) -> np.ndarray:
    steps = step_times(0.0, run.end, rig.solver.dt_s) if run.steps is None else run.steps
    return _halved(steps, np.ones(len(steps) - 1, dtype=bool))


def _changes(run: Run, one: Prediction, other: Prediction, noise: dict[str, ChannelNoise]) -> float:
    """Change of the readings over the noise, of the quantity that changes most. Vibrations are recognised by how
    markers move against each other: what all of a picture have in common by a shaking camera hides them no more than
    one."""
    most = 0.0
    for m in run.measured:
        sigma = noise[m.channel].own.sigma
        for _, group in quantities(m):
            change = (other.values[m.channel] - one.values[m.channel])[:, group] / sigma[group]
            squares = np.where(np.isfinite(change) & np.isfinite(m.values[:, group]), change**2, np.nan)
            squares = squares[np.isfinite(squares).any(axis=1)]
            if len(squares):
                most = max(
                    most, float(np.quantile(np.sqrt(np.nanmean(squares, axis=1)), DISCRETISATION.halving_quantile))
                )
    return most


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


def predicted_with_steps(
    engine: AnyEngine, rigs: Sequence[Rig], runs: Sequence[Run], noise: dict[str, ChannelNoise]
) -> tuple[list[Run], list[Prediction]]:
    """The runs with steps of the solver that follow their readings, and their predictions, by the rig of each."""
    pending = [engine.submit(rig, run) for rig, run in zip(rigs, runs, strict=True)]
    shorter = with_steps(engine, rigs, runs, noise)
    again = [
        job if run is given else engine.submit(rig, run)
        for rig, run, given, job in zip(rigs, shorter, runs, pending, strict=True)
    ]
    plain, there = ([job.result() for job in jobs] for jobs in (pending, again))
    return followed(runs, plain, shorter, there, noise)


def _share(run: Run, plain: Prediction, there: Prediction, noise: dict[str, ChannelNoise]) -> float:
    """How far readings have gone from one prediction to the other; 1 where both are alike within the noise."""
    along = across = 0.0
    for m in run.measured:
        sigma = noise[m.channel].sigma
        change = np.nan_to_num((there.values[m.channel] - plain.values[m.channel]) / sigma)
        left = np.nan_to_num((m.values - plain.values[m.channel]) / sigma)
        far = np.abs(change) > DISCRETISATION.interpolation_over_noise
        along += float(
            np.sum(
                (change * np.clip(left, -DISCRETISATION.largest_misfit_ratio, DISCRETISATION.largest_misfit_ratio))[far]
            )
        )
        across += float(
            np.sum(
                (change * np.clip(change, -DISCRETISATION.largest_misfit_ratio, DISCRETISATION.largest_misfit_ratio))[
                    far
                ]
            )
        )
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
            needed |= rms > DISCRETISATION.interpolation_over_noise * sigma
    new = halved[middle[needed]]
    found = np.sort(np.concatenate([steps, new]))
    return found, np.isin(found[:-1], new) | np.isin(found[1:], new)
