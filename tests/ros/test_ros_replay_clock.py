"""Two simulators tell time on topics of their own: replay and recorder follow the one that they are remapped to."""

from __future__ import annotations

import multiprocessing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytestmark = pytest.mark.ros

CLOCKS = {"/clock": 1, "/twin/clock": 0}
"""Publishers of each: the twin has ended, and the other simulator goes on."""


class Node:
    """Stands in for a node that was started with ``-r /clock:=/twin/clock``."""

    def resolve_topic_name(self, name: str) -> str:
        return {"/clock": "/twin/clock"}.get(name, name)

    def count_publishers(self, topic: str) -> int:
        return CLOCKS[topic]

    def get_name(self) -> str:
        return "deploy"

    def get_namespace(self) -> str:
        return "/twin"

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=True)


def test_a_replay_ends_with_the_simulator_that_it_follows(ros: None) -> None:
    from thinshell_ros.replay.deployment import Deployment

    said: list[str] = []

    class Bare(Deployment):
        def __init__(self) -> None:
            self._node: Any = Node()
            self._given: Any = SimpleNamespace(guard=SimpleNamespace(simulated_time=True))
            self.session: Any = SimpleNamespace(moving=True, report=lambda: "state")
            self._recording = None

        def abort(self, reason: str) -> bool:
            said.append(reason)
            return True

    assert Bare().watch() == ["state"]
    assert said == ["Nobody publishes /twin/clock any more: the simulation has ended."]


def test_a_recorder_follows_the_clock_of_its_replay(ros: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from thinshell_ros.replay.recording import Recording

    words: list[str] = []

    def process(target: object, args: tuple[list[str]], **more: object) -> Any:
        words.extend(args[0])
        return SimpleNamespace(start=lambda: None)

    monkeypatch.setattr(multiprocessing, "get_context", lambda method: SimpleNamespace(Process=process))
    owner: Any = Node()
    Recording(owner, ["/twin/wrench"], "", str(tmp_path / "bag"))
    assert "/clock:=/twin/clock" in words and "use_sim_time:=true" in words
