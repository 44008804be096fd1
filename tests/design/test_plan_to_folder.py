"""A plan that is written into a folder."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from sim_core.rigs import load_rig
from sysid.workflow import plan as workflow


def test_a_plan_is_made_as_it_was_asked_for_and_written_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def stand_in(*arguments: Any) -> SimpleNamespace:
        asked.append(arguments)
        return SimpleNamespace(to_json=lambda: '{"rig": "strip_coarse"}')

    monkeypatch.setattr(workflow, "plan_experiments", stand_in)
    rig, nuisance = load_rig("strip_coarse"), frozenset({"bias"})

    def report(share: float, text: str) -> None:
        del share, text

    workflow.plan_to_folder(rig, (), ("strip.E",), out=tmp_path / "plan", on_progress=report, nuisance=nuisance)
    assert asked == [(rig, (), ("strip.E",), report, nuisance)]
    assert [p.name for p in (tmp_path / "plan").iterdir()] == ["plan.json"]
    assert (tmp_path / "plan" / "plan.json").read_text() == '{"rig": "strip_coarse"}\n'
