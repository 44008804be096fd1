"""Readings against their prediction while a trajectory is replayed: an alarm of known rate of false ones. No ROS.

Where the model is true, a replay alarms with the probability a at most: half of it is for the open parameters of the
rig (:mod:`sim_core.trajectories.expected`), half for the noise that the rig states, of all readings at once. Lags and
what the steps of time of a simulation make are found from the readings themselves
(:mod:`thinshell_ros.replay.innovations`). What the rig gives no noise of is not watched. Readings that come faster than
the rig says are left out, so that their number holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sim_core.trajectories import Trajectory
from sim_core.trajectories.expected import (
    FALSE_ALARM,
    Band,
    marker_band,
    noise_factor,
    spread_factor,
    values_in_a_replay,
    wrench_band,
)
from thinshell_ros.replay.innovations import Innovations

SPACING = 0.8
"""Readings that come after less than this share of the interval that the rig says are left out."""


@dataclass(frozen=True)
class Alarm:
    """The first reading that is not as predicted: at a time of the trajectory, with a stamp; ``until_s``: the stamp of
    the last such one [s]."""

    sensor: str
    time_s: float
    text: str
    stamp_s: float
    until_s: float


@dataclass
class _Channel:
    """``watched`` ``(c,)``: which channels of a sensor have noise, so that their readings are compared."""

    readings: Innovations
    watched: np.ndarray
    least_s: float
    last_s: float = -math.inf


class PredictionWatch:
    """Watches all sensors of which a trajectory predicts readings and the rig states the noise.

    ``lag_s``: time of the trajectory by which the robot may be behind; ``scale``: time of the trajectory over that of a
    replay; ``step_s``: of the simulation that predicted, None where that is not known; ``held_s``: for how long a
    command is held, in time of a replay.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        lag_s: float,
        scale: float = 1.0,
        false_alarm: float = FALSE_ALARM,
        step_s: float | None = None,
        held_s: float = 0.0,
    ) -> None:
        self._steps = scale * held_s, step_s
        predicted, times = trajectory.predicted, trajectory.times_s
        count = values_in_a_replay(predicted, trajectory.duration_s / scale + 1.0) / SPACING
        # Half of what noise may alarm is for single readings, half for the distance of all of them up to each.
        self._factors = noise_factor(2.0 * count, false_alarm), math.log(4.0 * count / false_alarm)
        factors = spread_factor(predicted, false_alarm), self._factors[0]
        self.alarm: Alarm | None = None
        self._channels: dict[str, _Channel] = {}
        self._columns: dict[str, dict[int, int]] = {}
        self.unwatched: list[str] = []
        """Sensors that are predicted and not watched: the rig states no noise of them, or too few draws were made."""
        for name, wrench in predicted.wrenches.items():
            band = wrench_band(wrench, times, factors, trajectory.limits)
            self._add(name, band, wrench.rate_hz, lag_s + wrench.delay_s * scale)
        for name, markers in predicted.markers.items():
            band = marker_band(markers, times, factors)
            self._add(name, band, markers.rate_hz, lag_s + markers.delay_s * scale)
            self._columns[name] = {int(number): column for column, number in enumerate(markers.ids)}
        self.false_alarm = false_alarm

    def _add(self, name: str, band: Band, rate_hz: float, within_s: float) -> None:
        watched = (band.noise > 0.0) & np.isfinite(band.spread).all(axis=0)
        if not watched.any():
            self.unwatched.append(name)
            return
        readings = Innovations(band.of_channels(watched), self._factors, within_s, *self._steps)
        self._channels[name] = _Channel(readings, watched, SPACING / rate_hz)

    def notes(self) -> list[str]:
        """What is not watched, in words."""
        if not self.unwatched:
            return []
        return [
            f"{', '.join(self.unwatched)} is predicted and not watched: the rig states no noise of it, or there are no "
            "more draws than open parameters."
        ]

    def begin(self) -> None:
        """A replay begins."""
        self.alarm = None
        for channel in self._channels.values():
            channel.readings.begin()
            channel.last_s = -math.inf

    def take_wrench(self, name: str, stamp_s: float, values: np.ndarray, time_s: float | None) -> None:
        """A reading ``(6,)`` of a time of the trajectory [s]; None outside of a replay."""
        self._take(name, stamp_s, values, time_s)

    def take_markers(
        self, name: str, stamp_s: float, ids: np.ndarray, positions_m: np.ndarray, time_s: float | None
    ) -> None:
        """Positions ``(m, 3)`` of markers ``(m,)``."""
        columns = self._columns.get(name, {})
        values = np.full((len(columns), 3), np.nan)
        for number, position in zip(ids.tolist(), positions_m, strict=True):
            if number in columns:
                values[columns[number]] = position
        self._take(name, stamp_s, values.ravel(), time_s)

    def _take(self, name: str, stamp_s: float, values: np.ndarray, time_s: float | None) -> None:
        channel = self._channels.get(name)
        if channel is None:
            return
        values = values[channel.watched]
        if time_s is None:
            channel.readings.take_before(values)
            return
        if stamp_s - channel.last_s < channel.least_s:
            return
        channel.last_s = stamp_s
        change = channel.readings.change(values)
        excess = channel.readings.excess(change, time_s)
        excess = np.where(np.isnan(excess), -np.inf, excess)
        worst = int(np.argmax(excess))
        if excess[worst] > 0.0:
            words = self._words(name, channel, change[worst], worst, time_s)
            first = self.alarm or Alarm(name, time_s, words, stamp_s, stamp_s)
            self.alarm = replace(first, until_s=stamp_s)

    def _words(self, name: str, channel: _Channel, change: float, worst: int, time_s: float) -> str:
        expected = float(channel.readings.expected()[worst])
        worst = int(np.flatnonzero(channel.watched)[worst])
        if name not in self._columns:
            component, unit = (
                f"{'xyz'[worst % 3]} of the {'force' if worst < 3 else 'torque'}",
                "N" if worst < 3 else "N m",
            )
        else:
            number = next(n for n, column in self._columns[name].items() if column == worst // 3)
            component, unit = f"{'xyz'[worst % 3]} of the marker {number}", "m"
        return (
            f"At {time_s:.2f} s of the trajectory {component} of {name} has changed by {change:.4g} {unit}, and "
            f"{expected:.4g} {unit} is predicted: readings part from the prediction by more than its uncertainty and "
            f"the noise explain in {100.0 * (1.0 - self.false_alarm):g} % of replays."
        )
