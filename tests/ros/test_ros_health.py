"""What the nodes' diagnostics say. Needs no ROS."""

import queue
from typing import Any

import pytest

from thinshell_ros.health import Announcer, CommandLog, Report, physics_report, recording_report, topics_report
from thinshell_ros.protocol import Status
from thinshell_ros.supervisor import Supervisor
from thinshell_ros.worker import Worker

TROUBLE = "The step did not converge."


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
    assert [answer for _, answer in supervisor.responses()] == [hasty, calm]
    assert supervisor.review() == Status(False, "", 2.0, 0.9, 22, 9, 1e-5, 1, -1e-4, 3, 0.0, 0.5, 0.7)
    assert supervisor.review() == calm, "reported once"


def test_a_fault_that_stays_is_reported_from_time_to_time() -> None:
    announcer = Announcer()
    good, bad = Report("commands", "ok", ""), Report("commands", "warn", "x")
    news = [announcer.is_news(*pair) for pair in ((good, 0.0), (bad, 1.0), (bad, 2.0), (bad, 40.0), (good, 41.0))]
    assert news == [False, True, False, True, True]


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
