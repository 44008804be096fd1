"""The commands that ask nodes for a job, and for another rig."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from ros_live import NodeProcess

from sim_core.errors import ConfigError, WorkerError
from sim_core.rigs import load_rig, with_parameters
from sim_core.rigs.motion import load_experiment
from sysid.simulate import simulate_to_bag
from thinshell_ros.ask import ask, assigned
from thinshell_ros.deploy import deploy
from thinshell_ros.protocol import BACK

pytestmark = pytest.mark.ros

DATA = Path(__file__).parent / "data"
RIG = DATA / "pull_coarse.yaml"
BUILDING = (False, "The scene is still being built. Ask again when it stands.")


class Nodes:
    """Stands in for a client: ``replies`` of services in turn, and what is published while it waits."""

    def __init__(self, replies: list[tuple[bool, str]], published: list[tuple[str, str]] | None = None) -> None:
        self.replies, self.published = replies, list(published or [])
        self.asked: list[str] = []
        self.set: dict[str, str] = {}
        self.heard: list[Callable[[Any], None]] = []
        self.node = SimpleNamespace(create_subscription=lambda kind, topic, take, quality: self.heard.append(take))

    def trigger(self, name: str) -> Any:
        self.asked.append(name)
        success, message = self.replies.pop(0)
        return SimpleNamespace(success=success, message=message)

    def set_parameters(self, node: str, values: dict[str, str]) -> None:
        self.set = values

    def until(self, condition: Callable[[], object], what: str, most_s: float) -> None:
        while not condition():
            job, state = self.published.pop(0)
            values = {"job_id": job, "detail": f"{state} so far", "eta_s": "nan"}
            pairs = [SimpleNamespace(key=key, value=value) for key, value in values.items()]
            self.heard[0](SimpleNamespace(message=state, values=pairs))
            if state == "succeeded":
                self.heard[1](SimpleNamespace(data=json.dumps({"job_id": job, "output_dir": f"jobs/{job}"})))


def test_what_sets_no_parameter_is_refused() -> None:
    assert assigned(["bag_uri=recording", "fit.parameters=[strip.E]", "held_out_uri="]) == {
        "bag_uri": "recording", "fit.parameters": "[strip.E]", "held_out_uri": "",
    }  # fmt: skip
    for word in ("recording", "=recording"):
        with pytest.raises(ConfigError, match=f"'{word}' sets no parameter. Write NAME=VALUE"):
            assigned([word])


def test_the_result_is_that_of_the_job_that_was_asked_for(ros: None) -> None:
    states = [("fit_1", "succeeded"), ("fit_2", "running"), ("fit_2", "succeeded")]
    nodes: Any = Nodes([(True, "fit_2")], states)
    assert ask(nodes, "/there/tactile_sysid", "fit")["output_dir"] == "jobs/fit_2"
    assert nodes.asked == ["/there/tactile_sysid/start"]


@pytest.mark.parametrize(
    ("state", "words"), [("failed", "fit_2 failed: failed so far"), ("cancelled", "fit_2 was cancelled")]
)
def test_a_job_that_does_not_succeed_is_an_error(ros: None, state: str, words: str) -> None:
    nodes: Any = Nodes([(True, "fit_2")], [("fit_2", "running"), ("fit_2", state)])
    with pytest.raises(WorkerError, match=words):
        ask(nodes, "node", "diagnose")


def test_a_job_that_is_refused_is_an_error_in_the_words_of_the_node(ros: None) -> None:
    nodes: Any = Nodes([(False, "There is no recording to fit. Set the parameter bag_uri.")])
    with pytest.raises(ConfigError, match=r"^There is no recording to fit\. Set the parameter bag_uri\.$"):
        ask(nodes, "node", "fit")


def test_a_rig_is_deployed_when_its_scene_is_at_its_start() -> None:
    nodes: Any = Nodes([(True, "The scene of pull is being built."), BUILDING, BUILDING, (True, BACK)])
    deploy(nodes, "/twin/thinshell_sim", str(RIG))
    assert nodes.set == {"rig": str(RIG)} and not nodes.replies
    assert set(nodes.asked) == {"/twin/thinshell_sim/reset"}


@pytest.mark.parametrize(
    ("replies", "words"),
    [
        ([(False, "The rig has other topics.")], "does not take .* The rig has other topics"),
        ([(True, "is being built"), BUILDING, (True, "No equilibrium. It is being started again.")], "No equilibrium"),
    ],
)
def test_a_rig_that_cannot_be_simulated_is_an_error(replies: list[tuple[bool, str]], words: str) -> None:
    nodes: Any = Nodes(replies)
    with pytest.raises((ConfigError, WorkerError), match=words):
        deploy(nodes, "node", str(RIG))


@pytest.mark.slow
def test_a_job_is_followed_and_cancelled_with_the_command(ros: None, tmp_path: Path) -> None:
    rig = with_parameters(load_rig(RIG), {"strip.E_pa": 4.4e9})
    simulate_to_bag(rig, load_experiment(DATA / "short_pull.yaml"), tmp_path / "pull", seed=1)
    words = [sys.executable, "-m", "thinshell_ros.ask", "fit", "fit.parameters=[strip.E]", "fit.nuisance=none"]
    with NodeProcess("sysid_node", tmp_path / "output", rig=RIG, output_dir=tmp_path / "fits"):
        refused = subprocess.run([*words, "fit.seed=many"], capture_output=True, text=True, check=False)
        assert refused.returncode == 2
        assert refused.stderr.startswith("error: /tactile_sysid does not take fit.seed = many: "), refused.stderr

        words += [f"bag_uri={tmp_path / 'pull'}"]
        cancelled = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
        assert cancelled.stderr is not None
        begun = cancelled.stderr.readline()
        cancelled.terminate()
        said = cancelled.stderr.read()
        assert cancelled.wait(60) == 2 and "was cancelled; nothing was written" in said, begun + said
        assert not list((tmp_path / "fits").iterdir())

        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        folder = Path(done.stdout.strip())
        assert folder.parent == tmp_path / "fits" and (folder / "fitted_rig.yaml").is_file()
        assert f"{folder.name}: starting" in done.stderr and f"{folder.name} succeeded" in done.stderr
