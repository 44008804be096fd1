"""The tutorial of the nodes, command by command: what the robot conceals is found out by running nodes, the twin takes
it up while it runs, and the next replay is as predicted."""

from __future__ import annotations

import json
import re
from pathlib import Path

import from_nodes
import numpy as np
import pytest
from from_nodes import PAGE, RIG, ROBOT, ROOT, Followed

from sim_core.rigs import load_rig
from sim_core.tasks import TaskRollouts, load_task

pytestmark = pytest.mark.ros

NOISE_N = load_rig(str(ROOT / RIG)).sensors["wrench_gel"].noise.force_n
TRUTH = {"strip.E_pa": 1.6e9, "effects.end_effector_compliance.compliance_m_per_n": 1.0e-3}


def test_the_page_shows_the_pictures_that_there_are_and_the_robot_conceals_what_it_says() -> None:
    shown = set(re.findall(r"\(\.\./pictures/from_nodes/(\w+\.png)\)", PAGE.read_text()))
    assert shown == {path.name for path in from_nodes.OUT.glob("*.png")}
    rig, robot = load_rig(str(ROOT / RIG)), load_rig(str(ROOT / ROBOT))
    assert robot.bodies["strip"].material.E_pa == TRUTH["strip.E_pa"] != rig.bodies["strip"].material.E_pa
    assert robot.effects["end_effector_compliance"]["compliance_m_per_n"] == 1.0e-3 and not rig.effects


def achieved(followed: Followed, number: int) -> float:
    """Error of the task on the robot [m^2], of the motion of an optimisation."""
    task = load_task(str(ROOT / "examples" / "closed_loop" / "task.yaml"), rig=str(ROOT / ROBOT))
    action = json.loads((followed.job("optimisation", number) / "result.json").read_text())["action"]
    return -TaskRollouts(task).outcome(np.array(action)).reward


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_record_fit_diagnose_and_deploy_by_the_commands_of_the_page(ros: None, tmp_path: Path) -> None:
    code = from_nodes.follow(tmp_path)
    said = (tmp_path / "log").read_text()
    assert code == 0 and "Traceback" not in said, said[-5000:]
    assert_found(Followed(tmp_path), said)
    from_nodes.draw(Followed(tmp_path), tmp_path / "pictures")
    assert {p.name for p in (tmp_path / "pictures").iterdir()} == {p.name for p in from_nodes.OUT.glob("*.png")}


def assert_found(followed: Followed, said: str) -> None:
    """The truth was found, and the robot and its twin follow from it."""
    watches = re.findall(r"^The replay succeeded\. Watch: (.*)", said, re.MULTILINE)
    assert len(watches) == 4
    assert watches[0] == watches[3] == "as predicted", "the twin before, and the robot after"
    assert all("readings part from the prediction" in words for words in watches[1:3]), "the robot, and the twin after"

    robot, before, after, deployed = map(followed.replay, ("recording", "twin_before", "twin_after", "deployed"))
    print(f"robot {robot.error_n:.4f} N from its prediction, then {deployed.error_n:.4f} N")
    print(f"twin {robot.from_other(before):.4f} N from the robot, then {robot.from_other(after):.4f} N")
    assert deployed.error_n < 3.0 * NOISE_N < 0.1 * robot.error_n
    assert robot.from_other(after) < 3.0 * NOISE_N < 0.1 * robot.from_other(before)

    found = followed.diagnosis
    assert found["verdict"] == "named" and [e["name"] for e in found["effects"]] == ["end_effector_compliance"]
    limits = {one["name"]: one["ci95"] for one in found["amended_parameters"]}
    for name, truth in TRUTH.items():
        low, high = limits[name]
        print(f"{name}: {low:.5g} to {high:.5g}, truth {truth:.5g}")
        assert abs(truth - 0.5 * (low + high)) <= high - low, "about four standard deviations"
    low, high = followed.fit["strip.E_pa"]
    known = limits["strip.E_pa"]
    print(f"strip.E_pa by the fit: {low:.5g} to {high:.5g}")
    assert low <= TRUTH["strip.E_pa"] <= high and high - low > 5.0 * (known[1] - known[0]), (
        "it is widened by the misfit"
    )
    assert "The rig does not explain the recordings" in said

    first, second = (achieved(followed, number) for number in (0, 1))
    print(f"error of the task on the robot: {first:.3g}, then {second:.3g} m^2")
    assert second < 0.1 * first
