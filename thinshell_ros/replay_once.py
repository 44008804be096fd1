"""One replay from its beginning to its end: configure, activate, execute, wait, retract.

    python -m thinshell_ros.replay_once TRAJECTORY --rig RIG --bag BAG --namespace /robot

The robot is whatever takes ``target_pose`` in the namespace: a controller, or with ``--simulated`` a ``sim_node`` that
publishes /clock, whose bodies are fresh in each replay and which stands still before and after it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim_core.errors import ConfigError, WorkerError
from thinshell_ros.command import command
from thinshell_ros.node_client import SERVICE_S, NodeClient

REPLAY_S = 3600.0
"""Longest time [s] for a replay, which waits for slow physics."""

NODE, SIMULATOR, CLOCK = "trajectory_deploy", "thinshell_sim", "/clock"


@dataclass(frozen=True)
class Replayed:
    """How a replay ended: its state, why it was aborted, and what the watch says, which is 'as predicted' or where
    readings part from that."""

    state: str
    detail: str
    watch: str


class Robot:
    """Replays on a robot by ``replay_node``, a process of its own for each replay. A context manager.

    ``simulated``: the robot is a ``sim_node`` that publishes ``clock``. Its bodies are fresh in each replay, and in
    between it stands still, so that its physics takes no time from what else there is to do.
    """

    def __init__(self, namespace: str, simulated: bool, clock: str = CLOCK) -> None:
        self._place, self._simulated, self._clock = namespace.rstrip("/"), simulated, clock
        self._client = NodeClient("replay_operator", self._place)

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, *given: object) -> None:
        self._client.__exit__(*given)

    def replay(self, trajectory: Path, rig: Path | str, bag: Path) -> Replayed:
        """Configure, activate, execute, and wait for the end; the bag is finished then.

        Raises:
            WorkerError: the node refuses the motion, ends, or does not respond.
        """
        if not self._simulated:
            return self._replay(trajectory, rig, bag)
        from std_srvs.srv import SetBool, Trigger

        self._simulator(Trigger, "reset", Trigger.Request())
        self._simulator(SetBool, "pause", SetBool.Request(data=False))
        try:
            return self._replay(trajectory, rig, bag)
        finally:
            self._simulator(SetBool, "pause", SetBool.Request(data=True))

    def _simulator(self, kind: Any, name: str, request: Any) -> None:
        """Ask the simulated robot, which may still be building its scene."""
        asked = time.monotonic()
        while not (answer := self._client.ask(kind, f"{SIMULATOR}/{name}", request)).success:
            if time.monotonic() - asked > SERVICE_S:
                raise WorkerError(f"The simulated robot does not {name}: {answer.message}", "See what it says above.")
            time.sleep(0.5)

    def _replay(self, trajectory: Path, rig: Path | str, bag: Path) -> Replayed:
        from diagnostic_msgs.msg import DiagnosticStatus
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        from thinshell_ros.qos import LATCHED

        client = self._client
        given = {"trajectory_uri": trajectory, "rig": rig, "dry_run": "false", "record_uri": bag}
        words = [sys.executable, "-m", "thinshell_ros.replay_node", "--ros-args", "-r", f"__ns:={self._place or '/'}"]
        words += ["-r", f"{CLOCK}:={self._clock}"] if self._clock != CLOCK else []
        for name, value in {**given, "use_sim_time": str(self._simulated).lower()}.items():
            words += ["-p", f"{name}:={value}"]
        statuses: list[Any] = []
        heard = client.node.create_subscription(DiagnosticStatus, f"{NODE}/status", statuses.append, LATCHED)
        process = subprocess.Popen(words)

        def alive() -> None:
            if process.poll() is not None:
                raise WorkerError(f"The replay node ended with code {process.returncode}.", "See what it says above.")

        try:
            for number in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
                request = ChangeState.Request(transition=Transition(id=number))
                if not client.ask(ChangeState, f"{NODE}/change_state", request, alive).success:
                    raise WorkerError("The replay node refused the motion.", "See what it says above.")
            asked = time.monotonic()
            while not (begun := client.trigger(f"{NODE}/execute", alive)).success:
                if time.monotonic() - asked > SERVICE_S:
                    raise WorkerError(f"The replay does not begin: {begun.message}", "See what it says above.")
                time.sleep(0.5)  # readings and the recorder may not be there yet
            over = ("succeeded", "aborted")
            client.until(lambda: statuses[-1].message in over, "end of the replay", REPLAY_S, alive)
            values = {pair.key: pair.value for pair in statuses[-1].values}
            ended = Replayed(statuses[-1].message, values["detail"], values["watch"])
            if client.trigger(f"{NODE}/retract", alive).success:
                back = ("retracted", "aborted")
                client.until(lambda: statuses[-1].message in back, "way back", REPLAY_S, alive)
            return ended
        finally:
            process.terminate()
            process.wait(SERVICE_S)
            client.node.destroy_subscription(heard)


@command
def main(arguments: Sequence[str]) -> None:
    """Replay, and print how it ended and what the watch says."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0] if __doc__ else "")
    parser.add_argument("trajectory", type=Path, help="file of a trajectory")
    parser.add_argument("--rig", required=True, help="rig that the motion is for, and whose topics are recorded")
    parser.add_argument("--bag", type=Path, required=True, help="recording to make")
    parser.add_argument("--namespace", default="", help="of the robot's topics")
    parser.add_argument("--simulated", action="store_true", help="the robot is a sim_node that publishes the clock")
    parser.add_argument("--clock", default=CLOCK, metavar="TOPIC", help="simulated time, where it is not /clock")
    given = parser.parse_args(arguments)
    if not given.trajectory.is_file():
        raise ConfigError(f"There is no file {given.trajectory}.", "Name the trajectory.json of an optimisation.")
    if given.bag.exists():
        raise ConfigError(f"{given.bag} exists already.", "Choose another folder, or move it away first.")
    with Robot(given.namespace, given.simulated, given.clock) as robot:
        ended = robot.replay(given.trajectory, given.rig, given.bag.absolute())
    if ended.state != "succeeded":
        raise WorkerError(f"The replay ended as {ended.state}: {ended.detail}", f"See {given.bag}.")
    print(f"The replay succeeded. Watch: {ended.watch}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
