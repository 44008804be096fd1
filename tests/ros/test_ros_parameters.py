"""Parameters that nodes are given and do not have."""

import time
from pathlib import Path

import pytest
from ros_live import START_S, NodeProcess

pytestmark = pytest.mark.ros

RIG = Path(__file__).parent / "data" / "pull_coarse.yaml"
WIDE = "qos_overrides./pull/target_pose.subscription.depth"


@pytest.mark.parametrize(
    ("module", "misspelt", "meant"),
    [
        ("sim_node", "nois", "noise"),
        ("record_node", "topcs", "topics"),
        ("sysid_node", "fit.paramters", "fit.parameters"),
    ],
)
def test_a_misspelt_parameter_is_said(ros: None, tmp_path: Path, module: str, misspelt: str, meant: str) -> None:
    given = {"rig": RIG, misspelt: "[a]", WIDE: 2}
    if module == "record_node":
        given["uri"] = tmp_path / "bag"
    node = NodeProcess(module, tmp_path / "output", **given)
    try:
        end = time.monotonic() + START_S
        while "it is ignored" not in node.output and node.process.poll() is None and time.monotonic() < end:
            time.sleep(0.1)
        assert f"The parameter {misspelt} was given" in node.output
        assert f"Did you mean '{meant}'?" in node.output
        assert node.output.count("it is ignored") == 1, "what is declared later, or by others, is no mistake"
    finally:
        node.kill()
