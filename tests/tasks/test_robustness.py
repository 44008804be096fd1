"""A motion over rigs that are drawn from a fit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from small_task import TASK, small_task

from sim_core.optimise.robustness import Robustness, robustness
from sim_core.tasks import TaskRollouts
from sysid.cli.app import main

PRESS = np.tile([0.0, 0.0, -1.0, 0.0, 0.0, 0.0], 2)


def test_each_rig_is_rolled_out_with_its_own_numbers(tmp_path: Path) -> None:
    made = small_task(tmp_path, text=TASK.replace(", target_seed: 3", ""))
    rewards = {}
    for modulus in (1.5e9, 2.0e9, 3.0e9):
        rollouts = TaskRollouts(made)
        rollouts.use({"card.E_pa": modulus})
        rewards[modulus] = rollouts.outcome(PRESS).reward
    found = robustness(made, PRESS, [{"card.E_pa": m} for m in rewards])
    assert found.rewards == pytest.approx(list(rewards.values()), rel=1e-12)
    assert len(set(rewards.values())) == 3


def test_successes_have_the_interval_of_clopper_and_pearson() -> None:
    """Of n = 10 without a failure the share is above 0.025^(1/10)."""
    low, high = Robustness(np.ones(10), ((),) * 10).interval
    assert (low, high) == (pytest.approx(0.025**0.1), 1.0)
    some = Robustness(np.ones(3), (("it bears 1 N",), (), ("it bears 2 N",)))
    assert some.successes == 1 and some.common_failure == "it bears 1 N"


def test_the_command_compares_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small_task(tmp_path, text=TASK.replace("success: 0.05", "success: -9.0"))
    runs = [str(tmp_path / name) for name in ("one", "other")]
    for seed, run in enumerate(runs):
        command = ["optimise", str(tmp_path / "small.yaml"), "--method", "adam", "--seed", str(seed), "--budget", "1"]
        assert main([*command, "--workers", "1", "--out", run]) == 0
    fit = {"estimates": [{"name": "card.E_pa", "value": 2e9, "sd": 0.1, "log": True}], "correlation": [[1.0]]}
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    capsys.readouterr()
    assert main(["robust", *runs, "--posterior", str(tmp_path / "fit.json"), "--draws", "2"]) == 0
    printed = capsys.readouterr().out
    assert all(f"{run}: 2 of 2 successes (95 %: 16 to 100 %)" in printed for run in runs)
    assert main(["robust", str(tmp_path), "--posterior", str(tmp_path / "fit.json")]) == 2
    assert "is no folder of a search" in capsys.readouterr().err
