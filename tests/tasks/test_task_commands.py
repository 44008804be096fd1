"""The commands ``tasks``, ``optimise`` and ``benchmark``, on a small task."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from small_task import small_task

from sysid.cli.app import main


def test_optimise_and_benchmark_write_what_they_print(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = small_task(tmp_path)
    task, out = str(tmp_path / "small.yaml"), tmp_path / "run"
    options = ["--method", "gradient", "--workers", "1", "--seed", "2"]
    assert main(["optimise", task, *options, "--budget", "3", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    result = json.loads((out / "result.json").read_text())
    assert f"reward {result['reward']:.5g}" in printed and "3 rollouts" in printed
    assert made.variant.words in printed
    assert (out / "curve.png").stat().st_size > 1000
    bench = tmp_path / "bench"
    command = ["benchmark", task, "--methods", "gradient", "--seeds", "1", "--budget", "2", "--workers", "1"]
    assert main([*command, "--to-the-end", "--out", str(bench)]) == 0
    first = capsys.readouterr().out
    rows = json.loads((bench / "table.json").read_text())
    assert len(rows) == 1 and rows[0]["rollouts"] == 2 and rows[0]["task"] == "small"
    page = (bench / "table.html").read_text()
    assert page.count("data:image/png;base64,") == 1 and page.count("data:image/gif;base64,") == 1
    assert "1 of 1 runs" in page and f"{rows[0]['rewards'][0]:.4g}" in page
    made_at = (bench / "runs/small_real_gradient_0/result.json").stat().st_mtime_ns
    assert main([*command, "--to-the-end", "--out", str(bench)]) == 0
    assert capsys.readouterr().out == first
    assert (bench / "runs/small_real_gradient_0/result.json").stat().st_mtime_ns == made_at


def test_seeds_begin_elsewhere_and_a_table_says_what_was_not_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small_task(tmp_path)
    bench = tmp_path / "bench"
    command = ["benchmark", str(tmp_path / "small.yaml"), "--methods", "adam,cma", "--budget", "2", "--workers", "1"]
    assert main([*command, "--seeds", "2", "--minutes", "0", "--out", str(bench)]) == 0
    assert "0 of 2 | not run" in capsys.readouterr().out
    assert not list((bench / "runs").iterdir())
    assert main([*command, "--seeds", "2", "--out", str(bench)]) == 0
    assert "not run" not in capsys.readouterr().out
    starts = {}
    for run in (bench / "runs").iterdir():
        starts[run.name] = json.loads((run / "evaluations.jsonl").read_text().splitlines()[0])["action"]
    assert len(starts) == 4
    assert starts["small_real_adam_0"] != starts["small_real_adam_1"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["optimise", "liftin"], "Did you mean 'lifting'?"),
        (["optimise", "lifting", "--method", "hybird"], "There is no method 'hybird'. Did you mean 'hybrid'?"),
        (["optimise", "lifting:reel"], "has no variant 'reel'. Did you mean 'real'?"),
        (["optimise", "lifting", "--budget", "0"], "--budget"),
        (["optimise", "lifting", "--posterior", "none.json"], "none.json is no result of a fit"),
        (["benchmark", "lifting", "--methods", ","], "--methods ',' holds an empty name"),
    ],
)
def test_what_cannot_be_used_is_refused_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert main([*arguments, "--out", str(tmp_path / "run")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_tasks_lists_them_with_success_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tasks", "--json"]) == 0
    listed = {row["task"]: row for row in json.loads(capsys.readouterr().out)}
    assert {"lifting", "lifting:paper", "following", "separating", "folding_l", "folding_u"} <= set(listed)
    assert all(row["success"] for row in listed.values())
