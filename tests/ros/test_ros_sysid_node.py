"""The node that fits, as a process of its own, over loopback."""

import json
import os
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from ros_live import WAIT_S, Client, NodeProcess, group

from sim_core.rigs import load_rig, with_parameters
from sim_core.rigs.motion import load_experiment
from sysid.fit import FitOptions
from sysid.simulate import simulate_to_bag
from sysid.workflow import fit_bags

pytestmark = pytest.mark.ros

DATA = Path(__file__).parent / "data"
RIG = DATA / "pull_coarse.yaml"
FIT_S = 300.0
"""A fit may be on a busy machine."""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pull of a strip that is stiffer than the rig says."""
    path = tmp_path_factory.mktemp("bags") / "pull"
    rig = with_parameters(load_rig(RIG), {"strip.E_pa": 4.4e9})
    simulate_to_bag(rig, load_experiment(DATA / "short_pull.yaml"), path, seed=1)
    return path


class Fitter(Client):
    """A client of the node: sets parameters, calls its services, keeps what it publishes."""

    def __init__(self, name: str, bag: str = "") -> None:
        from diagnostic_msgs.msg import DiagnosticStatus
        from std_msgs.msg import Float64MultiArray, String

        super().__init__(name)
        self.bag = bag
        self.statuses = self.listen(DiagnosticStatus, "tactile_sysid/status", latched=True)
        self.estimates = self.listen(Float64MultiArray, "tactile_sysid/parameters_estimate", latched=True)
        self.results = self.listen(String, "tactile_sysid/result", latched=True)

    def set(self, **values: Any) -> None:
        """Set parameters; ``__`` in a name stands for a dot."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        none = Parameter.Type.DOUBLE_ARRAY  # the type of an empty list has to be said
        given = [Parameter(name.replace("__", "."), none if v == [] else None, v) for name, v in values.items()]
        request = SetParameters.Request(parameters=[p.to_parameter_msg() for p in given])
        answer = self.call(SetParameters, "tactile_sysid/set_parameters", request)
        assert all(result.successful for result in answer.results), answer.results

    def ask(self, service: str) -> Any:
        """Response of ``start`` or ``cancel``, which are not asked twice."""
        from std_srvs.srv import Trigger

        client = self.node.create_client(Trigger, f"tactile_sysid/{service}")
        self.wait(client.service_is_ready, f"no service {service}")
        self.spin(0.5)  # the server has to discover the client too
        future = client.call_async(Trigger.Request())
        self.wait(future.done, f"no answer of {service}")
        self.node.destroy_client(client)
        return future.result()

    def doing(self, job: str) -> str:
        """What a job says that it does."""
        return next((values_of(s)["detail"] for s in self.statuses[::-1] if values_of(s)["job_id"] == job), "")

    def until(self, job: str, *states: str) -> Any:
        """The next status of a job that is in one of these states."""

        def wanted() -> Any:
            return next((s for s in self.statuses if values_of(s)["job_id"] == job and s.message in states), None)

        return self.wait(wanted, f"{job} did not become {' or '.join(states)}", FIT_S)


def values_of(status: Any) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


@pytest.fixture(scope="module")
def node(ros: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeProcess]:
    """A node that must end with code 0 when it is interrupted, a fit of its or not, and says no traceback."""
    with NodeProcess("sysid_node", tmp_path_factory.mktemp("node") / "output", rig=RIG) as node:
        yield node


@pytest.fixture
def fitter(node: NodeProcess, bag: Path, tmp_path: Path) -> Iterator[Fitter]:
    """A client of a node that is asked to fit the pull."""
    fitter = Fitter("fitter", str(bag))
    fitter.set(
        bag_uri=str(bag), held_out_uri="", output_dir=str(tmp_path / "fits"), fit__parameters=["strip.E"],
        fit__initial=[], fit__lower=[], fit__upper=[], fit__nuisance="none", fit__max_iterations=200,
        topics__load_cell="wrench", topics__above__marker_tracks="marker_tracks",
    )  # fmt: skip
    yield fitter
    fitter.node.destroy_node()


@pytest.fixture
def running(fitter: Fitter, node: NodeProcess) -> Callable[[], tuple[str, int]]:
    """Function that starts a fit and waits until it simulates; returns its name and its process."""

    def start() -> tuple[str, int]:
        answer = fitter.ask("start")
        assert answer.success, answer.message
        worker = fitter.wait(node.spawned, "no process was started")
        fitter.wait(lambda: fitter.doing(answer.message), "the fit has not begun", FIT_S)
        return answer.message, worker

    return start


def test_numbers_can_be_set_and_emptied_as_they_are_typed(node: NodeProcess, fitter: Fitter) -> None:
    """The types that ``ros2 param set`` makes of [4.0e9], [] and [stiff]."""
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters

    def set_initial(value: ParameterValue) -> Any:
        request = SetParameters.Request(parameters=[Parameter(name="fit.initial", value=value)])
        return fitter.call(SetParameters, "tactile_sysid/set_parameters", request).results[0]

    words = ParameterType.PARAMETER_STRING_ARRAY
    assert set_initial(ParameterValue(type=words, string_array_value=["4.0e9"])).successful
    assert set_initial(ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[4e9])).successful
    assert set_initial(ParameterValue(type=ParameterType.PARAMETER_BOOL_ARRAY)).successful
    refused = set_initial(ParameterValue(type=words, string_array_value=["stiff"]))
    assert not refused.successful
    assert "Give a list of numbers" in refused.reason


