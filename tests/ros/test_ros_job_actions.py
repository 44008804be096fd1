"""Jobs as actions of the interface package, on a node that runs as a process of its own. The package is built with
``python interfaces/build_with_wheels.py FOLDER``, or by ``colcon build`` on a machine with ROS."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ros_live import WAIT_S, Client, NodeProcess, group
from small_task import small_task

from sim_core.rigs import list_parameters, load_rig, with_parameters
from sim_core.rigs.motion import load_experiment
from sysid.simulate import simulate_to_bag

pytestmark = [pytest.mark.ros, pytest.mark.slow]

DATA = Path(__file__).parent / "data"
RIG = DATA / "pull_coarse.yaml"
JOB_S = 600.0


class Goal:
    """A goal that was sent; its feedback, and its result once it has ended."""

    def __init__(self, client: Client, kind: str, **fields: Any) -> None:
        from rclpy.action import ActionClient

        actions = pytest.importorskip("thinshell_interfaces.action", reason="thinshell_interfaces is not built")
        self._client, kinds = client, {"fit": "Fit", "diagnose": "Diagnose", "plan": "Plan", "optimise": "Optimise"}
        action = getattr(actions, kinds[kind])
        self.feedback: list[Any] = []
        self._server = ActionClient(client.node, action, f"tactile_sysid/{kind}")
        client.wait(self._server.server_is_ready, f"no action {kind}")
        client.spin(0.5)
        sent = self._server.send_goal_async(action.Goal(**fields), lambda said: self.feedback.append(said.feedback))
        client.wait(sent.done, "no answer to the goal", WAIT_S)
        self.handle = sent.result()
        assert self.handle.accepted
        self._result = self.handle.get_result_async()

    def doing(self, words: str) -> Any:
        """The feedback that says so first."""
        return self._client.wait(
            lambda: next((said for said in self.feedback if words in said.doing), None), f"never: {words}", JOB_S
        )

    def cancel(self) -> None:
        asked = self.handle.cancel_goal_async()
        self._client.wait(asked.done, "no answer to the cancel", WAIT_S)

    def end(self) -> tuple[int, Any]:
        """Status and result."""
        self._client.wait(self._result.done, "the goal does not end", JOB_S)
        done = self._result.result()
        self._server.destroy()
        return done.status, done.result


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recorded pull of a strip that is stiffer than the rig says, and a small task."""
    path = tmp_path_factory.mktemp("jobs")
    rig = with_parameters(load_rig(RIG), {"strip.E_pa": 4.4e9})
    simulate_to_bag(rig, load_experiment(DATA / "short_pull.yaml"), path / "pull", seed=1)
    small_task(path)
    return path


@pytest.fixture(scope="module")
def node(ros: None, folder: Path) -> Iterator[NodeProcess]:
    pytest.importorskip("thinshell_interfaces.action", reason="thinshell_interfaces is not built")
    given = {"output_dir": folder / "out", "fit.nuisance": "none"}
    with NodeProcess("sysid_node", folder / "output", rig=RIG, **given) as node:
        yield node


@pytest.fixture
def client(node: NodeProcess) -> Iterator[Client]:
    client = Client("asker")
    yield client
    client.node.destroy_node()


def test_a_fit_tells_how_far_it_is_and_what_it_found(client: Client, folder: Path) -> None:
    from action_msgs.msg import GoalStatus

    goal = Goal(client, "fit", bag_uri=[str(folder / "pull")], parameters=["strip.E"])
    goal.doing("")
    assert (goal.feedback[0].doing, goal.feedback[0].evaluations) == ("starting", 0), "from the first second on"
    assert math.isnan(goal.feedback[0].loss)
    refused = Goal(client, "plan", experiments=[str(DATA / "short_pull.yaml")])
    status, result = refused.end()
    assert status == GoalStatus.STATUS_ABORTED and "is running" in result.sentence
    status, result = goal.end()
    assert status == GoalStatus.STATUS_SUCCEEDED, result.sentence
    assert list(result.names) == ["strip.E_pa"] and result.converged and result.explained
    assert abs(result.estimate[0] - 4.4e9) < 4.0 * result.std[0]
    assert json.loads(result.json)["output_dir"] == result.output_dir
    shares = [said.share for said in goal.feedback]
    assert shares == sorted(shares) and shares[-1] == 1.0
    evaluated = [said for said in goal.feedback if said.evaluations]
    assert evaluated and list(evaluated[-1].names) == ["strip.E_pa"]


