"""Time-stamped poses of an end effector, and the speed profiles that they are made with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sim_core.errors import RecordingError
from sim_core.rigs.fields import FloatArray
from sim_core.rigs.pose_clock import taken_at
from sim_core.rigs.pose_curve import PoseCurve, noise_of, pose_curve

Profile = Callable[[FloatArray], FloatArray]
"""Share of the way, 0 to 1, over the share of the time, 0 to 1."""


@dataclass(frozen=True)
class PoseTrajectory:
    """Poses over time; a smooth curve (C2) between samples, held before the first and after the last.

    ``times``: [s], strictly increasing, shape ``(n,)``. ``positions``: [m], ``(n, 3)``.
    ``quaternions``: unit, x y z w, neighbours in one half space, ``(n, 4)``. ``noise``: standard deviations of the
    noise of positions [m] and turns [rad], one axis, which the curve smooths away; with none it goes through the
    samples. Where samples are no smooth motion the curve has corners (:mod:`sim_core.rigs.pose_curve`); of samples that
    were ``planned`` it has none.
    """

    times: FloatArray
    positions: FloatArray
    quaternions: FloatArray
    noise: tuple[float, float] = (0.0, 0.0)
    planned: bool = False

    @cached_property
    def curve(self) -> PoseCurve:
        """The curve through or near the samples, of which there are at least two."""
        return pose_curve(self.times, self.positions, self.quaternions, np.array(self.noise), smooth=self.planned)

    def smoothed(self) -> PoseTrajectory:
        """The same samples as measured ones: with the noise that they show, at the ticks of their clock where they were
        taken at these (:mod:`sim_core.rigs.pose_clock`)."""
        times = taken_at(self.times, self.positions, self.quaternions)
        sigma = noise_of(times, self.positions, self.quaternions)
        return replace(self, times=times, noise=(float(sigma[0]), float(sigma[1])))

    def drawn(self, rng: np.random.Generator) -> PoseCurve:
        """A curve along which the motion may have been as well as along :attr:`curve`: drawn from what the samples and
        their noise leave open, with the corners of that."""
        return pose_curve(
            self.times, self.positions, self.quaternions, np.array(self.noise), drawn=rng, smooth=self.planned
        )

    def since(self, begin: float) -> PoseTrajectory:
        """The same poses, with times that count from ``begin`` [s]."""
        return replace(self, times=self.times - begin)

    def part(self, samples: slice) -> PoseTrajectory:
        """Some of the samples in a row."""
        return replace(
            self, times=self.times[samples], positions=self.positions[samples], quaternions=self.quaternions[samples]
        )

    @classmethod
    def from_samples(
        cls,
        times: FloatArray,
        positions: FloatArray,
        quaternions: FloatArray,
        *,
        max_gap_s: float | None = None,
        source: str = "The pose stream",
        planned: bool = False,
    ) -> PoseTrajectory:
        """Build from samples such as a recorded stream; what cannot be a motion is an error.

        ``max_gap_s``: longest time between samples that may be bridged; None bridges any.
        ``source`` names the stream in errors. ``planned``: one smooth curve goes through all samples.
        """
        times = np.array(times, dtype=np.float64)
        positions = np.array(positions, dtype=np.float64)
        quaternions = np.array(quaternions, dtype=np.float64)
        n = len(times)
        if n == 0:
            raise RecordingError(f"{source} holds no pose.", "Record at least one.")
        if times.shape != (n,) or positions.shape != (n, 3) or quaternions.shape != (n, 4):
            raise RecordingError(
                f"{source} has times {times.shape}, positions {positions.shape} and quaternions {quaternions.shape}.",
                "Give shapes (n,), (n, 3) and (n, 4).",
            )
        finite = np.isfinite(times) & np.isfinite(positions).all(axis=1) & np.isfinite(quaternions).all(axis=1)
        if not finite.all():
            raise RecordingError(
                f"{source} holds a value that is not finite in sample {int(np.argmin(finite))}.",
                "Remove these samples.",
            )
        steps = np.diff(times)
        if n > 1 and steps.min() <= 0.0:
            index = int(np.argmin(steps > 0.0)) + 1
            raise RecordingError(
                f"{source} does not advance in time at sample {index} "
                f"({times[index]:.6f} s after {times[index - 1]:.6f} s).",
                "Sort the samples and keep one for each time.",
            )
        if max_gap_s is not None and n > 1 and steps.max() > max_gap_s:
            index = int(np.argmax(steps))
            raise RecordingError(
                f"{source} has a gap of {steps[index]:.3g} s at {times[index]:.3f} s, more than {max_gap_s:g} s.",
                "Cut the recording at the gap, or allow longer gaps.",
            )
        norms = np.linalg.norm(quaternions, axis=1)
        if np.abs(norms - 1.0).max() > 1e-2:
            index = int(np.argmax(np.abs(norms - 1.0)))
            raise RecordingError(
                f"{source} has a quaternion of length {norms[index]:.4g} in sample {index}.",
                "An orientation has length 1, in the order x, y, z, w.",
            )
        return cls(times, positions, _one_half_space(quaternions / norms[:, None]), planned=planned)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.times[-1] - self.times[0])

    def at(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Position [m] ``(3,)`` and quaternion x y z w ``(4,)`` at one time [s]."""
        positions, quaternions = self.sample(np.array([time]))
        return positions[0], quaternions[0]

    def sample(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions [m] ``(k, 3)`` and quaternions ``(k, 4)`` at any times [s] ``(k,)``."""
        inside = np.clip(times, self.times[0], self.times[-1])
        if len(self.times) == 1:
            return np.repeat(self.positions, len(inside), axis=0), np.repeat(self.quaternions, len(inside), axis=0)
        return self.curve.sample(inside)

    def speeds(self) -> tuple[FloatArray, FloatArray]:
        """Linear [m/s] and angular [rad/s] speed between neighbouring samples, each ``(n - 1,)``."""
        from scipy.spatial.transform import Rotation

        steps = np.diff(self.times)
        rotations = Rotation.from_quat(self.quaternions)
        angles = (rotations[:-1].inv() * rotations[1:]).magnitude()
        linear = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        return np.asarray(linear / steps), np.asarray(angles / steps)


def _one_half_space(quaternions: FloatArray) -> FloatArray:
    """Flip signs so that neighbours (the same rotation as q and -q) do not jump."""
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    signs = np.concatenate([[1.0], np.cumprod(flips)])
    return np.asarray(quaternions * signs[:, None])


MINIMUM_JERK_PEAK = 1.875
"""Highest over mean speed of a minimum-jerk motion."""


def minimum_jerk(share: FloatArray) -> FloatArray:
    """``10 t^3 - 15 t^4 + 6 t^5`` (Flash & Hogan 1985): speed and acceleration vanish at both ends."""
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def trapezoidal(ramp: float) -> Profile:
    """Constant acceleration, constant speed, constant deceleration.

    ``ramp``: share of the time spent in each of the two ramps, 0 < ramp <= 1/2.
    """
    peak = 1.0 / (1.0 - ramp)

    def profile(share: FloatArray) -> FloatArray:
        rising = 0.5 * peak / ramp * np.minimum(share, ramp) ** 2
        cruising = peak * np.clip(share - ramp, 0.0, 1.0 - 2.0 * ramp)
        falling = np.clip(share - (1.0 - ramp), 0.0, ramp)
        return np.asarray(rising + cruising + peak * falling - 0.5 * peak / ramp * falling**2)

    return profile


def trapezoidal_timing(distance: float, speed: float, acceleration: float) -> tuple[float, float]:
    """Duration [s] and ramp share of a move of ``distance`` that does not exceed speed and acceleration."""
    if distance * acceleration <= speed**2:
        return 2.0 * float(np.sqrt(distance / acceleration)), 0.5
    duration = distance / speed + speed / acceleration
    return duration, speed / acceleration / duration