def test_a_diagnosis_is_a_job_as_a_fit_is(fitter: Fitter, tmp_path: Path) -> None:
    """The strip is stiffer than the rig says, which its baseline takes up: nothing is missing."""
    fitter.set(bag_uri="")
    refused = fitter.ask("diagnose")
    assert not refused.success and "bag_uri" in refused.message
    fitter.set(bag_uri=fitter.bag)
    answer = fitter.ask("diagnose")
    assert answer.success and answer.message.startswith("diagnosis_"), answer.message
    assert "is running" in fitter.ask("start").message
    done = fitter.until(answer.message, "succeeded", "failed")
    assert done.message == "succeeded", values_of(done)
    assert done.name.endswith("diagnosis"), done.name
    mine = [values_of(s) for s in fitter.statuses if values_of(s)["job_id"] == answer.message]
    assert any("baseline fit" in v["detail"] for v in mine)
    fitter.wait(lambda: fitter.results and answer.message in fitter.results[-1].data, "no result")
    result = json.loads(fitter.results[-1].data)
    assert result["verdict"] == "nothing_missing", result["sentence"]
    assert result["effects"] == []
    low, high = result["ci95"]["strip.E_pa"]
    assert low < 4.4e9 < high
    folder = tmp_path / "fits" / answer.message
    written = {"diagnosis.json", "ledger.npz", "report.html", "rig.yaml", "amended_rig.yaml"}
    assert {p.name for p in folder.iterdir()} == written


def test_a_fit_tells_how_far_it_is_and_gives_what_the_library_gives(
    fitter: Fitter, running: Callable[[], tuple[str, int]], bag: Path, tmp_path: Path
) -> None:
    job, worker = running()
    second = fitter.ask("start")
    assert not second.success
    assert second.message == f"{job} is running. Wait for its end, or call ~/cancel first."
    done = fitter.until(job, "succeeded", "failed")
    assert done.message == "succeeded", values_of(done)
    assert not group(worker)
    mine = [values_of(s) for s in fitter.statuses if values_of(s)["job_id"] == job]
    steps = [int(v["iteration"]) for v in mine]
    assert steps == sorted(steps)
    assert steps[0] == 0 < steps[-1]
    assert any(float(v["eta_s"]) > 0.0 for v in mine[:-1])

    late = Fitter("late")  # gets the last of each
    late.wait(lambda: late.statuses and late.estimates and late.results, "nothing is latched")
    assert late.statuses[-1].message == "succeeded"
    result = json.loads(late.results[-1].data)
    assert result["job_id"] == job
    (dimension,) = late.estimates[-1].layout.dim
    assert dimension.label == "strip.E_pa"
    assert result["estimate"] == {"strip.E_pa": late.estimates[-1].data[0]}
    late.node.destroy_node()

    folder = tmp_path / "fits" / job
    assert sorted(p.name for p in (tmp_path / "fits").rglob("*")) == sorted(
        [job, "fit.json", "fitted_rig.yaml", "report.html"]
    )
    fit_bags(load_rig(RIG), [bag], ["strip.E_pa"], FitOptions(nuisance=("none",)), out=tmp_path / "library")
    here, there = (json.loads((f / "fit.json").read_text()) for f in (folder, tmp_path / "library"))
    assert here["estimates"] == there["estimates"]
    assert result["ci95"]["strip.E_pa"] == there["estimates"][0]["ci95"]
    assert result["loss"] == there["misfit"]
    assert done.level == b"\x00", "OK"
    assert list(result["bag_sha256"].values()) == [there["provenance"]["bags"][0]["sha256"]]


def test_a_fit_ends_at_the_most_iterations_that_it_may_make(fitter: Fitter, tmp_path: Path) -> None:
    fitter.set(fit__max_iterations=2, fit__parameters=["strip.E", "strip.nu"])
    job = fitter.ask("start").message
    done = fitter.until(job, "succeeded", "failed")
    assert done.message == "succeeded", values_of(done)
    mine = [values_of(s) for s in fitter.statuses if values_of(s)["job_id"] == job]
    assert max(int(v["iteration"]) for v in mine) == 2
    assert mine[0]["elapsed_s"] == "0.0", "not that of the fit before"
    assert any(not estimate.data for estimate in fitter.estimates), "nor its estimate"
    assert (values_of(done)["iteration"], values_of(done)["max_iterations"]) == ("2", "2")
    fit = json.loads((tmp_path / "fits" / job / "fit.json").read_text())
    assert fit["evaluations"] == 2 and not fit["converged"]
    assert done.level == b"\x01", "WARN"
    assert values_of(done)["detail"].startswith("The fit did not converge: the evaluations allowed, 2, are used up")
    assert "evaluations allowed, 2, are used up" in fit["message"]


