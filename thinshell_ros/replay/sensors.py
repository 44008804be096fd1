"""What must hold of wrenches and markers while a trajectory is replayed. No ROS."""

from __future__ import annotations

import math

import numpy as np

from sim_core.trajectories import Limits
from thinshell_ros.replay.expectation import Expectation, Repeats
from thinshell_ros.replay.streams import head

READINGS = 3.0
"""A sensor is silent when it has missed so many readings."""

FEW = 2
"""Repeats in a row from which on a reading that is not as expected is that of a sensor that has stopped."""

TURNED_RAD = 0.5
"""A force that is as large as expected, and turned by more than this, is in another frame."""

LEFT_SHARE = 0.5
"""Share of the markers before the replay of which there have to be more."""

GROWTH = 1.1
"""On a way back a force may be so many times what it was when it began."""


class WrenchGuard:
    """One wrench sensor. ``limits``: of force and torque; ``frame_id``: that its readings are in, '' where that is not
    known; ``expected``: of its readings, None where nothing is predicted."""

    def __init__(
        self, name: str, limits: Limits, frame_id: str = "", expected: Expectation | None = None, rate_hz: float = 0.0
    ) -> None:
        self._name, self._limits, self._frame_id, self._rate = name, limits, frame_id, rate_hz
        self._expected = expected
        self._repeats = Repeats()
        self._running = False
        self._most: tuple[float, float] = (math.inf, math.inf)
        self._last = np.zeros(6)
        self._strong = ""
        self.force_n = math.nan
        """Force of the last reading [N]."""

    def timeout_s(self, least: float) -> float:
        """After which time without a reading it is silent [s]."""
        return max(least, READINGS / self._rate) if self._rate else least

    def misfit(self, frame_id: str, values: tuple[float, ...]) -> str:
        """What is wrong with a reading in itself."""
        what = f"the wrench {self._name}"
        if self._frame_id and frame_id != self._frame_id:
            return (
                f"{head(what)} is in the frame {frame_id!r}, and it is expected in {self._frame_id!r}. "
                "Have its publisher name its frame, or correct frame_id in the rig."
            )
        return "" if all(map(math.isfinite, values)) else f"{head(what)} is not finite."

    def begin(self, back: bool) -> str:
        """A run begins; returns why it must not."""
        limits = self._limits
        force, torque = (float(np.linalg.norm(part)) for part in (self._last[:3], self._last[3:]))
        most = limits.max_force_n or math.inf, limits.max_torque_nm or math.inf
        self._most = (max(most[0], GROWTH * force), max(most[1], GROWTH * torque)) if back else most
        self._running = True
        if self._expected is not None:
            self._expected.begin()
        self._repeats.begin()
        if not back and self._strong:
            self._running = False
            return f"{self._strong} Unload the sensor, or set it to zero."
        return ""

    def end(self) -> None:
        """The run is over."""
        self._running = False

    def judge(self, values: np.ndarray, time_s: float | None) -> str:
        """What is wrong with a reading ``(6,)`` of a time of the trajectory [s], None where nothing is predicted."""
        self._last = values
        self.force_n = float(np.linalg.norm(values[:3]))
        self._repeats.take(values, -math.inf if time_s is None else time_s, self._running)
        if not self._running:
            limits = self._limits
            self._strong = self._too_strong(values, (limits.max_force_n or math.inf, limits.max_torque_nm or math.inf))
            if self._expected is not None:
                self._expected.take_before(values)
            return ""
        return self._too_strong(values, self._most) or ("" if time_s is None else self._odd(values, time_s))

    def _too_strong(self, values: np.ndarray, most: tuple[float, float]) -> str:
        for what, part, bound, unit in (("force", values[:3], most[0], "N"), ("torque", values[3:], most[1], "N m")):
            size = float(np.linalg.norm(part))
            if size > bound:
                return f"The {what} on {self._name} is {size:.4g} {unit}, at most {bound:.4g} {unit} is allowed."
        return ""

    def _odd(self, values: np.ndarray, time_s: float) -> str:
        if self._repeats.stopped():
            return (
                f"The wrench {self._name} has repeated exactly the same reading {self._repeats.count + 1} times, and "
                f"before it did not: the sensor has stopped at {self._words(values)}."
            )
        if self._expected is None:
            return ""
        change = self._expected.change(values)
        excess = self._expected.excess(change, time_s)
        worst = int(np.argmax(excess))
        if not excess[worst] > 0.0:
            return ""
        kind, unit = (("force", "N"), ("torque", "N m"))[worst // 3]
        part = slice(0, 3) if worst < 3 else slice(3, 6)
        expected = self._expected.expected(time_s)[part]
        allowed = float(self._expected.slack[worst] + self._expected.noise[worst])
        if self._repeats.count >= FEW or not values.any():
            word = "0" if not values.any() else self._words(values)
            return (
                f"The wrench {self._name} reads exactly {word}, {self._repeats.count + 1} times in a row, and its "
                f"{kind} was to change by {np.linalg.norm(expected):.3g} {unit}, at most {allowed:.3g} {unit} off is "
                "allowed: the sensor is dead, or nothing is touched."
            )
        sizes = float(np.linalg.norm(change[part])), float(np.linalg.norm(expected))
        if min(sizes) > 0.0 and abs(sizes[0] - sizes[1]) <= allowed:
            cosine = float(change[part] @ expected) / (sizes[0] * sizes[1])
            if (turn := math.acos(min(max(cosine, -1.0), 1.0))) > TURNED_RAD:
                return (
                    f"The {kind} on {self._name} is as large as predicted, {sizes[0]:.3g} {unit}, but turned by "
                    f"{math.degrees(turn):.0f} deg against it, at most {allowed:.3g} {unit} off is allowed: it is "
                    "in another frame than the rig says, or its axes are."
                )
        return (
            f"The {kind} on {self._name} has changed by {self._off(change[part])} {unit} since before the replay, and "
            f"{self._off(expected)} {unit} is predicted: at most {allowed:.3g} {unit} off is allowed of each component."
        )

    @staticmethod
    def _off(part: np.ndarray) -> str:
        return "(" + ", ".join(f"{value:.3g}" for value in part) + ")"

    @staticmethod
    def _words(values: np.ndarray) -> str:
        return f"{np.linalg.norm(values[:3]):.3g} N"


class MarkerGuard:
    """One marker sensor with the ``ids`` of its markers, in the frame ``frame_id``."""

    def __init__(self, name: str, ids: np.ndarray, frame_id: str = "", rate_hz: float = 0.0) -> None:
        self._name, self._ids, self._frame_id, self._rate = name, ids, frame_id, rate_hz
        self._seen = self._before = 0

    def timeout_s(self, least: float) -> float:
        """After which time without a reading it is silent [s]."""
        return max(least, READINGS / self._rate) if self._rate else least

    def misfit(self, frame_id: str) -> str:
        """What is wrong with a reading in itself."""
        if self._frame_id and frame_id != self._frame_id:
            return (
                f"The markers {self._name} are in the frame {frame_id!r}, and they are expected in {self._frame_id!r}. "
                "Have their publisher name its frame, or correct frame_id in the rig."
            )
        return ""

    def begin(self) -> str:
        """A replay begins; returns why it must not."""
        self._before = self._seen
        if not self._before:
            return (
                f"None of the {len(self._ids)} predicted markers {self._name} is seen. Check the camera and their ids."
            )
        return ""

    def judge(self, ids: np.ndarray) -> str:
        """What is wrong with the markers that a reading has, by their ids ``(m,)``."""
        self._seen = int(np.isin(self._ids, ids).sum())
        if self._before and self._seen <= LEFT_SHARE * self._before:
            return (
                f"Of the markers {self._name} {self._seen} are seen, {self._before} were before the replay, and more "
                f"than {LEFT_SHARE * self._before:.0f} have to be: they have vanished."
            )
        return ""
