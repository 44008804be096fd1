"""A replay against its prediction, and the way back after an abort, without ROS."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from replay_bench import PEAK_M_S, Bench
from replay_plant import (
    DEPTH_M,
    MARKERS,
    PERIOD_S,
    SETTINGS,
    TRAJECTORY,
    UPRIGHT,
    with_limits,
)

from thinshell_ros.replay.session import Session
from thinshell_ros.replay.tracking import Placed


class Touched(Bench):
    """A bench with a prediction, whose sensors read what is predicted for where the command is."""

    def __init__(self) -> None:
        super().__init__(trajectory=TRAJECTORY)
        self.session = Session(TRAJECTORY, SETTINGS, ["pad"], 1.0, ["gel"])
        self.noise = np.random.default_rng(0)
        for _ in range(40):
            self.at_s += PERIOD_S
            self.read()
        assert self.session.execute(self.now) == ""

    def read(self, change: Any = None, seen: int = MARKERS, frame: str = "pad", marker_frame: str = "pad") -> None:
        """Good readings, but for what ``change`` makes of the force ``(3,)``."""
        commanded = self.session.commanded.get("hand", Placed((0.0, 0.0, 0.0), UPRIGHT))
        self.session.take_pose("hand", self.now, self.now.ros_s, "base_link", commanded)
        force = -1000.0 * max(-0.016 - commanded.position[2], 0.0)
        values = np.array([0.0, 0.0, force]) + 0.01 * self.noise.standard_normal(3)
        values = values if change is None else np.asarray(change(values))
        self.session.take_wrench("pad", self.now, self.now.ros_s, frame, tuple(values.tolist()), (0.0, 0.0, 0.0))
        rest = TRAJECTORY.predicted.markers["gel"].positions_m[0]
        places = rest + np.array([0.0, 0.0, -1e-4 * force]) + 1e-5 * self.noise.standard_normal(rest.shape)
        self.session.take_markers("gel", self.now, self.now.ros_s, marker_frame, np.arange(seen), places[:seen])

    def on(self, seconds: float, **reading: Any) -> Touched:
        for _ in range(round(seconds / PERIOD_S)):
            self.at_s += PERIOD_S
            self.read(**reading)
            self.session.tick(self.now)
        return self


def test_a_replay_as_predicted_succeeds_and_nothing_is_odd() -> None:
    bench = Touched().on(2.0)
    assert bench.session.state == "succeeded", bench.session.reason
    assert bench.session.watch.alarm is None
    assert not bench.session.watch.notes()


@pytest.mark.parametrize(
    ("reading", "said"),
    [
        ({"change": lambda f: 0.0 * f}, "reads exactly 0, 1 times in a row, and its force was to change by 4 N"),
        ({"change": lambda f: f[[2, 1, 0]]}, "as large as predicted, [34][.]\\d+ N, but turned by 90 deg against it"),
        ({"change": lambda f: -f}, "turned by 1[78]. deg against it, at most 2.0. N off is allowed"),
        ({"change": lambda f: f * 1.6}, "force on pad is 6[.]\\d+ N, at most 6 N is allowed"),
        ({"change": lambda f: f * 0.4}, "force on pad has changed by .* N since before the replay, and .* predicted"),
        ({"frame": "flange"}, "The wrench pad is in the frame 'flange', and it is expected in 'pad'"),
        ({"marker_frame": "camera"}, "The markers gel are in the frame 'camera', and they are expected in 'pad'"),
        ({"seen": 6}, "Of the markers gel 6 are seen, 12 were before the replay, and more than 6 have to be"),
    ],
)
def test_a_sensor_that_reads_something_else_than_it_must_ends_the_replay_in_that_period(
    reading: dict[str, Any], said: str
) -> None:
    bench = Touched().on(0.5)  # at rest in the depth, where 4 N are predicted
    assert bench.session.state == "running", bench.session.reason
    bench.on(PERIOD_S, **reading)
    assert bench.session.state == "aborted"
    assert re.search(said, bench.session.reason), bench.session.reason


@pytest.mark.parametrize(
    "reading", [{"seen": 7}, {"change": lambda f: f * 0.6}, {"change": lambda f: f + [0.5, 0.0, 0.0]}]
)
def test_what_a_model_may_be_wrong_by_does_not_end_a_replay_and_alarms_the_watch(reading: dict[str, Any]) -> None:
    bench = Touched().on(0.5).on(2.0, **reading)
    assert bench.session.state == "succeeded", bench.session.reason
    assert (bench.session.watch.alarm is not None) is ("change" in reading)


def test_a_sensor_with_an_offset_is_compared_by_its_changes() -> None:
    bench = Touched()
    bench.session = Session(TRAJECTORY, with_limits(max_force_n=60.0), ["pad"], 1.0, ["gel"])
    for _ in range(40):
        bench.on(PERIOD_S, change=lambda f: f + [0.0, 30.0, 0.0])
    assert bench.session.execute(bench.now) == ""
    bench.on(2.0, change=lambda f: f + [0.0, 30.0, 0.0])
    assert bench.session.state == "succeeded", bench.session.reason
    assert bench.session.watch.alarm is None


# The way back.


def gone_back(bench: Bench) -> list[float]:
    """Heights that are commanded on the way back, until it is over."""
    heights = [bench.session.commanded["hand"].position[2]]
    assert bench.session.retract(bench.now) == ""
    while bench.session.state == "retracting":
        bench.run(PERIOD_S)
        heights.append(bench.session.commanded["hand"].position[2])
    assert bench.session.state == "retracted", bench.session.reason
    return heights


@pytest.mark.parametrize("at_s", [0.05, 0.2, 0.5])
def test_after_an_abort_it_goes_back_on_request_the_way_it_came_within_its_limits(at_s: float) -> None:
    bench = Bench().start().run(at_s)
    bench.session.abort(bench.now, "on request")
    deepest = bench.session.commanded["hand"].position[2]
    bench.run(0.3)
    heights = np.array(gone_back(bench))
    assert heights[0] == deepest
    assert heights[-1] == pytest.approx(0.0, abs=1e-9)
    assert (np.diff(heights) >= -1e-7).all(), "it does not press again"
    speeds = np.diff(heights) / PERIOD_S
    accelerations = np.diff(speeds) / PERIOD_S
    assert speeds.max() <= 0.5 * PEAK_M_S * 1.01
    assert np.abs(accelerations).max() <= 10.0 / np.sqrt(3.0) * DEPTH_M / 0.4**2


def test_nothing_goes_back_before_a_replay_or_while_one_runs_or_twice() -> None:
    bench = Bench()
    assert "no replay has ended" in bench.session.retract(bench.now)
    bench.start().run(0.2)
    assert "A replay is running" in bench.session.retract(bench.now)
    bench.session.abort(bench.now, "on request")
    gone_back(bench)
    assert "no replay has ended" in bench.session.retract(bench.now)
    assert bench.session.execute(bench.now) == "", "another replay may begin"


def test_a_way_back_is_guarded_and_may_be_gone_on() -> None:
    bench = Bench().start().run(0.4)
    strong = {"wrench": ((0.0, 0.0, -6.5), (0.0, 0.0, 0.0))}
    bench.at_s += 0.001
    bench.feed(**strong)
    bench.run(PERIOD_S)
    assert "force on pad is 6.5 N" in bench.session.reason
    bench.at_s += 0.001
    bench.feed(**strong)
    assert bench.session.retract(bench.now) == "", "what presses has to be let go"
    bench.run(0.5)
    assert bench.session.state == "retracting", bench.session.reason
    bench.at_s += 0.001
    bench.feed(wrench=((0.0, 0.0, -7.5), (0.0, 0.0, 0.0)))
    bench.run(PERIOD_S)
    assert bench.session.state == "aborted"
    assert "force on pad is 7.5 N, at most 7.15 N is allowed" in bench.session.reason
    bench.run(0.1)
    heights = np.array(gone_back(bench))
    assert np.abs(np.diff(heights)).max() <= 0.5 * PEAK_M_S * PERIOD_S * 1.01
    assert heights[-1] == pytest.approx(0.0, abs=1e-9)