def test_a_cancelled_fit_ends_and_leaves_no_file(
    fitter: Fitter, running: Callable[[], tuple[str, int]], tmp_path: Path
) -> None:
    job, worker = running()
    answer = fitter.ask("cancel")
    assert answer.success, answer.message
    assert not group(worker), "nothing of it runs when the answer comes"
    assert fitter.until(job, "cancelled", "failed").message == "cancelled"
    assert not list((tmp_path / "fits").iterdir())
    fitter.wait(lambda: fitter.estimates[-1].data.tolist() == [], "the estimate of what was cancelled stays")
    again = fitter.ask("cancel")
    assert (again.success, again.message) == (False, "No job is running.")


def test_a_crash_is_reported_in_words_and_the_node_lives_on(
    fitter: Fitter, running: Callable[[], tuple[str, int]], tmp_path: Path
) -> None:
    job, worker = running()
    os.kill(worker, signal.SIGKILL)
    failed = fitter.until(job, "failed")
    assert failed.level == b"\x02"
    reason = values_of(failed)["detail"]
    assert "ended by SIGKILL" in reason
    assert "ran out of memory" in reason
    fitter.wait(lambda: not group(worker), "what it started still runs")
    assert not list((tmp_path / "fits").iterdir())

    assert fitter.ask("cancel").message == "No job is running."


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"bag_uri": ""}, "Set the parameter bag_uri"),
        ({"bag_uri": "/nowhere/run1"}, "The recording /nowhere/run1 does not exist."),
        ({"bag_uri": 3}, "Give a path or a list of paths"),
        ({"fit__parameters": ["strip.Eh"]}, "strip.E_pa"),
        ({"fit__parameters": ["strip.E", "strip.nu"], "fit__initial": [4e9]}, "as many numbers"),
        ({"fit__initial": [-1.0]}, "strip.E_pa"),
        ({"fit__lower": [5e9]}, "below 5e+09 Pa, the bound"),
        ({"fit__initial": [4e9], "fit__lower": [5e9]}, "fit.initial has 4e+09 for strip.E_pa"),
        ({"topics__load_cell": "nobody"}, "topics.load_cell is 'nobody', and"),
        ({"fit__nuisance": "clocks"}, "There is no nuisance 'clocks'"),
        ({"output_dir": ""}, "Set the parameter output_dir"),
        ({"output_dir": "/dev/null/fits"}, "cannot be made"),
    ],
)
def test_a_request_that_cannot_be_met_is_refused_in_one_paragraph(
    fitter: Fitter, values: dict[str, Any], words: str
) -> None:
    fitter.set(**values)
    answer = fitter.ask("start")
    assert not answer.success
    assert words in answer.message
    assert "\n" not in answer.message


def test_what_is_no_bag_fails_in_words(fitter: Fitter, tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    fitter.set(bag_uri=str(tmp_path / "notes"))
    answer = fitter.ask("start")
    assert answer.success
    reason = values_of(fitter.until(answer.message, "succeeded", "failed"))["detail"]
    assert str(tmp_path / "notes") in reason and "\n" not in reason


@pytest.mark.parametrize("kill", [False, True], ids=["interrupted", "killed"])
def test_a_node_that_ends_takes_its_fit_along(ros: None, bag: Path, tmp_path: Path, kill: bool) -> None:
    from std_srvs.srv import Trigger

    own = NodeProcess(
        "sysid_node", tmp_path / "output", namespace="/other", rig=RIG, bag_uri=bag, output_dir=tmp_path / "fits",
        **{"fit.parameters": "[strip.E]"},
    )  # fmt: skip
    client = Client("other_client")
    try:
        client.call(Trigger, "other/tactile_sysid/start", Trigger.Request())
        worker = client.wait(own.spawned, "no process was started")
        client.wait(lambda: group(worker), "the fit has not begun", FIT_S)
        if kill:
            own.kill()
        else:
            assert own.stop() == 0, own.output
            assert re.search(r"fit_\S+ was cancelled; nothing was written\.", own.output), own.output
            assert "resource_tracker" not in own.output, own.output
        client.wait(lambda: not group(worker), "the fit outlives its node")
        assert not list((tmp_path / "fits").iterdir())
    finally:
        client.node.destroy_node()
        own.kill()


def test_a_rig_that_is_not_there_ends_the_node_in_one_paragraph(ros: None, tmp_path: Path) -> None:
    own = NodeProcess("sysid_node", tmp_path / "output", rig="/nowhere/rig.yaml")
    try:
        assert own.process.wait(WAIT_S) == 2
        assert re.search(r"error: .*/nowhere/rig.yaml", own.output)
        assert "Traceback" not in own.output
    finally:
        own.kill()


def test_a_fit_can_be_cancelled_while_it_only_starts(fitter: Fitter, tmp_path: Path) -> None:
    assert fitter.ask("start").success
    assert fitter.ask("cancel").success
    assert not list((tmp_path / "fits").iterdir())
