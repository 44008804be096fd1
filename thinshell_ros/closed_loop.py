"""The circle in one command: optimise a task, replay the motion on a robot, and where its readings part from the
prediction diagnose the recording, amend the rig, and optimise again.

    python -m thinshell_ros.closed_loop TASK --out FOLDER --rounds 3

The robot is whatever takes ``target_pose`` in the namespace ``--namespace``: a controller, or a ``sim_node`` that
conceals something (``launch/closed_loop.launch.py``). Each round is a folder with its task, motion, bag, diagnosis and
rig.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from sim_core.errors import ConfigError, ThinshellError, WorkerError
from sim_core.rigs import load_rig, rig_to_yaml
from sim_core.rigs.load import find_config
from sim_core.rigs.yamlfile import read_mapping
from sim_core.tasks import load_task

SERVICE_S, REPLAY_S = 120.0, 3600.0
"""Longest time for an answer of the replay node, and for a replay, which waits for slow physics [s]."""

NODE = "trajectory_deploy"

Step = Callable[[Sequence[str]], None]
"""Runs a ``thinshell`` command; raises ``WorkerError`` where it fails."""


@dataclass(frozen=True)
class Replayed:
    """How a replay ended: its state, why it was aborted, and what the watch says, which is 'as predicted' or where
    readings part from that."""

    state: str
    detail: str
    watch: str


@dataclass(frozen=True)
class Round:
    """``reward``: of the motion by the rig of the round; ``watch``: of its replay; ``verdict``, ``effects``: of the
    diagnosis, '' and none where there was none to make."""

    number: int
    reward: float
    state: str
    watch: str
    verdict: str = ""
    effects: tuple[str, ...] = ()


def thinshell(words: Sequence[str]) -> None:
    """Run a ``thinshell`` command in a process of its own. Exit code 4 is a result with a large misfit."""
    code = subprocess.run([sys.executable, "-m", "sysid", *words], check=False).returncode
    if code not in (0, 4):
        raise WorkerError(f"thinshell {' '.join(words)} ended with code {code}.", "See what it says above.")


def close_loop(
    task: str,
    out: Path,
    rounds: int,
    budget: int,
    replay: Callable[[Path, Path, Path], Replayed],
    step: Step = thinshell,
    on_round: Callable[[Round], None] = lambda done: None,
) -> list[Round]:
    """Go round until a replay is as predicted, or so many times. ``replay``: takes trajectory, rig and the bag to make.

    Raises:
        ThinshellError: a step failed, or a replay was aborted.
    """
    out.mkdir(parents=True, exist_ok=False)
    rig = out / "rig.yaml"
    rig.write_text(rig_to_yaml(load_task(task).rig))
    stem, colon, variant = task.rpartition(":") if ":" in task else (task, "", "")
    given = read_mapping(find_config(stem, "tasks"))
    done: list[Round] = []
    for number in range(1, rounds + 1):
        here = out / f"round_{number}"
        here.mkdir()
        (here / "task.yaml").write_text(yaml.safe_dump({**given, "rig": str(rig)}, sort_keys=False))
        step(
            [
                "optimise",
                f"{here / 'task.yaml'}{colon}{variant}",
                "--budget",
                str(budget),
                "--workers",
                "1",
                "--out",
                str(here / "motion"),
            ]
        )
        trajectory = here / "motion" / "trajectory.json"
        reward = float(json.loads(trajectory.read_text())["provenance"]["reward"])
        ended = replay(trajectory, rig, here / "bag")
        now = Round(number, reward, ended.state, ended.watch)
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


class Robot:
    """Replays on a robot by ``replay_node``, a process of its own for each replay. A context manager."""

    def __init__(self, namespace: str, simulated_time: bool) -> None:
        import rclpy

        rclpy.init()
        self._place, self._simulated = namespace.rstrip("/"), simulated_time
        self._node = rclpy.create_node("closed_loop", namespace=namespace or "/")

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, *_: object) -> None:
        import rclpy

        self._node.destroy_node()
        rclpy.try_shutdown()

    def replay(self, trajectory: Path, rig: Path, bag: Path) -> Replayed:
        """Configure, activate, execute, and wait for the end; the bag is finished then."""
        from diagnostic_msgs.msg import DiagnosticStatus
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState
        from std_srvs.srv import Trigger

        from thinshell_ros.qos import LATCHED

        given = {"trajectory_uri": trajectory, "rig": rig, "dry_run": "false", "record_uri": bag}
        words = [sys.executable, "-m", "thinshell_ros.replay_node", "--ros-args", "-r", f"__ns:={self._place or '/'}"]
        for name, value in {**given, "use_sim_time": str(self._simulated).lower()}.items():
            words += ["-p", f"{name}:={value}"]
        statuses: list[Any] = []
        heard = self._node.create_subscription(DiagnosticStatus, f"{NODE}/status", statuses.append, LATCHED)
        process = subprocess.Popen(words)
        try:
            for number in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
                request = ChangeState.Request(transition=Transition(id=number))
                if not self._ask(ChangeState, "change_state", request, process).success:
                    raise WorkerError("The replay node refused the motion.", "See what it says above.")
            asked = time.monotonic()
            while not (begun := self._ask(Trigger, "execute", Trigger.Request(), process)).success:
                if time.monotonic() - asked > SERVICE_S:
                    raise WorkerError(f"The replay does not begin: {begun.message}", "See what it says above.")
                time.sleep(0.5)  # readings and the recorder may not be there yet
            self._until(lambda: statuses[-1].message in ("succeeded", "aborted"), process, "end of the replay")
            values = {pair.key: pair.value for pair in statuses[-1].values}
            ended = Replayed(statuses[-1].message, values["detail"], values["watch"])
            if self._ask(Trigger, "retract", Trigger.Request(), process).success:
                self._until(lambda: statuses[-1].message in ("retracted", "aborted"), process, "way back")
            return ended
        finally:
            process.terminate()
            process.wait(SERVICE_S)
            self._node.destroy_subscription(heard)

    def _ask(self, kind: Any, name: str, request: Any, process: subprocess.Popen[bytes]) -> Any:
        client = self._node.create_client(kind, f"{NODE}/{name}")
        try:
            self._until(client.service_is_ready, process, f"service {name} of the replay node", SERVICE_S)
            future = client.call_async(request)
            self._until(future.done, process, f"answer of {name}", SERVICE_S)
            return future.result()
        finally:
            self._node.destroy_client(client)

    def _until(
        self, condition: Callable[[], bool], process: subprocess.Popen[bytes], what: str, most_s: float = REPLAY_S
    ) -> None:
        import rclpy

        end = time.monotonic() + most_s
        while not condition():
            rclpy.spin_once(self._node, timeout_sec=0.1)
            if process.poll() is not None:
                raise WorkerError(f"The replay node ended with code {process.returncode}.", "See what it says above.")
            if time.monotonic() > end:
                raise WorkerError(f"There is no {what} after {most_s:g} s.", "See what the nodes say above.")


def main(words: Sequence[str] | None = None) -> int:
    """Go round, and print a line for each round."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0] if __doc__ else "")
    parser.add_argument("task", help="task: a name, NAME:VARIANT or a file")
    parser.add_argument("--out", type=Path, required=True, help="new folder")
    parser.add_argument("--rounds", type=int, default=3, help="most rounds")
    parser.add_argument("--budget", type=int, default=50, help="rollouts of each optimisation")
    parser.add_argument("--namespace", default="", help="of the robot's topics")
    parser.add_argument("--simulated-time", action="store_true", help="the robot publishes /clock")
    given = parser.parse_args(words)

    def tell(done: Round) -> None:
        found = f"; {done.verdict}: {', '.join(done.effects) or 'no effect'}" if done.verdict else ""
        print(f"Round {done.number}: reward {done.reward:.4g}, {done.state}, {done.watch}{found}", flush=True)

    try:
        if given.out.exists():
            raise ConfigError(f"{given.out} exists already.", "Choose another folder, or move it away first.")
        with Robot(given.namespace, given.simulated_time) as robot:
            close_loop(given.task, given.out.absolute(), given.rounds, given.budget, robot.replay, on_round=tell)
    except ThinshellError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
