"""The loop around the physics: requests, responses, time. Needs no ROS."""

import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from thinshell_ros.loop import Loop
from thinshell_ros.physics import RETRY_S, Physics
from thinshell_ros.poses import Pose
from thinshell_ros.protocol import Batch, Done, Pause, Ready, Reset, Status, Step, Stop, Target
from thinshell_ros.sampling import Reading

TROUBLE = "The step did not converge."


@dataclass
class FakeReport:
    iterations: int = 3
    residual_n: float = 1e-9
    contacts: int = 2
    min_gap_m: float = -1e-6


@dataclass
class FakePhysics:
    """Steps of 10 ms that cost ``cost_s``; fails on demand."""

    dt: float = 0.01
    failure: Any = None
    behind: tuple[float, float] = (0.0, 0.0)
    cost_s: float = 0.0

    ids: dict[str, Any] = field(default_factory=dict)
    rest: dict[str, Any] = field(default_factory=lambda: {"cell": np.zeros(6)})
    time: float = 0.0
    fails: bool = False
    targets: list[Target] = field(default_factory=list)

    def step(self) -> tuple[list[Reading], FakeReport, int]:
        if self.fails:
            raise ConvergenceError(TROUBLE)
        time.sleep(self.cost_s)
        self.time += self.dt
        return [Reading("cell", self.time, np.full(6, self.time))], FakeReport(), 1

    def aim(self, target: Target) -> None:
        self.targets.append(target)

    def reset(self) -> None:
        self.fails = False


class Bench:
    """A loop in a thread, and the other end of its pipe."""

    def __init__(self, factor: float = 1.0, paused: bool = False) -> None:
        self.physics = FakePhysics()
        self._factor, self._paused = factor, paused
        self.link, far = multiprocessing.Pipe()
        self.thread = threading.Thread(target=self._run, args=(far,))
        self.thread.start()

    def _run(self, far: Connection) -> None:
        try:
            Loop(far, self.physics, self._factor, paused=self._paused).run()  # type: ignore[arg-type]
        except (EOFError, OSError):
            pass

    def until(self, wanted: Callable[[Any], bool]) -> Any:
        """The next answer that is wanted."""
        end = time.monotonic() + 120.0
        while time.monotonic() < end:
            if self.link.poll(0.1) and wanted(answer := self.link.recv()):
                return answer
        raise AssertionError("the answer did not come")

    def drain(self, seconds: float) -> list[Any]:
        """All responses of some time."""
        end, responses = time.monotonic() + seconds, []
        while (left := end - time.monotonic()) > 0.0:
            if self.link.poll(left):
                responses.append(self.link.recv())
        return responses


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.link.close()
    bench.thread.join(120.0)
    assert not bench.thread.is_alive(), "the loop ends when the other side is gone"


@pytest.fixture
def paused() -> Iterator[Bench]:
    bench = Bench(paused=True)
    yield bench
    bench.link.close()
    bench.thread.join(120.0)


def is_status(**values: Any) -> Callable[[Any], bool]:
    return lambda a: isinstance(a, Status) and all(getattr(a, k) == v for k, v in values.items())


def test_it_keeps_real_time_and_says_how_it_is_doing(bench: Bench) -> None:
    assert isinstance(bench.until(lambda _: True), Ready)
    start = time.monotonic()
    last = bench.until(lambda a: isinstance(a, Batch) and a.simulated_s > 0.5)
    assert time.monotonic() - start > 0.4
    assert last.readings[0].values[0] == pytest.approx(last.simulated_s)
    status = bench.until(is_status(paused=False))
    assert (status.iterations, status.contacts, status.residual_n) == (3, 2, 1e-9)
    assert status.not_finite == status.steps > 0
    assert 0.0 < status.real_time_factor < 1.2


def test_one_that_begins_paused_stands_still_until_it_is_let_go(paused: Bench) -> None:
    assert isinstance(paused.until(lambda _: True), Ready)
    assert paused.until(is_status(paused=True)).steps == 0
    assert not [a for a in paused.drain(0.3) if isinstance(a, Batch)]
    paused.link.send(Pause(1, False))
    assert paused.until(lambda a: isinstance(a, Batch)).simulated_s == pytest.approx(0.01)


def test_a_pause_stops_time_and_is_left_out_of_the_stamps(bench: Bench) -> None:
    bench.link.send(Pause(1, True))
    assert bench.until(lambda a: isinstance(a, Done)) == Done(1, True, "paused")
    before = bench.physics.time
    responses = bench.drain(0.6)
    assert not [a for a in responses if isinstance(a, Batch)]
    assert [a for a in responses if isinstance(a, Status)], "it goes on to say how it is doing"
    bench.link.send(Pause(2, False))
    first = bench.until(lambda a: isinstance(a, Batch))
    assert first.simulated_s == pytest.approx(before + 0.01)
    assert 0.6 < first.skipped_s < 3.0, "stamps are the wall clock's again"
    bench.drain(0.2)
    assert bench.physics.time - before < 0.6, "it does not catch up with the time of the pause"


