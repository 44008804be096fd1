"""Running: what the diagnosis gets to see, what is kept, what happens to errors."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
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

    def diagnose(command: list[str], cwd: Path, report: Callable[[float], None]) -> tuple[int, str]:
        report(0.5)
        seen = sorted(str(p.relative_to(cwd)) for p in cwd.rglob("*"))
        made.append({"command": command, "cwd": cwd, "seen": seen, "env": running._environment()})
        if len(made) == 2:
            return 2, "It did not converge."
        (cwd / "answer").mkdir()
        fit = {"baseline": {"held_out": 1.0}, "amended": None}
        said = {"verdict": "nothing_missing", "effects": [], "fit": fit, "baseline_parameters": []}
        said["posterior"] = {"effects": {}, "places": {}}
        text = json.dumps({**said, "amended_parameters": []})
        (cwd / "answer" / "diagnosis.json").write_text(text)
        return 0, ""

    monkeypatch.setattr(running, "_followed", diagnose)
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


def test_shares_are_of_the_cases_that_have_no_answer_yet(folder: Path, calls: list[dict[str, Any]]) -> None:
    del calls
    shares: list[float] = []
    run_cases(folder, on_progress=lambda share, name: shares.append(share))
    assert shares == [0.0, 0.25, 0.5, 0.75]
    shares.clear()
    run_cases(folder, on_progress=lambda share, name: shares.append(share))
    assert shares == [0.0, 0.5]


def test_a_diagnosis_that_runs_says_how_far_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shares: list[float] = []
    words = "import sys; print('diagnose: 30 % after 9 s, about 21 s left: baseline', file=sys.stderr); print('done')"
    code, said = running._followed([sys.executable, "-c", words], tmp_path, shares.append)
    assert (code, shares) == (0, [0.3])
    assert "baseline" in said and "done" in said
    monkeypatch.setattr(running, "TIME_LIMIT_S", 0.2)
    code, said = running._followed([sys.executable, "-c", "import time; time.sleep(60)"], tmp_path, shares.append)
    assert (code, said) == (-1, "not finished after 0.2 s")


def test_a_folder_without_cases_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="holds no cases"):
        run_cases(tmp_path)
