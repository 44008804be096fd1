"""The whole circle from nodes: optimise, replay, watch, record, diagnose, amend, optimise again, on a second simulator
that conceals something."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from ros_live import NodeProcess

pytestmark = [pytest.mark.ros, pytest.mark.slow]

EXAMPLE = Path(__file__).parents[2] / "examples" / "closed_loop"
CONCEALED = {
    "end_effector_compliance": {"compliance_m_per_n": 1.0e-3},
    "bending_plasticity": {"yield_curvature_per_m": 1.5, "hardening_ratio": 0.2},
    "command_scale": {"scale_x": 0.0, "scale_y": 0.0, "scale_z": -0.12},
}


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", list(CONCEALED))
def test_what_a_robot_conceals_is_found_out_in_one_round(ros: None, tmp_path: Path, name: str) -> None:
    """In the last round the error of the task is what the rig itself leaves: the end of the strip cannot be put in all
    three directions. The watch alarms in the first round and is silent in the last."""
    truth = CONCEALED[name]
    overlay = [f"overlay_of: {EXAMPLE / 'strip.yaml'}", f"name: {name}", f"effects: {json.dumps({name: truth})}"]
    (tmp_path / "robot.yaml").write_text("\n".join(overlay))
    place, out = f"/circle_{name}", tmp_path / "out"
    robot = NodeProcess("sim_node", tmp_path / "robot", place, rig=tmp_path / "robot.yaml", publish_clock="true")
    command = [sys.executable, "-m", "thinshell_ros.closed_loop", str(EXAMPLE / "task.yaml"), "--out", str(out)]
    command += ["--budget", "10", "--namespace", place, "--simulated", str(tmp_path / "robot.yaml")]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-3000:]
        assert robot.stop() == 0, robot.output
    finally:
        robot.kill()
    rounds = json.loads((out / "rounds.json").read_text())
    print(json.dumps(rounds, indent=1))
    first, last = rounds[0], rounds[-1]
    assert first["watch"].startswith("At ") and "readings part from the prediction" in first["watch"]
    assert last["watch"] == "as predicted"
    assert first["effects"] == [name]
    diagnosis = json.loads((out / "round_1" / "diagnosis" / "diagnosis.json").read_text())
    assert any(diagnosis["parted"].values()), "its report opens where the replay parted"
    fitted = {p["name"]: p["ci95"] for p in diagnosis["effects"][0]["parameters"]}
    for key, value in truth.items():
        low, high = fitted[f"effects.{name}.{key}"]
        assert abs(value - 0.5 * (low + high)) <= high - low, "about four standard deviations"
    assert last["achieved"] > first["achieved"], "rewards are errors with the sign turned round"
    assert last["achieved"] == pytest.approx(last["reward"], rel=0.05)