def test_a_fit_is_cancelled_and_goes_on_where_it_was(client: Client, node: NodeProcess, folder: Path) -> None:
    from action_msgs.msg import GoalStatus

    goal = Goal(client, "fit", bag_uri=[str(folder / "pull")], parameters=["strip.E"], max_iterations=90)
    begun = client.wait(lambda: next((f for f in goal.feedback if f.evaluations), None), "no evaluation", JOB_S)
    worker = node.spawned()
    goal.cancel()
    status, result = goal.end()
    assert status == GoalStatus.STATUS_CANCELED and not group(worker)
    assert "~/resume" in result.sentence
    on = Goal(client, "fit", resume=result.job_id)
    status, result = on.end()
    assert status == GoalStatus.STATUS_SUCCEEDED, result.sentence
    first = next(said for said in on.feedback if said.evaluations)
    assert first.loss <= begun.loss * (1.0 + 1e-9), "it begins at the best that was found"
    used = json.loads((Path(result.output_dir) / "fit.json").read_text())["evaluations"]
    assert used < 90


def test_what_cannot_be_met_is_aborted_and_says_why(client: Client) -> None:
    from action_msgs.msg import GoalStatus

    for kind, fields, words in (
        ("fit", {"bag_uri": ["/nowhere"], "parameters": ["strip.E"]}, "/nowhere"),
        ("fit", {"resume": "fit_of_yesterday"}, "fit_of_yesterday is no job"),
        ("diagnose", {}, "bag_uri"),
        ("plan", {"experiments": ["no_such"]}, "no_such"),
        ("optimise", {"task": "no_such"}, "no_such"),
        ("optimise", {"task": "lifting", "resume": "optimisation_of_yesterday"}, "no search in"),
    ):
        status, result = Goal(client, kind, **fields).end()
        assert status == GoalStatus.STATUS_ABORTED and words in result.sentence, result.sentence


def test_experiments_are_planned(client: Client) -> None:
    from action_msgs.msg import GoalStatus

    goal = Goal(client, "plan", experiments=[str(DATA / "short_pull.yaml")], parameters=["strip.E"])
    status, result = goal.end()
    assert status == GoalStatus.STATUS_SUCCEEDED, result.sentence
    assert list(result.names) == ["strip.E_pa"] and list(result.determined) == [True]
    value = next(p.value for p in list_parameters(load_rig(RIG)) if p.name == "strip.E_pa")
    assert value is not None and result.lower[0] < value < result.upper[0]


def test_a_search_is_cancelled_and_goes_on_in_its_folder_also_in_another_node(
    client: Client, node: NodeProcess, folder: Path
) -> None:
    """The log has the rollouts that were made, which are not made again."""
    from action_msgs.msg import GoalStatus

    asked = {"task": str(folder / "small.yaml"), "method": "cem", "budget": 40, "seed": 3}
    goal = Goal(client, "optimise", **asked)
    goal.doing("2 rollouts")
    goal.cancel()
    status, cancelled = goal.end()
    assert status == GoalStatus.STATUS_CANCELED, cancelled.sentence
    log = folder / "out" / cancelled.job_id / "evaluations.jsonl"
    before = log.read_text()
    assert before.count("\n") >= 2
    other = Goal(client, "optimise", **asked, resume=cancelled.job_id)
    status, result = other.end()
    assert status == GoalStatus.STATUS_SUCCEEDED, result.sentence
    assert log.read_text().startswith(before.rpartition("\n")[0])
    assert result.job_id == cancelled.job_id and Path(result.trajectory).is_file()
    assert json.loads(result.json)["rollouts"] == 40
