"""The loop around the physics: requests, answers, failures. Needs no ROS."""

import multiprocessing
import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sim_core.rigs import load_rig, with_parameters
from thinshell_ros.health import Announcer, CommandLog, Report, physics_report, recording_report, topics_report
from thinshell_ros.loop import Loop
from thinshell_ros.physics import RETRY_S, Physics
from thinshell_ros.poses import Pose
from thinshell_ros.protocol import Batch, Done, Pause, Ready, Reset, Settings, Status, Step, Stop, Target
from thinshell_ros.sampling import Reading
from thinshell_ros.streams import channels_of
from thinshell_ros.supervisor import Supervisor
from thinshell_ros.worker import Worker

RIG = Path(__file__).parent / "data" / "press_gel.yaml"
TROUBLE = "The step did not converge."


@dataclass
class FakeReport:
    iterations: int = 3
    residual_n: float = 1e-9
    contacts: int = 2
    min_gap_m: float = -1e-6


@dataclass
class FakePhysics:
    """Steps of 10 ms that cost ``cost_s``; fails when told."""

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

    def __init__(self, factor: float = 1.0) -> None:
        self.physics = FakePhysics()
        self._factor = factor
        self.link, far = multiprocessing.Pipe()
        self.thread = threading.Thread(target=self._run, args=(far,))
        self.thread.start()

    def _run(self, far: Connection) -> None:
        try:
            Loop(far, self.physics, self._factor).run()  # type: ignore[arg-type]
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
        """All answers of some time."""
        end, answers = time.monotonic() + seconds, []
        while (left := end - time.monotonic()) > 0.0:
            if self.link.poll(left):
                answers.append(self.link.recv())
        return answers


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.link.close()
    bench.thread.join(120.0)
    assert not bench.thread.is_alive(), "the loop ends when the other side is gone"


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


def test_a_pause_stops_time_and_is_left_out_of_the_stamps(bench: Bench) -> None:
    bench.link.send(Pause(1, True))
    assert bench.until(lambda a: isinstance(a, Done)) == Done(1, True, "paused")
    before = bench.physics.time
    answers = bench.drain(0.6)
    assert not [a for a in answers if isinstance(a, Batch)]
    assert [a for a in answers if isinstance(a, Status)], "it goes on to say how it is doing"
    bench.link.send(Pause(2, False))
    first = bench.until(lambda a: isinstance(a, Batch))
    assert first.simulated_s == pytest.approx(before + 0.01)
    assert 0.6 < first.skipped_s < 3.0, "stamps are the wall clock's again"
    bench.drain(0.2)
    assert bench.physics.time - before < 0.6, "it does not catch up with the time of the pause"


def test_what_a_slow_spell_has_cost_is_told_and_then_left_out(bench: Bench) -> None:
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
        Loop(cast(Connection, link), cast(Physics, FakePhysics()), factor, lambda: link.now).run()
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


def test_it_stops_when_told(bench: Bench) -> None:
    bench.link.send(Stop())
    bench.thread.join(120.0)
    assert not bench.thread.is_alive()


def settings(**changes: Any) -> Settings:
    rig = load_rig(RIG)
    values: dict[str, Any] = {"seed": None, "max_speed_m_s": 0.1, "max_turn_rate_rad_s": 1.0, **changes}
    return Settings(rig, channels_of(rig, 50.0), **values)


@pytest.fixture(scope="module")
def physics() -> Physics:
    return Physics(settings())


def press(physics: Physics, z: float, steps: int) -> dict[str, np.ndarray]:
    """Last readings after going to a height [m]."""
    physics.aim(Target("probe", Pose(np.array([0.0, 0.0, z]), np.array([0.0, 0.0, 0.0, 1.0]))))
    last = {}
    for _ in range(steps):
        last.update({r.channel: r.values for r in physics.step()[0]})
    return last


def test_the_end_effector_goes_to_its_target_no_faster_than_allowed(physics: Physics) -> None:
    physics.reset()
    start = physics.rest["probe"]
    readings = press(physics, 0.0065, 1)
    np.testing.assert_allclose(readings["probe"][2], start[2] - 0.1 * physics.dt, atol=1e-12)
    np.testing.assert_allclose(press(physics, 0.0095, 3)["probe"][2], 0.0095, atol=1e-12)


def test_pressing_pushes_the_sensor_down_and_letting_go_relieves_it(physics: Physics) -> None:
    physics.reset()
    touching = press(physics, 0.0092, 30)
    assert touching["pad_wrench"][2] < -0.1
    assert touching["pad_markers"][:, 2].min() < physics.rest["pad_markers"][:, 2].min() - 1e-5
    relieved = press(physics, 0.0105, 30)
    np.testing.assert_allclose(relieved["pad_wrench"], physics.rest["pad_wrench"], atol=1e-6)


