"""Running: what the diagnosis gets to see, what is kept, what happens to errors."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from sim_core.errors import ConfigError
from sysid.proof import run as running
from sysid.proof import run_cases
from sysid.proof.seal import file_digest, write_seal


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    out = tmp_path / "benchmark"
    for name in ("case_01", "case_02"):
        for run in ("run_a", "run_b"):
            (out / name / run).mkdir(parents=True)
        (out / name / "rig.yaml").write_text("name: bench\n")
        (out / name / "case.yaml").write_text(yaml.safe_dump({"training": ["run_a"], "held_out": ["run_b"]}))
    write_seal(out, {"cases": []}, salt="00")
    return out


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Diagnoses instead of real ones; the second case fails the first time."""
    made: list[dict[str, Any]] = []

    def diagnose(command: list[str], *, cwd: Path, env: dict[str, str], **_: Any) -> Any:
        seen = sorted(str(p.relative_to(cwd)) for p in cwd.rglob("*"))
        made.append({"command": command, "cwd": cwd, "seen": seen, "env": env})
        if len(made) == 2:
            return subprocess.CompletedProcess(command, 2, "", "It did not converge.")
        (cwd / "answer").mkdir()
        fit = {"baseline": {"held_out": 1.0}, "amended": None}
        said = {"verdict": "nothing_missing", "effects": [], "fit": fit, "baseline_parameters": []}
        said["posterior"] = {"effects": {}, "places": {}}
        text = json.dumps({**said, "amended_parameters": []})
        (cwd / "answer" / "diagnosis.json").write_text(text)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(running.subprocess, "run", diagnose)
    return made


def test_a_diagnosis_sees_a_copy_of_its_case_and_nothing_else(folder: Path, calls: list[dict[str, Any]]) -> None:
    run_cases(folder)
    for call in calls:
        assert folder not in [call["cwd"], *call["cwd"].parents]
        assert call["seen"] == ["case", "case/case.yaml", "case/rig.yaml", "case/run_a", "case/run_b"]
        assert not [word for word in call["command"][1:] if str(folder) in word or "case_0" in word]
        assert not call["cwd"].exists()
    words = calls[0]["command"][3:]
    assert words == ["diagnose", "case/rig.yaml", "case/run_a", "--held-out", "case/run_b", "--out", "answer"]


def test_errors_are_recorded_and_tried_again(folder: Path, calls: list[dict[str, Any]]) -> None:
    assert "1 of 2 cases diagnosed" in run_cases(folder)
    diagnoses = json.loads((folder / "answers.json").read_text())
    assert diagnoses["cases"]["case_01"]["answer"]["verdict"] == "nothing_missing"
    assert diagnoses["cases"]["case_02"]["error"] == "It did not converge."
    assert diagnoses["seal"] == (folder / "sealed.json.sha256").read_text().strip()
    assert (folder / "answers.json.sha256").read_text().strip() == file_digest(folder / "answers.json")
    first = (folder / "answers" / "case_01" / "run.json").stat().st_mtime_ns
    assert "2 of 2 cases diagnosed" in run_cases(folder)
    assert len(calls) == 3
    assert (folder / "answers" / "case_01" / "run.json").stat().st_mtime_ns == first


def test_a_folder_without_cases_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="holds no cases"):
        run_cases(tmp_path)
