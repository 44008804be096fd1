"""Policies: a training goes on where it was ended, and trials compare with replays and searches."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from small_task import small_task, touch_sensor

from sim_core.errors import ConfigError
from sysid.cli.app import main

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from sim_core.policies.train import Training, load_policy, read_progress, train  # noqa: E402
from sim_core.policies.trial import materials, read_trials, trials  # noqa: E402

VARY = {"card.E_pa": (1.5e9, 2.5e9)}
AROUND = tuple(float(x) for x in 0.05 * np.arange(12.0))


def training(folder: Path, algorithm: str, reward: str = "folding", **other: object) -> Training:
    small_task(folder, reward)
    rig = folder / "rig.yaml"
    rig.write_text(rig.read_text() + touch_sensor(0.001, 1e-5))
    task = str(folder / "small.yaml")
    return Training(task, algorithm, VARY, envs=2, episodes=2, around=AROUND, reach=0.5, **other)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["sac", "ppo"])
def test_a_training_that_was_ended_goes_on_as_if_it_had_not_been(tmp_path: Path, algorithm: str) -> None:
    wanted = training(tmp_path, algorithm)
    whole = train(wanted, 2, tmp_path / "whole")
    train(wanted, 1, tmp_path / "parts")
    with (tmp_path / "parts/episodes.jsonl").open("a") as log:
        log.write("of a round that was cut off\n")
    parts = train(wanted, 2, tmp_path / "parts", workers=2)
    assert (whole.rounds, whole.decisions, whole.lines) == (parts.rounds, parts.decisions, parts.lines) == (2, 16, 8)
    ours, theirs = (load_policy(tmp_path / name).model.policy.state_dict() for name in ("whole", "parts"))
    first = load_policy(tmp_path / "whole").model.num_timesteps
    assert first == 8 and all(torch.equal(ours[key], theirs[key]) for key in ours)
    episodes = (tmp_path / "whole/episodes.jsonl").read_text()
    assert episodes == (tmp_path / "parts/episodes.jsonl").read_text() and len(episodes.splitlines()) == 8
    drawn = [json.loads(line)["parameters"]["card.E_pa"] for line in episodes.splitlines()]
    assert len(set(drawn)) == 8 and 1.5e9 <= min(drawn) and max(drawn) <= 2.5e9
    assert [path.name for path in (tmp_path / "whole").glob("checkpoint_*")] == ["checkpoint_2"]


@pytest.mark.slow
def test_another_training_is_refused_and_another_seed_learns_another_policy(tmp_path: Path) -> None:
    wanted = training(tmp_path, "ppo")
    train(wanted, 1, tmp_path / "one")
    with pytest.raises(ConfigError, match=r"one has another training.*new folder"):
        train(training(tmp_path, "ppo", seed=1), 1, tmp_path / "one")
    train(training(tmp_path, "ppo", seed=1), 1, tmp_path / "other")
    seen = np.zeros(3 + 3 + 6 + 1, dtype=np.float32)
    decisions = [load_policy(tmp_path / name).decision(seen).tolist() for name in ("one", "other")]
    assert decisions[0] != decisions[1]


@pytest.mark.slow
def test_trials_are_of_other_materials_and_are_made_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wanted = training(tmp_path, "ppo", "forming")
    train(wanted, 1, tmp_path / "run")
    assert main(["policy", "test", str(tmp_path / "run"), "--materials", "3", "--searches", "1", "--budget", "4"]) == 0
    printed = capsys.readouterr().out
    path = tmp_path / "run/trials_1.jsonl"
    found = read_trials(path)
    assert [t.parameters for t in found] == materials(wanted, 3, 1)
    assert found[0].searched == 4 and not found[0].found and found[1].searched == -1
    assert "policy: 0 of 3 successes" in printed and "replay: 0 of 3" in printed and "search: 0 of 1" in printed
    assert "its motion on the rig's file: 0 of 3" in printed
    higher = sum(t.learnt_reward > t.replayed_reward for t in found)
    assert printed.splitlines()[4].endswith(f"the policy has the higher reward on {higher} of 3")
    assert len({t.open_loop_reward for t in found}) == 3
    assert all(t.open_loop_reward != t.learnt_reward != t.replayed_reward for t in found)
    assert all("less than 0.05" in t.learnt[0] and "less than 0.05" in t.replayed[0] for t in found)
    rewards = {t.replayed_reward for t in found}
    assert len(rewards) == 3, "the same motion on other materials"
    before = path.read_bytes()
    path.write_bytes(before[:-5])
    policy = load_policy(tmp_path / "run")
    assert trials(policy, 3, path, searches=1, budget=4, workers=2)[:2] == found[:2]
    assert read_trials(path)[2].parameters == found[2].parameters
    with pytest.raises(ConfigError, match=r"has trials of other materials"):
        trials(policy, 3, path, seed=2, searches=1, budget=4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "balancing", "--out", "x"], "balancing has no family of materials. Give one or more with --vary."),
        (
            ["train", "folding_u", "--algorithm", "sacc", "--out", "x"],
            "There is no algorithm 'sacc'. Did you mean 'sac'?",
        ),
        (["train", "folding_u", "--around", "nowhere", "--out", "x"], "nowhere is no folder of a search"),
        (["train", "folding_u", "--reach", "0", "--out", "x"], "reach is 0, the share of the bounds"),
        (["train", "folding_u", "--observe", "all", "--out", "x"], "--observe is 'all'."),
        (["test", "nowhere"], "nowhere has no policy"),
    ],
)
def test_mistakes_are_reported(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["policy", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_a_training_that_cannot_begin_leaves_no_folder(tmp_path: Path) -> None:
    wanted = replace(training(tmp_path, "sac"), vary={"card.E_pa": (2.5e9, 1.5e9)})
    with pytest.raises(ConfigError, match=r"lower end first"):
        train(wanted, 1, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ['{"rounds"', '{"rounds": 3, "other": 1}', "[1]"])
def test_progress_that_cannot_be_read_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "progress.json").write_text(text)
    with pytest.raises(ConfigError, match=r"progress.json is not of a training.*new folder"):
        read_progress(tmp_path)


def test_a_checkpoint_without_its_files_is_named(tmp_path: Path) -> None:
    wanted, out = training(tmp_path, "sac"), tmp_path / "out"
    (out / "checkpoint_3").mkdir(parents=True)
    about = json.loads(json.dumps({"format": 2, **asdict(wanted)}))
    (out / "policy.json").write_text(json.dumps(about))
    (out / "progress.json").write_text('{"rounds": 3}')
    with pytest.raises(ConfigError, match=r"The checkpoint .*checkpoint_3 cannot be read.*Train anew"):
        load_policy(out)
    with pytest.raises(ConfigError, match=r"The checkpoint .*checkpoint_3 cannot be read.*Train anew"):
        train(wanted, 4, out)
