"""The circle in one command: optimise a task, replay the motion on a robot, and where its readings part from the
prediction diagnose the recording, amend the rig, and optimise again.

    python -m thinshell_ros.closed_loop TASK --out FOLDER --rounds 3

The robot is whatever takes ``target_pose`` in the namespace ``--namespace``: a controller, or with ``--simulated RIG``
a ``sim_node`` of a rig that conceals something (``launch/closed_loop.launch.py``), which begins each round with fresh
bodies and stands still in between. Each round is a folder with its task, motion, bag, diagnosis and rig.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from sim_core.errors import ConfigError, WorkerError
from sim_core.rigs import load_rig, rig_to_yaml
from sim_core.rigs.load import find_config
from sim_core.rigs.yamlfile import read_mapping
from sim_core.tasks import TaskRollouts, load_task
from thinshell_ros.command import command
from thinshell_ros.replay_once import Replayed, Robot

Step = Callable[[Sequence[str]], None]
"""Runs a ``thinshell`` command; raises ``WorkerError`` where it fails."""


@dataclass(frozen=True)
class Round:
    """``reward``: of the motion by the rig of the round; ``achieved``: on the rig of a simulated robot, None on others;
    ``watch``: of its replay; ``verdict``, ``effects``: of the diagnosis, '' and none where there was none to make."""

    number: int
    reward: float
    achieved: float | None
    state: str
    watch: str
    verdict: str = ""
    effects: tuple[str, ...] = ()


def thinshell(words: Sequence[str]) -> None:
    """Run a ``thinshell`` command in a process of its own. Exit code 4 is a result with a large misfit."""
    code = subprocess.run([sys.executable, "-m", "sysid", *words], check=False).returncode
    if code not in (0, 4):
        raise WorkerError(f"thinshell {' '.join(words)} ended with code {code}.", "See what it says above.")


def reward_of(task: str, motion: Path) -> float:
    """Reward of the motion in the folder of an optimisation, on the rig of a task; NaN where it ends early."""
    action = np.array(json.loads((motion / "result.json").read_text())["action"])
    return TaskRollouts(load_task(task)).outcome(action).reward


def close_loop(
    task: str,
    out: Path,
    rounds: int,
    budget: int,
    replay: Callable[[Path, Path, Path], Replayed],
    step: Step = thinshell,
    on_round: Callable[[Round], None] = lambda done: None,
    simulated: str = "",
) -> list[Round]:
    """Go round until a replay is as predicted, or so many times. ``replay``: takes trajectory, rig and the bag to make;
    ``simulated``: the rig of a simulated robot.

    Raises:
        ThinshellError: a step failed, or a replay was aborted.
    """
    robot = rig_to_yaml(load_rig(simulated)) if simulated else ""
    first = rig_to_yaml(load_task(task).rig)
    out.mkdir(parents=True, exist_ok=False)
    given_rig = rig = out / "rig.yaml"
    rig.write_text(first)
    if robot:
        (out / "robot.yaml").write_text(robot)
    stem, colon, variant = task.rpartition(":") if ":" in task else (task, "", "")
    given = read_mapping(find_config(stem, "tasks"))

    def written(path: Path, on: Path) -> str:
        """The task on a rig, its target that of the first round."""
        path.write_text(yaml.safe_dump({**given, "rig": str(on), "target_rig": str(given_rig)}, sort_keys=False))
        return f"{path}{colon}{variant}"

    done: list[Round] = []
    for number in range(1, rounds + 1):
        here = out / f"round_{number}"
        here.mkdir()
        on_rig = written(here / "task.yaml", rig)
        step(["optimise", on_rig, "--budget", str(budget), "--workers", "1", "--out", str(here / "motion")])
        trajectory = here / "motion" / "trajectory.json"
        reward = float(json.loads(trajectory.read_text())["provenance"]["reward"])
        achieved = reward_of(written(here / "robot_task.yaml", out / "robot.yaml"), here / "motion") if robot else None
        ended = replay(trajectory, rig, here / "bag")
        now = Round(number, reward, achieved, ended.state, ended.watch)
        if ended.state != "succeeded":
            raise WorkerError(f"The replay of round {number} ended as {ended.state}: {ended.detail}", "See its bag.")
        if ended.watch != "as predicted":
            step(["diagnose", str(rig), str(here / "bag"), "--out", str(here / "diagnosis")])
            found = json.loads((here / "diagnosis" / "diagnosis.json").read_text())
            now = replace(now, verdict=found["verdict"], effects=tuple(e["name"] for e in found["effects"]))
            rig = here / "diagnosis" / "amended_rig.yaml"
            load_rig(str(rig))
        done.append(now)
        on_round(now)
        (out / "rounds.json").write_text(json.dumps([asdict(one) for one in done], indent=1) + "\n")
        if not now.verdict:
            break
    return done


@command
def main(arguments: Sequence[str]) -> None:
    """Go round, and print a line for each round."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0] if __doc__ else "")
    parser.add_argument("task", help="task: a name, NAME:VARIANT or a file")
    parser.add_argument("--out", type=Path, required=True, help="new folder")
    parser.add_argument("--rounds", type=int, default=3, help="most rounds")
    parser.add_argument("--budget", type=int, default=50, help="rollouts of each optimisation")
    parser.add_argument("--namespace", default="", help="of the robot's topics")
    parser.add_argument(
        "--simulated", metavar="RIG", default="", help="the robot is a sim_node of this rig that publishes /clock"
    )
    given = parser.parse_args(arguments)

    def report(done: Round) -> None:
        found = f"; {done.verdict}: {', '.join(done.effects) or 'no effect'}" if done.verdict else ""
        there = "" if done.achieved is None else f", {done.achieved:.4g} on the robot"
        print(f"Round {done.number}: reward {done.reward:.4g}{there}, {done.state}, {done.watch}{found}", flush=True)

    if given.out.exists():
        raise ConfigError(f"{given.out} exists already.", "Choose another folder, or move it away first.")
    with Robot(given.namespace, bool(given.simulated)) as robot:
        out, replay = given.out.absolute(), robot.replay
        close_loop(given.task, out, given.rounds, given.budget, replay, on_round=report, simulated=given.simulated)


if __name__ == "__main__":
    sys.exit(main())
