"""The process that fits, with stand-ins for the fit: what is left of one that is ended, and what is said of it."""

import json
import os
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from test_ros_fit_request import request_of

from sim_core.rigs import load_rig
from sysid.fit.multistart import Step
from sysid.io.atomic_folder import unfinished, whole_folder
from thinshell_ros import job_process
from thinshell_ros.fit_request import FitRequest
from thinshell_ros.job_process import Event, Failed, JobProcess, Succeeded
from thinshell_ros.job_state import JobState
from thinshell_ros.jobs import Jobs

RIG = load_rig(Path(__file__).parent / "data" / "pull_coarse.yaml")
START_S = 120.0
FIT = {
    "rig": "pull", "correlation": [[1.0]], "misfit": 1.1, "converged": True, "no_success": "", "unexplained": [],
    "undetermined": [], "identifiability": [],
    "remarks": [], "cautions": [], "notes": [], "provenance": {"bags": [], "versions": {}},
    "estimates": [{"name": "strip.E_pa", "value": 4e9, "sd": 0.01, "log": True, "ci95": [3.9e9, 4.1e9], "unit": "Pa"}],
}  # fmt: skip


def _write(request: FitRequest) -> None:
    with whole_folder(request.out) as folder:
        (folder / "fit.json").write_text(json.dumps(FIT))


def wrote_and_says_nothing(link: Connection, request: FitRequest) -> None:
    os.setsid()
    _write(request)
    link.poll(None)


def wrote_and_crashed(link: Connection, request: FitRequest) -> None:
    os.setsid()
    _write(request)
    os._exit(3)


def writes(link: Connection, request: FitRequest) -> None:
    os.setsid()
    with whole_folder(request.out) as folder:
        (folder / "fit.json").write_text("half")
        link.poll(None)


def cannot_move(link: Connection, request: FitRequest) -> None:
    os.setsid()
    unfinished(request.out).mkdir()
    (unfinished(request.out) / "fit.json").write_text(json.dumps(FIT))
    link.send(Failed("The results are finished but cannot be moved."))


def started(monkeypatch: pytest.MonkeyPatch, stand_in: Any, request: FitRequest) -> JobProcess:
    """A process of the stand-in, which has written something."""
    monkeypatch.setattr(job_process, "run", stand_in)
    process = JobProcess(request)
    until(lambda: request.out.exists() or (unfinished(request.out) / "fit.json").exists())
    return process


def until(wanted: Any) -> Any:
    end = time.monotonic() + START_S
    while not (found := wanted()):
        assert time.monotonic() < end
        time.sleep(0.05)
    return found


@pytest.fixture
def asked(tmp_path: Path) -> FitRequest:
    return request_of(RIG, tmp_path)


def test_a_fit_that_is_stopped_after_all_is_written_has_succeeded(
    monkeypatch: pytest.MonkeyPatch, asked: FitRequest
) -> None:
    process = started(monkeypatch, wrote_and_says_nothing, asked)
    assert not list(process.events())
    assert process.stop() == Succeeded(FIT)
    assert process.stop() is None


def test_a_fit_that_crashes_after_all_is_written_has_succeeded(
    monkeypatch: pytest.MonkeyPatch, asked: FitRequest
) -> None:
    process = started(monkeypatch, wrote_and_crashed, asked)
    assert until(lambda: list(process.events())) == [Succeeded(FIT)]


def test_a_fit_that_is_stopped_while_it_writes_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch, asked: FitRequest
) -> None:
    process = started(monkeypatch, writes, asked)
    assert process.stop() is None
    assert not list(asked.out.parent.iterdir())


def test_finished_files_that_could_not_be_moved_are_kept(monkeypatch: pytest.MonkeyPatch, asked: FitRequest) -> None:
    process = started(monkeypatch, cannot_move, asked)
    (failed,) = until(lambda: list(process.events()))
    assert "cannot be moved" in failed.reason
    assert json.loads((unfinished(asked.out) / "fit.json").read_text()) == FIT


def test_what_speaks_against_a_recording_is_reported_before_the_fit_ends(
    monkeypatch: pytest.MonkeyPatch, asked: FitRequest
) -> None:
    def fit(*given: Any, on_warning: Callable[[str], None], on_step: Callable[[Step], None], **options: Any) -> None:
        on_warning("pull: 27 markers, the rig 33.")
        on_step(Step(1, 7.5, {"strip.E_pa": 4e9}))
        _write(asked)

    sent: list[Event] = []
    monkeypatch.setattr(job_process, "fit_bags", fit)
    monkeypatch.setattr(job_process, "_end_with", lambda link, part: None)
    monkeypatch.setattr(os, "setsid", lambda: None)
    job_process.run(SimpleNamespace(send=sent.append), asked)  # type: ignore[arg-type]
    statuses, logged = _node(asked, [sent[:2], sent[2:]])
    assert logged[0] == "fit_7: pull: 27 markers, the rig 33."
    assert [(s.message, s.level) for s in statuses] == [("running", b"\x01"), ("succeeded", b"\x00")]


def _node(asked: FitRequest, batches: Sequence[Sequence[Event]]) -> tuple[list[Any], list[str]]:
    """What a node without its middleware publishes as its status, and logs, when it takes the events of a fit."""
    node, published, logged = node_without_middleware(asked)
    for events in batches:
        node._jobs._take(events)
    return published["_status"], logged


def node_without_middleware(asked: FitRequest) -> tuple[Any, dict[str, list[Any]], list[str]]:
    """A node that has begun a fit; what it publishes, and what it logs."""
    from thinshell_ros.sysid_node import SysidNode

    published: dict[str, list[Any]] = {"_status": [], "_estimate": [], "_result": []}
    logged: list[str] = []

    class Bare(SysidNode):
        def __init__(self) -> None:
            self._rig, self._reported_s, self._shown = RIG, 0.0, None
            self._jobs = Jobs(self._heard)
            self._jobs.request, self._jobs.state = asked, JobState("fit_7", "running", "reading", 200)
            self._actions: Any = SimpleNamespace(publish=lambda: None)
            for topic, messages in published.items():
                setattr(self, topic, SimpleNamespace(publish=messages.append))

        def get_logger(self) -> Any:
            return SimpleNamespace(info=logged.append, warning=logged.append, error=logged.append)

        def get_fully_qualified_name(self) -> str:
            return "/tactile_sysid"

    return Bare(), published, logged


def test_a_cancel_that_comes_after_all_is_written_publishes_the_result(
    monkeypatch: pytest.MonkeyPatch, asked: FitRequest
) -> None:
    node, published, _ = node_without_middleware(asked)
    node._jobs._process = started(monkeypatch, wrote_and_says_nothing, asked)
    answer = node._on_cancel(SimpleNamespace(), SimpleNamespace())
    assert not answer.success
    assert answer.message == f"fit_7 succeeded before it could be cancelled; results in {asked.out}"
    assert published["_status"][-1].message == "succeeded"
    assert json.loads(published["_result"][-1].data)["estimate"] == {"strip.E_pa": 4e9}
    assert list(published["_estimate"][-1].data) == [4e9]