def test_a_failed_step_leaves_the_state_untouched(physics: Physics, monkeypatch: pytest.MonkeyPatch) -> None:
    physics.reset()
    press(physics, 0.0095, 20)
    before = physics._read()
    simulation = physics._simulation

    def fail(*_: Any) -> None:
        simulation.scene.system.x[:] += 1e-3
        raise ConvergenceError(TROUBLE)

    with monkeypatch.context() as patch:
        patch.setattr(simulation, "step", fail)
        with pytest.raises(ConvergenceError):
            press(physics, 0.0094, 1)
    after = physics._read()
    assert all((before[name] == after[name]).all() for name in before)


def test_where_a_step_fails_the_end_effector_is_held_until_the_command_retreats(
    physics: Physics, monkeypatch: pytest.MonkeyPatch
) -> None:
    physics.reset()
    press(physics, 0.0095, 20)
    simulation, real, wall, tried = physics._simulation, physics._simulation.step, [0.0], []

    def too_deep(frames: Any, dt: float) -> Any:
        depth = frames["probe"][0][2]
        if depth < 0.0094:
            tried.append(depth)
            wall[0] += 1.0
            raise ConvergenceError(TROUBLE)
        return real(frames, dt)

    monkeypatch.setattr(simulation, "step", too_deep)
    monkeypatch.setattr(physics, "_clock", lambda: wall[0])
    before = physics.time
    held = press(physics, 0.0080, 10)["probe"][2]
    assert held == pytest.approx(0.0095), "the first step of 2 mm fails"
    assert physics.time == pytest.approx(before + 10 * physics.dt), "time goes on"
    assert physics.failure is not None
    assert TROUBLE in physics.failure.words
    assert len(tried) == 1, "a command that stays is not tried again"
    press(physics, 0.0079, 5)
    assert len(tried) == 1, "nor at once is one that goes farther"
    wall[0] += 10.0
    press(physics, 0.0079, 1)
    assert len(tried) == 2, "but it is after a while"
    assert press(physics, 0.0100, 5)["probe"][2] == pytest.approx(0.0100), "a retreat is followed at once"
    assert physics.failure is None


def test_a_gel_that_is_pressed_too_far_is_told_by_name_and_a_retreat_is_followed(physics: Physics) -> None:
    """To the mount that the gel of 4 mm is glued to, and back; the force that guards look at never falls on the way."""
    physics.reset()
    forces = []
    for _ in range(40):
        readings = press(physics, 0.0035, 5)
        forces.append(-readings["pad_wrench"][2])
        if physics.failure is not None:
            break
    assert physics.failure is not None
    assert "pad would turn inside out near x = " in physics.failure.words
    assert forces[-1] > 10.0 and (np.diff(forces) >= -1e-3 * max(forces)).all()
    press(physics, 0.0105, 60)
    assert physics.failure is None
    physics.reset()


def test_time_goes_on_over_a_reset(physics: Physics) -> None:
    before = physics.time
    physics.reset()
    readings = physics.step()[0]
    assert all(r.stamp_s > before for r in readings)


def test_the_worker_never_swamps_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[Any] = []
    worker = Worker.__new__(Worker)
    worker._targets, worker._listening, worker._number, worker._inbox = {}, True, 0, queue.SimpleQueue()
    monkeypatch.setattr(worker, "_send", sent.append)
    poses = [Pose(np.array([0.0, 0.0, z]), np.array([0.0, 0.0, 0.0, 1.0])) for z in range(100)]
    for pose in poses:
        worker.aim(Target("probe", pose))
    assert [t.pose.position[2] for t in sent] == [0], "one until the process has answered"
    worker._listening = True
    worker._pass_on()
    assert [t.pose.position[2] for t in sent] == [0, 99], "then the latest"
    worker.aim(Target("probe", poses[1]))
    worker.reset()
    worker._listening = True
    worker._pass_on()
    assert sent[-1] == Reset(1), "a reset forgets targets from before"


def test_what_the_diagnostics_say() -> None:
    assert physics_report(None, "", 5).level == "warn"
    good = Status(False, "", 1.0, 1.0, 25, 4, 1e-9, 3, -1e-6, 0)
    assert physics_report(good, "", 5).level == "ok"
    assert physics_report(good, "", 5).values["real_time_factor"] == "1"
    slow = physics_report(Status(False, "", 1.0, 0.42), "", 5)
    assert slow.level == "warn"
    assert "0.42" in slow.message
    failed = physics_report(Status(False, TROUBLE, 1.0, 1.0), "", 5)
    assert failed.level == "error"
    assert TROUBLE in failed.message
    assert "reset" in failed.message
    assert physics_report(good, "The physics process ended with code -9.", 5).level == "error"
    assert physics_report(Status(False, "", 1.0, 1.0, not_finite=3), "", 5).level == "warn"
    late = physics_report(Status(False, "", 1.0, 1.0, lag_s=3.2), "", 5)
    assert (late.level, late.values["lag_s"]) == ("warn", "3.2")
    assert "3.20 s behind" in late.message
    half = Status(False, "", 1.0, 0.5)
    assert physics_report(half, "", 5, wanted=0.5).level == "ok"
    assert "2.5 s so far" in physics_report(good, "", 5, silent_s=2.5).message


