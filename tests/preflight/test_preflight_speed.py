"""Motions that no robot would be let to execute are said before anything is simulated."""

from __future__ import annotations

import pytest

from sim_core.preflight.speed import speed_findings
from sim_core.rigs import load_rig
from sim_core.rigs.motion import Experiment, compile_experiment
from sim_core.rigs.yamlfile import validate
from sysid.cli import app


def motion(speed: float) -> Experiment:
    slide = {"type": "slide", "by_m": [0.0, 0.0, 0.3], "speed_m_s": speed}
    return validate(Experiment, {"name": "up", "motions": {"finger": [slide]}}, "made")


def test_a_motion_within_the_limits_of_the_hand_gives_no_finding() -> None:
    rig = load_rig("card_press")
    assert not speed_findings(rig, compile_experiment(motion(0.5), rig))


def test_one_that_is_too_fast_names_value_limit_and_remedy() -> None:
    """The peak speed is that of the motion; the acceleration of a minimum-jerk move is 10/sqrt(3) d/T^2."""
    rig = load_rig("card_press")
    found = speed_findings(rig, compile_experiment(motion(2.5), rig))
    time = 1.875 * 0.3 / 2.5
    said = [f.text for f in found]
    assert [text.split(" of ")[0] for text in said] == ["The speed", "The acceleration"]
    assert float(said[0].split(" is ")[1].split()[0]) == pytest.approx(2.5, rel=1e-2)
    assert float(said[1].split(" is ")[1].split()[0]) == pytest.approx(10.0 / 3.0**0.5 * 0.3 / time**2, rel=3e-2)
    assert "(at most 1.7 m/s). A robot is not let to do that: slow it down, or correct limits of finger." in said[0]


def test_a_box_of_the_hand_counts_too() -> None:
    rig = load_rig("card_press")
    finger = rig.end_effectors["finger"]
    boxed = finger.limits.model_copy(update={"workspace_max_m": (1.0, 1.0, 0.1)})
    hands = {"finger": finger.model_copy(update={"limits": boxed})}
    low = rig.model_copy(update={"end_effectors": hands})
    (finding,) = speed_findings(low, compile_experiment(motion(0.5), low))
    assert "finger leaves the workspace: z is 0.356 m" in finding.text


def test_a_trajectory_is_made_with_a_warning(tmp_path: object, capsys: pytest.CaptureFixture[str]) -> None:
    path = f"{tmp_path}/up.yaml"
    with open(path, "w") as file:
        file.write("name: up\nmotions: {finger: [{type: slide, by_m: [0.0, 0.0, 0.3], speed_m_s: 2.5}]}\n")
    assert app.main(["trajectory", "card_press", path, "--no-prediction", "--out", f"{tmp_path}/up.json"]) == 0
    err = capsys.readouterr().err
    assert err.count("The speed of finger is 2.") == 1, "once"
