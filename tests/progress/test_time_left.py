"""What is said of the time left: from shares that are done, and from rollouts that were measured."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_core.core.build import build
from sysid.progress import progress
from sysid.progress.rollout_costs import Kind, RolloutCosts, kind_of
from sysid.progress.terminal import Lines, share_of_line
from sysid.progress.time_left import TimeLeft, in_words
from sysid.progress.work import Stage, Work, stages_of
from sysid.settings.progress import PROGRESS


def test_progress_without_a_terminal_is_a_line_at_once_and_every_tenth(capsys: pytest.CaptureFixture[str]) -> None:
    with progress("work") as report:
        for step in range(1, 101):
            report(step / 100, "first" if step == 1 else "")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 11
    assert lines[0].startswith("work: 1 % after") and lines[0].endswith(
        "time left known once simulations have begun: first"
    )
    assert lines[-1].startswith("work: 100 % after")


def test_progress_without_a_terminal_is_never_silent_for_ten_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    lines = Lines("work", clock=lambda: now[0])
    lines(0.04, "on")
    for second in range(1, 31):
        now[0] = float(second)
        if lines.silent_for() <= 0.0:
            lines.still()
    spent = [int(line.split(" after ")[1].split(" s")[0]) for line in capsys.readouterr().err.splitlines()]
    assert spent == [0, 9, 18, 27]


def test_a_line_comes_by_itself_while_work_says_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sysid.progress.terminal.PROGRESS", replace(PROGRESS, silence_s=0.1))
    with progress("work") as report:
        report(0.2, "a long step")
        time.sleep(0.5)
    assert capsys.readouterr().err.count("a long step") >= 2


def test_time_left_is_said_from_the_rate(capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    lines = Lines("work", lambda: now[0])
    for now[0], share in ((10.0, 0.25), (20.0, 0.5), (40.0, 1.0)):
        lines(share, "on")
    assert capsys.readouterr().err.splitlines() == [
        "work: 25 % after 10 s, about 30 s left: on",
        "work: 50 % after 20 s, about 20 s left: on",
        "work: 100 % after 40 s: on",
    ]


def test_what_the_work_itself_says_counts_more_than_its_shares() -> None:
    clock = TimeLeft()
    clock.update(10.0, 0.5)
    assert clock.seconds(10.0) == pytest.approx(10.0)
    clock.set_estimate(10.0, 100.0)
    assert clock.seconds(15.0) == pytest.approx(95.0)
    assert clock.seconds(500.0) == pytest.approx(100.0 * PROGRESS.overdue_share)  # not over, though overdue


def test_time_left_is_the_geometric_mean_over_all_of_the_time_and_its_later_halves() -> None:
    clock = TimeLeft()
    clock.update(10.0, 0.5)
    clock.update(30.0, 0.75)
    assert clock.seconds(30.0) == pytest.approx((10.0 * 20.0 * 10.0) ** (1.0 / 3.0))  # of all, of the time, of the work


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.2, "about 1 s left"), (99.0, "about 99 s left"), (600.0, "about 10 min left")]
)
def test_times_are_said_in_their_unit(seconds: float, words: str) -> None:
    assert in_words(seconds, 0.5) == words
    assert in_words(2 * 3600.0, 0.5) == "about 2.0 h left"
    assert in_words(None, 0.5) and not in_words(seconds, 1.0)


def test_time_left_by_rates_is_right_within_a_factor_of_two() -> None:
    rng = np.random.default_rng(0)
    near: list[bool] = []
    for _ in range(100):
        ends = np.cumsum(rng.lognormal(0.0, 0.5, 40)) + 1.0
        clock = TimeLeft()
        for k, end in enumerate(ends[:30]):
            clock.update(float(end), (k + 1) / len(ends))
            left = clock.seconds(float(end))
            assert left is not None
            near.append(0.5 < left / (ends[-1] - end) < 2.0)
    assert np.mean(near) > 0.95


class Clocks:
    """Wall, process and thread time [s] that a test moves on by hand; ``pace``: wall time for one of the processor."""

    def __init__(self, pace: float = 1.0) -> None:
        self.processor, self.pace = 0.0, pace

    def wall(self) -> float:
        return self.pace * self.processor

    def spent(self) -> float:
        return self.processor


class Heard:
    """Progress that keeps what is reported to it."""

    def __init__(self) -> None:
        self.left: list[float] = []
        self.shares: list[float] = []

    def time_left(self, seconds: float) -> None:
        self.left.append(seconds)

    def __call__(self, share: float, text: str) -> None:
        self.shares.append(share)


STAGES = [
    Stage("first", {Kind(): 2.0, Kind(derivatives=True): 1.0}),
    Stage("second", {Kind(derivatives=True): 4.0}, between_s=10.0),
]


def work_on(clocks: Clocks, recordings: int = 1) -> tuple[Work, Heard]:
    heard = Heard()
    work = Work(heard, STAGES, recordings, clock=clocks.wall, processor=clocks.spent)
    work.costs = RolloutCosts(work._news, clocks.spent)
    return work, heard


def make(work: Work, clocks: Clocks, kind: Kind, seconds: float, steps: int = 10) -> None:
    """One rollout."""
    with work.costs.rollout(kind) as on_step:
        for k in range(steps):
            clocks.processor += seconds / steps
            on_step(k + 1, steps)


@pytest.mark.parametrize("pace", [0.5, 1.0, 8.0])
def test_time_left_is_known_from_the_first_steps_of_the_first_rollout(pace: float) -> None:
    """By half a rollout: 2 plain ones of 4 s and 5 with derivatives, 10 s between, on a machine however busy."""
    clocks = Clocks(pace)
    work, heard = work_on(clocks)
    work.enter("first")
    assert not heard.left
    with work.costs.rollout(Kind()) as on_step:
        for k in range(5):
            clocks.processor += 0.4
            on_step(k + 1, 10)
        expected = 1.5 * 4.0 + 5 * 4.0 * PROGRESS.derivatives_cost_ratio + 10.0
        assert work.remaining() == pytest.approx(pace * expected, rel=1e-6)
    assert heard.left


def test_a_kind_of_rollout_counts_as_it_was_measured_once_it_has_run() -> None:
    clocks = Clocks()
    work, _ = work_on(clocks, recordings=2)
    work.enter("first")
    for _ in range(4):
        make(work, clocks, Kind(), 1.0)
    for _ in range(2):
        make(work, clocks, Kind(derivatives=True), 7.0)
    work.enter("second")
    assert work.remaining() == pytest.approx(8 * 7.0 + 10.0)
    clocks.processor += 6.0  # between rollouts
    assert work.remaining() == pytest.approx(8 * 7.0 + 4.0)
    for _ in range(3):
        make(work, clocks, Kind(derivatives=True), 7.0)
    assert work.remaining() == pytest.approx(5 * 7.0 + 4.0)


def test_what_goes_on_for_longer_than_expected_is_not_over_and_shares_never_fall() -> None:
    clocks = Clocks()
    work, heard = work_on(clocks)
    work.enter("second")
    for _ in range(20):
        make(work, clocks, Kind(derivatives=True), 5.0)
    left = work.remaining()
    assert left is not None and left >= PROGRESS.overdue_share * 4 * 5.0
    assert heard.shares == sorted(heard.shares) and heard.shares[-1] <= PROGRESS.most_share
    work.enter("first")
    assert heard.shares == sorted(heard.shares)
    work.done()
    assert heard.shares[-1] == 1.0


def test_a_hundred_percent_is_said_at_the_end_alone() -> None:
    clocks = Clocks()
    heard = Heard()
    work = Work(heard, [Stage("only", {Kind(): 1.0})], 1, clock=clocks.wall, processor=clocks.spent)
    work.costs = RolloutCosts(work._news, clocks.spent)
    work.enter("only")
    for _ in range(200):
        make(work, clocks, Kind(), 1.0)
    assert heard.shares[-1] == PROGRESS.most_share
    work.done()
    assert heard.shares[-1] == 1.0


def test_news_of_rollouts_is_said_no_more_often_than_anybody_reads() -> None:
    clocks = Clocks()
    work, heard = work_on(clocks)
    work.enter("first")
    make(work, clocks, Kind(), 10.0 * PROGRESS.least_pause_s, steps=1000)
    assert len(heard.shares) <= 12


def test_what_a_stage_needs_may_become_known_in_it() -> None:
    clocks = Clocks()
    work, _ = work_on(clocks)
    work.enter("second")
    make(work, clocks, Kind(derivatives=True), 2.0)
    work.say("more of them", {Kind(derivatives=True): 11.0})
    assert work.remaining() == pytest.approx(10 * 2.0 + 10.0)
    work.say("and on")
    assert work.remaining() == pytest.approx(10 * 2.0 + 10.0)


def test_a_machine_that_becomes_busy_is_noticed() -> None:
    clocks = Clocks()
    wall = [0.0]
    work = Work(Heard(), [Stage("only", {Kind(): 20.0})], 1, clock=lambda: wall[0], processor=clocks.spent)
    work.costs = RolloutCosts(work._news, clocks.spent)
    work.enter("only")
    for pace in (1.0,) * 5 + (4.0,) * 5:
        with work.costs.rollout(Kind()) as on_step:
            clocks.processor += 1.0
            wall[0] += pace
            on_step(1, 1)
    assert work.remaining() == pytest.approx(4.0 * 10.0)


def test_processor_time_of_a_rollout_that_runs_is_not_taken_for_that_between_rollouts() -> None:
    clocks = Clocks()
    work, _ = work_on(clocks)
    work.enter("second")
    with work.costs.rollout(Kind(derivatives=True)) as on_step:
        for k in range(5):
            clocks.processor += 1.0
            on_step(k + 1, 10)
        assert work.remaining() == pytest.approx(3.5 * 10.0 + 10.0)


def test_what_is_done_before_the_first_step_counts_once() -> None:
    """A scene is built in it: 6 s, then 1 s a step."""
    clocks = Clocks()
    costs = RolloutCosts(clock=clocks.spent)
    with costs.rollout(Kind()) as on_step:
        clocks.processor += 6.0
        on_step(1, 10)
        assert costs.seconds(Kind()) is None
        clocks.processor += 1.0
        on_step(2, 10)
        assert costs.seconds(Kind()) == pytest.approx(15.0)


def test_what_later_rollouts_cost_counts_and_one_that_fails_has_ended() -> None:
    clocks = Clocks()
    costs = RolloutCosts(clock=clocks.spent)
    for seconds in (1.0, 1.0, 3.0, 5.0):
        with costs.rollout(Kind()):
            clocks.processor += seconds
    assert costs.seconds(Kind()) == pytest.approx(4.0)
    with pytest.raises(ValueError, match="far"), costs.rollout(Kind()) as on_step:
        on_step(1, 2)
        raise ValueError("far")
    assert costs.count(Kind()) == 5.0


def test_kinds_that_have_not_run_cost_what_their_parts_were_measured_to() -> None:
    clocks = Clocks()
    costs = RolloutCosts(clock=clocks.spent)
    with costs.rollout(Kind()):
        clocks.processor += 2.0
    for words, ratio in (
        ("finer", PROGRESS.finer_cost_ratio),
        ("beginning", PROGRESS.beginning_cost_ratio),
        ("responses derivatives", PROGRESS.responses_cost_ratio),
        ("shorter derivatives", PROGRESS.shorter_cost_ratio * PROGRESS.derivatives_cost_ratio),
    ):
        assert costs.seconds(kind_of(words)) == pytest.approx(2.0 * ratio)
        assert ratio != 1.0


def test_other_progress_hears_shares_alone() -> None:
    clocks = Clocks()
    shares: list[float] = []
    work = Work(lambda share, text: shares.append(share), STAGES, 1, clock=clocks.wall, processor=clocks.spent)
    work.costs = RolloutCosts(work._news, clocks.spent)
    work.enter("first")
    make(work, clocks, Kind(), 4.0)
    assert 0.0 < shares[-1] < 0.3


def test_stages_of_commands_have_kinds_that_exist() -> None:
    assert kind_of("plain") == Kind()
    assert kind_of("finer derivatives") == Kind(derivatives=True, finer=True)
    with pytest.raises(TypeError):
        kind_of("faster")
    for rollouts, between in (
        (PROGRESS.fit_rollouts, PROGRESS.fit_between_s),
        (PROGRESS.diagnosis_rollouts, PROGRESS.diagnosis_between_s),
    ):
        assert [s.name for s in stages_of(rollouts, between)] == list(rollouts) == list(between)


def test_the_share_of_a_line_is_read_again(capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    lines = Lines("diagnose", lambda: now[0])
    now[0] = 30.0
    lines(0.42, "baseline: 3 of 7")
    assert share_of_line(capsys.readouterr().err) == 0.42
    assert share_of_line("warning: the finger moved by 42 % after 3 s") is None
    assert share_of_line("Traceback") is None


def test_what_is_compiled_is_said_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with progress("fit"):
        build(tmp_path / "drag_force_0123abcd.so", "", "int main() { return 0; }\n")
    build(tmp_path / "drag_force_4567abcd.so", "", "int main() { return 0; }\n")
    said = capsys.readouterr().err
    assert said.splitlines() == ["fit: drag_force is compiled, which happens once on a machine"]