def test_rejections_are_a_warning_once_and_counted_for_good() -> None:
    log = CommandLog()
    assert log.report(0.0).message == "waiting for a target"
    log.accept("probe", 10.0)
    log.reject("not finite")
    log.reject("too far")
    report = log.report(10.5)
    assert report.level == "warn"
    assert report.message == "2 targets rejected, the last: too far"
    assert (report.values["command_age_s"], report.values["dropped_commands"]) == ("0.5", "2")
    assert log.report(11.5).level == "warn", "the last that came was rejected"
    log.accept("probe", 12.0)
    later = log.report(12.1)
    assert (later.level, later.values["dropped_commands"], later.values["last_rejection"]) == (
        "ok", "2", "too far",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("now", "status", "commanders", "said"),
    [
        (56.0, None, 1, "no target of probe for 46 s"),
        (10.1, Status(False, TROUBLE, 1.0, 1.0), 1, "not carried out"),
        (10.1, Status(False, "", 1.0, 1.0, behind_m=0.12), 1, "0.12 m and 0 rad behind the target"),
        (10.1, None, 2, "2 publishers"),
    ],
)
def test_commands_that_are_stale_or_not_followed_are_a_warning(
    now: float, status: Status | None, commanders: int, said: str
) -> None:
    log = CommandLog(timeout_s=0.5)
    log.accept("probe", 10.0)
    assert log.report(10.1, Status(False, "", 1.0, 1.0)).level == "ok"
    report = log.report(now, status, commanders)
    assert report.level == "warn"
    assert said in report.message


def test_what_lasts_less_than_the_time_between_two_reports_is_in_one_of_them() -> None:
    arriving = queue.SimpleQueue[tuple[float, Any]]()
    supervisor = Supervisor.__new__(Supervisor)
    supervisor._waiting, supervisor._since, supervisor.status = {}, None, None
    supervisor._worker = Worker.__new__(Worker)
    supervisor._worker._inbox, supervisor._worker._targets = arriving, {}
    calm = Status(False, "", 2.0, 0.9, 10, 2, 1e-9, 1, 1e-3)
    hasty = Status(False, TROUBLE, 1.0, 1.0, 12, 9, 1e-5, 2, -1e-4, 3, 0.2, 0.5, 0.7)
    for status in (hasty, calm):
        arriving.put((0.0, status))
    assert [answer for _, answer in supervisor.answers()] == [hasty, calm]
    assert supervisor.review() == Status(False, "", 2.0, 0.9, 22, 9, 1e-5, 1, -1e-4, 3, 0.0, 0.5, 0.7)
    assert supervisor.review() == calm, "told once"


def test_a_fault_that_stays_is_told_from_time_to_time() -> None:
    announcer = Announcer()
    good, bad = Report("commands", "ok", ""), Report("commands", "warn", "x")
    told = [announcer.is_news(*pair) for pair in ((good, 0.0), (bad, 1.0), (bad, 2.0), (bad, 40.0), (good, 41.0))]
    assert told == [False, True, False, True, True]


def test_who_else_publishes_is_said() -> None:
    assert topics_report({}).level == "ok"
    report = topics_report({"/current_pose": ["/real_arm"], "/wrench": ["/real_arm"]})
    assert report.level == "error"
    assert report.message.startswith("/real_arm also publishes on /current_pose, /wrench.")


def test_a_recorder_says_what_is_missing() -> None:
    good = recording_report({"/a": 3, "/b": 4}, [], {}, "bag")
    assert (good.level, good.message, good.values) == ("ok", "7 messages in bag", {"/a": "3", "/b": "4"})
    bad = recording_report({"/a": 3, "/b": 0}, ["/c"], {"/d": "is odd"}, "bag")
    assert bad.level == "warn"
    assert all(part in bad.message for part in ("/b", "nobody publishes /c", "/d: is odd"))


def test_poses_are_told_without_the_offset_of_the_end_effector() -> None:
    """The probe is 1 mm higher than it says: the pose that goes out is that of the command, and stays so at rest."""
    plain = settings()
    off = replace(plain, rig=with_parameters(plain.rig, {"probe.offset_z_m": 1e-3}))
    physics = Physics(off)
    np.testing.assert_array_equal(physics.rest["probe"], Physics(plain).rest["probe"])
    high = physics._simulation.frames["probe"][0] - plain.rig.end_effectors["probe"].start.position()
    np.testing.assert_allclose(np.linalg.norm(high), 1e-3, rtol=1e-9)
    physics.step()
    np.testing.assert_allclose(physics._simulation.frames["probe"][0], high + physics.rest["probe"][:3], atol=1e-12)
