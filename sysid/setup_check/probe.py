"""The part of a recording that is compared with its rig: a few instants until the first large change of each channel,
and the rollouts that tell what the rig predicts there."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim_core.errors import ConvergenceError, ThinshellError
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import Scene, build_scene
from sim_core.simulate import simulate
from sysid.model.marker_registration import placed
from sysid.model.nuisance_parameters import bias_sd
from sysid.model.sensor_streams import predicted
from sysid.model.time_span import rollout_times
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import quantities
from sysid.observations.observations import Measured, Run
from sysid.progress.rollout_costs import Kind, OnStep, RolloutCosts
from sysid.settings.model import MODEL
from sysid.settings.setup_check import SETUP_CHECK
from sysid.setup_check.evidence import Quantity

Poses = Mapping[str, PoseTrajectory]


@dataclass(frozen=True)
class Probe:
    """A run cut to its first readings, the step of its rollouts [s], and what is compared of each channel. ``bins``:
    the instant that each reading of a channel counts to ``(n,)``, from 0 on."""

    run: Run
    dt: float
    channels: Mapping[str, list[Quantity]]
    bins: Mapping[str, np.ndarray]


def probe_of(rig: Rig, run: Run, noise: Mapping[str, ChannelNoise]) -> Probe:
    """The instants until every channel has reached most of its change."""
    reached = [t for t in (_reached(m, noise[m.channel]) for m in run.measured) if t is not None]
    end = max(reached, default=run.end)
    end = min(run.end, max(end, 2.0 * rig.solver.dt_s))
    measured, bins = [], {}
    for m in run.measured:
        rows, instants = _rows(m.t, end)
        values = _median_of_three(m.values, rows)
        if len(np.unique(instants)) >= SETUP_CHECK.fewest_frames and np.isfinite(values).any():
            measured.append(replace(m, t=m.t[rows], values=values))
            bins[m.channel] = instants
    cut = replace(run, measured=tuple(measured), end=float(max((m.t[-1] for m in measured), default=end)), steps=None)
    dt = max(rig.solver.dt_s, cut.end / SETUP_CHECK.most_steps)
    found = {m.channel: _quantities(m, bins[m.channel], noise[m.channel]) for m in measured}
    return Probe(cut, dt, {channel: quantities for channel, quantities in found.items() if quantities}, bins)


def _rows(t: np.ndarray, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Readings until ``end`` [s], a few for each instant, and the instants, counted from 0."""
    inside = np.flatnonzero(t <= end + 1e-9)
    bins = np.minimum((t[inside] / max(end, 1e-9) * SETUP_CHECK.frames).astype(int), SETUP_CHECK.frames - 1)
    rows = []
    for instant in np.unique(bins):
        own = inside[bins == instant]
        rows.append(own[np.unique(np.linspace(0, len(own) - 1, min(len(own), SETUP_CHECK.per_frame)).astype(int))])
    counts = [len(own) for own in rows]
    return np.concatenate([*rows, np.zeros(0, dtype=int)]), np.repeat(np.arange(len(rows)), counts)


def averaged(values: np.ndarray, bins: np.ndarray) -> np.ndarray:
    """Means ``(k, m)`` of the readings ``(n, m)`` of each instant, NaN where there is none."""
    seen = np.isfinite(values)
    share = (bins == np.arange(bins.max() + 1)[:, None]).astype(float)
    count = share @ seen
    return np.where(count > 0, share @ np.where(seen, values, 0.0) / np.maximum(count, 1.0), np.nan)


