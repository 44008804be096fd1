"""How far readings may be from what a trajectory predicts, and which limits and tolerances follow from that.

A reading y of a channel with the predicted mean m(t) is taken apart as y = m + J(t) theta + e. What is not known of the
p parameters of the rig, theta, is the same throughout a replay; the noise e is new in every reading. With standard
deviations s(t) from n rollouts with drawn parameters, Hotelling's T^2 bounds all directions, so all times and channels,
at once (Scheffe's argument; Anderson, An Introduction to Multivariate Statistical Analysis, sec. 5.2):

    |J(t) theta| <= T s(t),   T^2 = p (n - 1) / (n - p) (1 + 1/n) F(1 - a/2; p, n - p)

for responses that are linear in theta, with the probability 1 - a/2. N noise values of standard deviation sigma are all
within Z sigma, Z = Phi^-1(1 - a / (4 N)), with at least the same probability (Bonferroni). So a replay of which the
model is true leaves |y - m| <= T s + Z sigma with the probability a at most: :data:`FALSE_ALARM`.

A simulation is never quite true. Where something is done because of a prediction (a replay is ended, a force is
limited), :data:`MODEL_SHARE` of the largest predicted change is allowed for besides, or :data:`RESOLUTION_SHARE` of the
limits of the hand where that is more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim_core.rigs.limits import HandLimits, Limits
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.trajectories.model import MarkerPrediction, Prediction, WrenchPrediction

FALSE_ALARM = 1e-3
"""Share of replays in which the watch may be wrong once, when the model is true."""

MODEL_SHARE = 0.5
"""Error of a simulation that is allowed for before it ends a replay, over the largest change that it predicts."""

RESOLUTION_SHARE = 1e-3
"""Force and torque, over the limits of the hand, below which no difference ends a replay."""

TOLERANCE_SHARE = 0.05
"""How far an end effector may be from its path, over the size of the motion."""


def spread_factor(predicted: Prediction, alarm: float = FALSE_ALARM) -> float:
    """T: how many standard deviations what is not known of the rig may make. Infinite where there are no more draws
    than open parameters; of a file that gives neither, that of a normal distribution and one parameter."""
    from scipy.stats import chi2, f

    n, p = predicted.draws, predicted.open_parameters or 1
    if n is None:
        return float(np.sqrt(chi2.ppf(1.0 - 0.5 * alarm, p)))
    if n <= p:
        return math.inf
    return float(np.sqrt(p * (n - 1) / (n - p) * (1.0 + 1.0 / n) * f.ppf(1.0 - 0.5 * alarm, p, n - p)))


def noise_factor(count: float, alarm: float = FALSE_ALARM) -> float:
    """Z: within how many standard deviations so many noise values are."""
    from scipy.stats import norm

    return float(norm.isf(alarm / (4.0 * max(count, 1.0))))


@dataclass(frozen=True)
class Band:
    """One channel. ``mean``, ``spread`` ``(n, c)``: predicted values, and T times their standard deviations, at
    ``times`` [s]; ``noise`` ``(c,)``: Z times the noise; ``slack``: of the model, as each component may have it."""

    times: np.ndarray
    mean: np.ndarray
    spread: np.ndarray
    noise: np.ndarray
    slack: np.ndarray

    def of_channels(self, which: np.ndarray) -> Band:
        """The same of some components only; ``which`` ``(c,)``: a mask."""
        kept = (self.mean[:, which], self.spread[:, which], self.noise[which], self.slack[which])
        return Band(self.times, *kept)

    @property
    def width(self) -> np.ndarray:
        """Largest deviation that is expected ``(n, c)``, without the slack of the model."""
        return np.asarray(self.spread + self.noise)


def values_in_a_replay(predicted: Prediction, duration_s: float) -> float:
    """Number of noise values that are compared in a replay of a duration [s]: of all components of all sensors."""
    wrenches = sum(6.0 * w.rate_hz for w in predicted.wrenches.values())
    markers = sum(3.0 * len(m.ids) * m.rate_hz for m in predicted.markers.values())
    return max(1.0, (wrenches + markers) * duration_s)


def wrench_band(wrench: WrenchPrediction, times: np.ndarray, factors: tuple[float, float], hand: Limits) -> Band:
    """Force [N] and torque [N m], ``c`` = 6. ``factors``: T and Z; ``hand``: the limits of what carries the sensor."""
    mean = np.hstack([wrench.forces_n, wrench.torques_nm])
    spread = np.zeros_like(mean)
    for axes, sds in ((slice(0, 3), wrench.force_sds_n), (slice(3, 6), wrench.torque_sds_nm)):
        if sds is not None:
            spread[:, axes] = _spread(sds, factors[0])
    noise = factors[1] * np.repeat([wrench.force_noise_n, wrench.torque_noise_nm], 3)
    change = mean - mean[0]
    least_n, least_nm = _resolution(hand)
    slack = [
        max(MODEL_SHARE * _largest(change[:, :3]), least_n),
        max(MODEL_SHARE * _largest(change[:, 3:]), least_nm),
    ]
    return Band(times, mean, spread, noise, np.repeat(slack, 3))


def marker_band(markers: MarkerPrediction, times: np.ndarray, factors: tuple[float, float]) -> Band:
    """Positions of markers [m], ``c`` = 3 m, without an error of the model. ``factors``: T and Z."""
    mean = markers.positions_m.reshape(len(times), -1)
    sds = markers.position_sds_m
    spread = np.zeros_like(mean) if sds is None else _spread(sds.reshape(mean.shape), factors[0])
    count = mean.shape[1]
    return Band(times, mean, spread, np.full(count, factors[1] * markers.position_noise_m), np.zeros(count))


def force_limits(wrench: WrenchPrediction, factors: tuple[float, float], hand: Limits) -> tuple[float, float]:
    """Largest force [N] and torque [N m] that the prediction allows for: its largest value with T standard deviations,
    the error of the model, and Z times the noise of three components; at most the limits of the ``hand``."""
    found = []
    least, most = _resolution(hand), (hand.max_force_n or math.inf, hand.max_torque_nm or math.inf)
    for kind, (values, sds, noise) in enumerate(
        (
            (wrench.forces_n, wrench.force_sds_n, wrench.force_noise_n),
            (wrench.torques_nm, wrench.torque_sds_nm, wrench.torque_noise_nm),
        )
    ):
        sizes = np.linalg.norm(values, axis=1)
        spread = 0.0 if sds is None else _spread(np.linalg.norm(sds, axis=1), factors[0])
        slack = max(MODEL_SHARE * float(sizes.max()), least[kind])
        found.append(min(float((sizes + spread).max()) + slack + factors[1] * math.sqrt(3.0) * noise, most[kind]))
    return found[0], found[1]


def _spread(sds: np.ndarray, factor: float) -> np.ndarray:
    """A factor, which may be infinite, times standard deviations, which may be 0."""
    return np.asarray(np.where(sds > 0.0, factor * np.where(sds > 0.0, sds, 1.0), 0.0))


def _resolution(hand: Limits) -> tuple[float, float]:
    """Least force [N] and torque [N m] that count."""
    usual = HandLimits()
    force = hand.max_force_n or usual.max_force_n
    return RESOLUTION_SHARE * force, RESOLUTION_SHARE * (hand.max_torque_nm or usual.max_torque_nm)


def path_tolerances(
    path: PoseTrajectory, wrenches: list[WrenchPrediction], accuracy: tuple[float, float]
) -> tuple[float, float]:
    """How far [m], [rad] an end effector may be from its path.

    :data:`TOLERANCE_SHARE` of the size of the motion, and at most the distance in which the predicted force changes by
    what is allowed for of the model; never less than its ``accuracy``.
    """
    size = _largest(path.positions - path.positions[0])
    dots = np.abs(path.quaternions @ path.quaternions[0])
    turn = float(2.0 * np.arccos(np.clip(dots, 0.0, 1.0)).max())
    near = TOLERANCE_SHARE * size
    for wrench in wrenches:
        slope = _steepest(path.positions, wrench.forces_n, near)
        if slope > 0.0:
            near = min(near, MODEL_SHARE * _largest(wrench.forces_n - wrench.forces_n[0]) / slope)
    return max(near, accuracy[0]), max(TOLERANCE_SHARE * turn, accuracy[1])


def _steepest(positions: np.ndarray, forces: np.ndarray, over: float) -> float:
    """Largest change of a force per way [N/m], over parts of the way of at least the length ``over`` [m]."""
    if over <= 0.0 or len(positions) != len(forces):
        return 0.0
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    ends = np.searchsorted(way, way + over)
    starts = np.flatnonzero(ends < len(way))
    ends = ends[starts]
    apart = np.linalg.norm(positions[ends] - positions[starts], axis=1)
    changes = np.linalg.norm(forces[ends] - forces[starts], axis=1)
    moved = apart > 0.5 * over
    return float((changes[moved] / apart[moved]).max()) if moved.any() else 0.0


def _largest(vectors: np.ndarray) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())