def test_what_a_slow_spell_has_cost_is_reported_and_then_left_out(bench: Bench) -> None:
    bench.until(lambda a: isinstance(a, Batch))
    bench.physics.cost_s = 0.1
    slow = bench.until(lambda a: isinstance(a, Status) and a.lag_s > 1.0)
    assert slow.real_time_factor < 0.9
    bench.physics.cost_s = 0.0
    after = bench.until(lambda a: isinstance(a, Batch) and a.skipped_s > 0.0)
    assert after.skipped_s > 0.4
    bench.until(lambda a: isinstance(a, Status) and a.lag_s < 0.05)


def test_steps_are_made_on_demand_while_it_is_paused(bench: Bench) -> None:
    bench.link.send(Step(1, 0.05))
    refused = bench.until(lambda a: isinstance(a, Done))
    assert not refused.success
    assert "pause" in refused.message
    bench.link.send(Pause(2, True))
    bench.until(lambda a: isinstance(a, Done))
    before = bench.physics.time
    for number, duration, steps in ((3, 0.0, 1), (4, 0.05, 5), (5, 0.051, 6)):
        bench.link.send(Step(number, duration))
        batches: list[Batch] = []
        done = bench.until(lambda a, to=batches: (isinstance(a, Batch) and to.append(a)) or isinstance(a, Done))
        assert (done.number, done.success, len(batches)) == (number, True, steps)
        assert f"{steps} step" in done.message
    assert bench.physics.time == pytest.approx(before + 0.12)
    bench.physics.fails = True
    bench.link.send(Step(6, 0.02))
    failed = bench.until(lambda a: isinstance(a, Done))
    assert (failed.success, failed.message.startswith("0 of 2 steps")) == (False, True)


class Silence:
    """A pipe from which nothing comes, on a clock that only waiting moves."""

    def __init__(self) -> None:
        self.now, self.sent = 0.0, 0

    def poll(self, wait: float) -> bool:
        self.now += wait
        return False

    def send(self, answer: Any) -> None:
        if isinstance(answer, Batch):
            self.sent += 1
            if self.sent == 200:
                raise OSError


@pytest.mark.parametrize(("factor", "wall_s"), [(4.0, 0.5), (1.0, 2.0), (0.25, 8.0), (0.0, 0.0)])
def test_faster_and_slower_than_real_time(factor: float, wall_s: float) -> None:
    """200 steps of 10 ms are 2 s of simulated time."""
    link = Silence()
    with pytest.raises(OSError):
        Loop(cast(Connection, link), cast(Physics, FakePhysics()), factor, clock=lambda: link.now).run()
    assert link.now == pytest.approx(wall_s, abs=1e-6)


def test_targets_reach_the_physics(bench: Bench) -> None:
    target = Target("probe", Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])))
    bench.link.send(target)
    bench.link.send(Pause(1, True))
    bench.until(lambda a: isinstance(a, Done))
    assert [t.end_effector for t in bench.physics.targets] == ["probe"]


def test_a_step_that_fails_is_said_and_a_reset_goes_on(bench: Bench) -> None:
    bench.until(lambda a: isinstance(a, Batch))
    bench.physics.fails = True
    bench.until(lambda a: isinstance(a, Status) and a.trouble.startswith(TROUBLE))
    at = bench.physics.time
    assert not [a for a in bench.drain(0.3) if isinstance(a, Batch)], "nothing is read while it stands still"
    bench.link.send(Reset(5))
    done = bench.until(lambda a: isinstance(a, Done))
    assert (done.number, done.success, list(done.rest)) == (5, True, ["cell"])
    assert bench.until(lambda a: isinstance(a, Batch)).simulated_s == pytest.approx(at + 0.01)
    bench.until(is_status(trouble=""))


def test_where_no_step_is_found_another_command_goes_on(bench: Bench) -> None:
    bench.until(lambda a: isinstance(a, Batch))
    bench.physics.fails = True
    bench.until(lambda a: isinstance(a, Status) and a.trouble.startswith(TROUBLE))
    bench.drain(RETRY_S)
    bench.physics.fails = False
    assert not [a for a in bench.drain(0.1) if isinstance(a, Batch)]
    bench.link.send(Target("probe", Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))))
    bench.until(lambda a: isinstance(a, Batch))
    bench.until(is_status(trouble=""))


def test_it_stops_on_request(bench: Bench) -> None:
    bench.link.send(Stop())
    bench.thread.join(120.0)
    assert not bench.thread.is_alive()
