"""The rig as written against each mistake of set-up, on a few instants of one recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.rigs import MarkerSensor, Rig, WrenchSensor
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import channel_noise
from sysid.observations.observations import Run
from sysid.progress.rollout_costs import RolloutCosts
from sysid.settings.model import MODEL
from sysid.settings.setup_check import SETUP_CHECK
from sysid.setup_check.evidence import Evidence, evidence
from sysid.setup_check.marker_mistakes import marker_mistakes, picture_mistakes
from sysid.setup_check.mistakes import Mistake
from sysid.setup_check.pose_mistakes import begins_elsewhere, pose_mistakes
from sysid.setup_check.probe import Probe, Rollouts, averaged, probe_of
from sysid.setup_check.wrench_mistakes import wrench_mistakes


@dataclass(frozen=True)
class Tried:
    """A mistake with its log odds against the rig as written, and by channel how readings are then explained.
    ``material``: what it leaves is less by a half, in some channel. ``start``: log odds, against other mistakes, of the
    place where the recording then begins."""

    mistake: Mistake
    log_odds: float
    channels: Mapping[str, Evidence]
    material: bool
    start: float

    @property
    def among_mistakes(self) -> float:
        """Log odds by which it stands among other mistakes."""
        return self.log_odds + self.start


@dataclass(frozen=True)
class Comparison:
    """The rig as written: how each channel is explained; what was tried, the likeliest first. ``followed``: the
    simulator could follow the recording as the rig says; ``ceiling``: log odds that no mistake can exceed."""

    as_written: Mapping[str, Evidence]
    tried: Sequence[Tried]
    followed: bool
    ceiling: float

    @property
    def named(self) -> list[Tried]:
        """The likeliest mistake and those that explain the recording as well; nothing where the rig does."""
        sure = [t for t in self.tried if t.material and t.log_odds > np.log(SETUP_CHECK.sure_odds)]
        return [t for t in sure if t.among_mistakes > sure[0].among_mistakes - np.log(SETUP_CHECK.sure_odds) / 2.0]


def compare(
    rig: Rig, run: Run, noise: Mapping[str, ChannelNoise] | None = None, costs: RolloutCosts | None = None
) -> Comparison:
    """Compare one run with its rig. ``noise``: of its channels, estimated if left out; ``costs``: hears of each
    rollout."""
    probe = probe_of(rig, run, noise or channel_noise(rig, [run]))
    rollouts = Rollouts(rig, probe, costs)
    predicted = rollouts.along(probe.run.poses)
    followed = predicted is not None
    flat = {m.channel: np.zeros_like(m.values) for m in probe.run.measured}
    as_written = _explained(probe, predicted or flat)
    readings = list(_reading_mistakes(rig, probe)) if predicted is not None else []
    ceiling = _prior(1) + sum(
        sum(q.best_possible() for q in quantities) - as_written[c].log for c, quantities in probe.channels.items()
    )
    moved: list[Mistake] = []
    if ceiling > np.log(SETUP_CHECK.sure_odds) and not _as_good_as_any(rig, as_written, followed):
        moved = pose_mistakes(rig, probe.run.poses, _reach(probe))[: SETUP_CHECK.most_rollouts]
    every = len(readings) + len(moved)
    elsewhere = begins_elsewhere(rig, probe.run.poses)
    tried = []
    for mistake in readings:
        assert mistake.readings is not None and predicted is not None
        found = _one(probe, mistake.part, mistake.readings(predicted[mistake.part]))
        gain = found.log - as_written[mistake.part].log + _prior(every, mistake.weight)
        tried.append(_tried(rig, mistake, gain, as_written, {mistake.part: found}, elsewhere))
    best = max(tried, key=lambda t: t.log_odds, default=None)
    explained_already = best is not None and best.log_odds > np.log(SETUP_CHECK.sure_odds)
    if elsewhere or not explained_already or best is None or not _as_good_as_any(rig, best.channels, True):
        for mistake in moved:
            assert mistake.poses is not None
            poses = mistake.poses(probe.run.poses)
            other = rollouts.along(poses)
            if other is None:
                continue
            explained = _explained(probe, other)
            gain = sum(explained[c].log - as_written[c].log for c in explained) + _prior(every, mistake.weight)
            tried.append(_tried(rig, mistake, gain, as_written, explained, begins_elsewhere(rig, poses)))
    tried.sort(key=lambda t: -t.among_mistakes)
    return Comparison(as_written, tuple(tried), followed, ceiling)


def _tried(
    rig: Rig,
    mistake: Mistake,
    log_odds: float,
    as_written: Mapping[str, Evidence],
    now: Mapping[str, Evidence],
    elsewhere: bool,
) -> Tried:
    material = any(found.materially_better(as_written[c], _size_log_sd(rig, c)) for c, found in now.items())
    start = float(np.log(SETUP_CHECK.begin_elsewhere)) if elsewhere else 0.0
    return Tried(mistake, log_odds, {**as_written, **now}, material, start)


def _as_good_as_any(rig: Rig, as_written: Mapping[str, Evidence], followed: bool) -> bool:
    """Whether what the rig as written leaves of every channel is no more than materials and meshes do."""
    return followed and all(
        e.error <= SETUP_CHECK.immaterial_error and abs(np.log(e.size)) <= _size_log_sd(rig, c)
        for c, e in as_written.items()
    )


def _size_log_sd(rig: Rig, channel: str) -> float:
    """Width of the logarithm of the size of what is predicted of a channel."""
    wrench = isinstance(rig.sensors.get(channel), WrenchSensor)
    return MODEL.plausible_log_sd if wrench else SETUP_CHECK.marker_motion_log_sd


def _prior(count: int, weight: float = 1.0) -> float:
    """Log odds of one of ``count`` mistakes against the rig before anything is seen."""
    share = SETUP_CHECK.prior_of_mistake
    return float(np.log(weight * share / (1.0 - share) / count))


def _reading_mistakes(rig: Rig, probe: Probe) -> list[Mistake]:
    found: list[Mistake] = []
    for channel in probe.channels:
        if channel in rig.cameras:
            found += picture_mistakes(channel, rig.cameras[channel])
            continue
        sensor = rig.sensors[channel]
        if isinstance(sensor, WrenchSensor):
            found += wrench_mistakes(channel, sensor)
        elif isinstance(sensor, MarkerSensor):
            found += marker_mistakes(channel, sensor)
    return found


def _reach(probe: Probe) -> float:
    """How far [m] hands move in the recording: as far from the rig's start a recording may begin."""
    return max((float(np.ptp(p.positions, axis=0).max()) for p in probe.run.poses.values()), default=0.0)


def _explained(probe: Probe, predicted: Mapping[str, np.ndarray]) -> dict[str, Evidence]:
    return {c: _one(probe, c, predicted[c]) for c in probe.channels}


def _one(probe: Probe, channel: str, predicted: np.ndarray) -> Evidence:
    means = averaged(predicted, probe.bins[channel])
    return evidence(probe.channels[channel], [means[:, q.columns] for q in probe.channels[channel]])
