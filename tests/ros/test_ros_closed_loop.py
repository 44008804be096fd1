"""The circle of optimisation, replay, watch, diagnosis and amendment: its steps."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest
import yaml
from small_task import RIG, TASK, touch_sensor

from sim_core.errors import WorkerError
from sim_core.tasks import load_task
from thinshell_ros.closed_loop import Replayed, Round, close_loop

SENSORS = touch_sensor(2.0e-5, 1.0e-8)
COMPLIANCE = "\n  end_effector_compliance: {compliance_m_per_n: 0.05}"
"""A tenth and more of what the finger moves by: the card pushes back with about 6 N/m."""


def task_file(folder: Path) -> Path:
    """The small task with a rig that has a sensor, at rest in each step; next to it that of the robot."""
    plain = RIG.replace("inertia: true", "inertia: false").replace("friction: 0.4", "friction: 0.05")
    (folder / "rig.yaml").write_text(plain + SENSORS)
    (folder / "robot.yaml").write_text(plain.replace("\neffects:", f"\neffects:{COMPLIANCE}") + SENSORS)
    task = TASK.replace("RIG", str(folder / "rig.yaml")).replace("REWARD", "folding")
    # Slower than in other tests: a robot may be behind by 0.1 s, and what happens within that says nothing.
    slow = task.replace("steps: 8", "steps: 80").replace(
        "step_m: [0.0006, 0.0006, 0.0012]", "step_m: [6e-5, 6e-5, 2e-4]"
    )
    (folder / "small.yaml").write_text(slow.replace("step_deg: [1.0, 1.0, 1.0]", "step_deg: [0.1, 0.1, 0.1]"))
    return folder / "small.yaml"


class Steps:
    """Stands in for the commands: writes what they would, and remembers what was asked."""

    def __init__(self) -> None:
        self.asked: list[list[str]] = []
        self.replayed: list[tuple[str, bool]] = []

    def step(self, words: Sequence[str]) -> None:
        self.asked.append(list(words))
        out = Path(words[-1])
        out.mkdir()
        if words[0] == "optimise":
            made = load_task(words[1])
            reward = "0.25" if "end_effector_compliance" in made.rig.effects else "0.125"
            (out / "trajectory.json").write_text(json.dumps({"provenance": {"reward": reward}}))
        else:
            found = {"verdict": "named", "effects": [{"name": "end_effector_compliance"}]}
            (out / "diagnosis.json").write_text(json.dumps(found))
            (out / "rig.yaml").write_text(Path(words[1]).read_text())
            effect = {"end_effector_compliance": {"compliance_m_per_n": 0.04}}
            (out / "amended_rig.yaml").write_text(yaml.safe_dump({"overlay_of": "rig.yaml", "effects": effect}))

    def replay(self, trajectory: Path, rig: Path, bag: Path) -> Replayed:
        known = "amended" in rig.name
        self.replayed.append((bag.parent.name, known))
        return Replayed("succeeded", "", "as predicted" if known else "At 0.1 s of the trajectory z of the force")


def test_it_goes_round_with_the_amended_rig_until_a_replay_is_as_predicted(tmp_path: Path) -> None:
    steps, reported = Steps(), []
    done = close_loop(str(task_file(tmp_path)), tmp_path / "out", 5, 7, steps.replay, steps.step, reported.append)
    assert [(r.number, r.reward, r.achieved, r.verdict, r.effects) for r in done] == [
        (1, 0.125, None, "named", ("end_effector_compliance",)), (2, 0.25, None, "", ()),
    ]  # fmt: skip
    assert reported == done and steps.replayed == [("round_1", False), ("round_2", True)]
    assert [words[0] for words in steps.asked] == ["optimise", "diagnose", "optimise"]
    assert all(words[words.index("--budget") + 1] == "7" for words in steps.asked if words[0] == "optimise")
    assert [
        Round(**{**r, "effects": tuple(r["effects"])}) for r in json.loads((tmp_path / "out/rounds.json").read_text())
    ] == done


def test_a_replay_that_is_aborted_ends_it_and_a_variant_is_kept(tmp_path: Path) -> None:
    steps = Steps()

    def aborted(trajectory: Path, rig: Path, bag: Path) -> Replayed:
        return Replayed("aborted", "The force on touch is 9 N, at most 1 N is allowed.", "as predicted")

    with pytest.raises(WorkerError, match="round 1 ended as aborted: The force on touch is 9 N"):
        close_loop(f"{task_file(tmp_path)}:real", tmp_path / "out", 5, 7, aborted, steps.step)
    assert steps.asked[0][1].endswith("task.yaml:real")