def _reached(measured: Measured, noise: ChannelNoise) -> float | None:
    """When a channel first reaches most of its change; None where it changes by no more than its noise."""
    values = measured.values
    columns = np.isfinite(values).any(axis=0)
    values, sigma = values[:, columns], noise.sigma[columns]
    first = np.nanmedian(values[: max(1, min(5, len(values)))], axis=0)
    square = ((values - np.nan_to_num(first)) / sigma) ** 2
    seen = np.isfinite(square)
    change = np.where(seen, square, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    chance = 2.0 * (1.0 + SETUP_CHECK.chance_sd * np.sqrt(2.0 / max(len(sigma), 1)))
    if change.max(initial=0.0) < chance:
        return None
    return float(measured.t[np.argmax(change >= SETUP_CHECK.signal_share**2 * change.max())])


def _median_of_three(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Readings ``(n, m)`` at some rows, each the median of it and its neighbours: single mistakes do not count."""
    about = np.clip(rows[:, None] + np.arange(-1, 2), 0, len(values) - 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of no reading at all
        return np.asarray(np.nanmedian(values[about], axis=1))


def _quantities(measured: Measured, bins: np.ndarray, noise: ChannelNoise) -> list[Quantity]:
    """What is compared of a channel, by unit."""
    found = []
    everything = averaged(measured.values, bins)
    alone = np.bincount(bins).min() / noise.long_run
    for name, group in quantities(measured):
        columns = group[np.isfinite(everything[:, group]).sum(axis=0) >= SETUP_CHECK.fewest_frames]
        if measured.kind != "wrench":
            columns = _some_markers(columns, 3 if measured.kind == "markers" else 2)
        if not len(columns):
            continue
        values = everything[:, columns]
        if measured.kind == "wrench":
            bias = bias_sd(measured)
            assert bias is not None
            spread, log_sd, modes = float(bias[columns[0]]), MODEL.plausible_log_sd, float(len(columns))
        else:
            size = float(np.sqrt(np.nanmean((values - _centre(values, measured.kind)) ** 2)))
            spread = SETUP_CHECK.layout_error * size
            log_sd, modes = SETUP_CHECK.marker_motion_log_sd, float(SETUP_CHECK.marker_modes)
        sigma = float(np.median((noise.sigma / np.sqrt(np.maximum(alone, 1.0)))[columns]))
        places = measured.kind != "wrench"
        found.append(Quantity(measured.channel, name, columns, values, sigma, spread, log_sd, modes, places))
    return found


def _some_markers(columns: np.ndarray, axes: int) -> np.ndarray:
    """All columns of some markers, evenly."""
    markers = np.unique(columns // axes)
    whole = markers[np.isin(axes * markers, columns) & np.isin(axes * markers + axes - 1, columns)]
    chosen = whole[np.unique(np.linspace(0, len(whole) - 1, min(len(whole), SETUP_CHECK.most_markers)).astype(int))]
    return (axes * chosen[:, None] + np.arange(axes)).ravel() if len(whole) else np.zeros(0, dtype=int)


def _centre(values: np.ndarray, kind: str) -> np.ndarray:
    axes = 3 if kind == "markers" else 2
    middle = np.nanmean(values.reshape(len(values), -1, axes), axis=(0, 1))
    return np.tile(middle, values.shape[1] // axes)


def _within_time(most_s: float, tell: OnStep) -> OnStep:
    """Ends a rollout that takes too long: a hypothesis that the simulator can hardly follow is none. ``tell``: is
    called after each step."""
    end = time.process_time() + most_s

    def on_step(done: int, total: int) -> None:
        if time.process_time() > end:
            raise ConvergenceError(f"{done} of {total} steps took {most_s:g} s.", "")
        tell(done, total)

    return on_step


class Rollouts:
    """Predictions of the instants of a probe along other poses; the scene is built once. A rollout that takes far
    longer than the first one, that of the recording as it is, and than its share of what that one may take, is
    given up: it is far from anything that happened. ``costs``: hears of each."""

    def __init__(self, rig: Rig, probe: Probe, costs: RolloutCosts | None = None) -> None:
        self.probe, self._rig, self._costs = probe, rig, costs or RolloutCosts()
        self._scene: Scene = build_scene(rig)
        self._most_s, self._first = SETUP_CHECK.first_rollout_s, True

    def along(self, poses: Poses) -> dict[str, np.ndarray] | None:
        """Readings by channel ``(k, m)``; None where the rig cannot follow the poses."""
        begun = time.process_time()
        firsts = {name: replace(first, poses=dict(poses)) for name, first in self.probe.run.firsts.items()}
        run = replace(self.probe.run, poses=dict(poses), firsts=firsts)
        try:
            self._scene.use(self._rig)
            rig = placed(self._scene, run.firsts)
            self._scene.use(rig)
            times = rollout_times([rig], run, self.probe.dt)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # strains of a set-up that is only tried
                with self._costs.rollout(Kind(beginning=True)) as on_step:
                    trace = simulate(self._scene, run.poses, times, _within_time(self._most_s, on_step))
            if self._first:
                took = time.process_time() - begun
                shared = SETUP_CHECK.first_rollout_s / SETUP_CHECK.most_rollouts
                self._most_s = max(SETUP_CHECK.rollout_ratio * took, shared)
            return {
                m.channel: predicted(trace, rig, m.channel, m.t, run.since).reshape(len(m.t), -1) for m in run.measured
            }
        except ThinshellError:
            self._most_s = min(self._most_s, SETUP_CHECK.rollout_s)
            return None
        finally:
            self._first = False
