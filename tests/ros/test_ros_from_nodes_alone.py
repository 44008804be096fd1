"""Record, fit, diagnose, deploy, from nodes alone: an optimised motion is replayed on a robot whose strip is softer
than its rig says, the recording is fitted and diagnosed, and a motion that is optimised on the fitted rig is replayed as
predicted."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from ros_live import Client, NodeProcess

from sim_core.rigs import load_rig, rig_to_yaml, with_parameters

pytestmark = [pytest.mark.ros, pytest.mark.slow]

EXAMPLE = Path(__file__).parents[2] / "examples" / "closed_loop"
PLACE = "/bench_top"
TRUE_E_PA = 1.2e9
"""The rig says 2.0e9."""
JOB_S = 3600.0


class Jobs(Client):
    """A client of ``sysid_node``."""

    def __init__(self, node: NodeProcess) -> None:
        from std_msgs.msg import String

        super().__init__("operator", PLACE)
        self._node = node
        self.done: set[str] = set()
        self._results = self.listen(String, "tactile_sysid/result", latched=True)

    def do(self, service: str, **values: Any) -> dict[str, Any]:
        """Set parameters, start a job and wait for its result."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter
        from std_srvs.srv import Trigger

        given = [Parameter(name.replace("__", "."), None, value).to_parameter_msg() for name, value in values.items()]
        answer = self.call(SetParameters, "tactile_sysid/set_parameters", SetParameters.Request(parameters=given))
        assert all(result.successful for result in answer.results), answer.results
        started = self.call(Trigger, f"tactile_sysid/{service}", Trigger.Request())
        assert started.success or "is running" in started.message, started.message

        def ended() -> Any:
            assert "failed:" not in self._node.output, self._node.output
            results = (json.loads(message.data) for message in self._results)
            return next((r for r in results if r["job_id"] not in self.done), None)

        result: dict[str, Any] = self.wait(ended, f"{service} does not end", JOB_S)
        self.done.add(result["job_id"])
        return result


@pytest.fixture
def robot(ros: None, tmp_path: Path) -> Iterator[NodeProcess]:
    """The robot: a simulator of another process, whose strip is softer."""
    rig = with_parameters(load_rig(EXAMPLE / "strip.yaml"), {"strip.E_pa": TRUE_E_PA})
    (tmp_path / "robot.yaml").write_text(rig_to_yaml(rig))
    node = NodeProcess("sim_node", tmp_path / "robot", PLACE, rig=tmp_path / "robot.yaml", publish_clock="true")
    try:
        yield node
        assert node.stop() == 0, node.output
    finally:
        node.kill()


@pytest.mark.timeout(7200)
def test_record_fit_diagnose_and_deploy(robot: NodeProcess, tmp_path: Path) -> None:
    from thinshell_ros.closed_loop import Robot

    sysid = NodeProcess(
        "sysid_node", tmp_path / "sysid", PLACE, rig=EXAMPLE / "strip.yaml", output_dir=tmp_path / "jobs",
        **{"optimise.task": EXAMPLE / "task.yaml", "optimise.budget": 10, "fit.parameters": "[strip.E]"},
    )  # fmt: skip
    jobs = Jobs(sysid)
    try:
        with Robot(PLACE, simulated=True) as hand:
            first = jobs.do("optimise")
            replayed = hand.replay(Path(first["trajectory"]), EXAMPLE / "strip.yaml", tmp_path / "recording")
            assert replayed.state == "succeeded", replayed
            assert "readings part from the prediction" in replayed.watch, "the strip is softer than was predicted"

            fitted = jobs.do("start", bag_uri=str(tmp_path / "recording"))
            low, high = fitted["ci95"]["strip.E_pa"]
            assert abs(fitted["estimate"]["strip.E_pa"] - TRUE_E_PA) <= high - low, "about four standard deviations"

            diagnosed = jobs.do("diagnose")
            assert diagnosed["verdict"] == "nothing_missing", "the stiffness takes it all up"

            rig = Path(fitted["output_dir"]) / "fitted_rig.yaml"
            assert yaml.safe_load(rig.read_text())["bodies"]["strip"]["material"]["E_pa"] < 1.5e9
            second = jobs.do("optimise", optimise__rig=str(rig))
            again = hand.replay(Path(second["trajectory"]), rig, tmp_path / "deployed")
            assert (again.state, again.watch) == ("succeeded", "as predicted")
        assert sysid.stop() == 0, sysid.output
        assert "Traceback" not in sysid.output + robot.output
    finally:
        jobs.node.destroy_node()
        sysid.kill()
