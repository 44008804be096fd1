"""Gradients by everything that a rig has, on every rig that comes with the package."""

from __future__ import annotations

import json

import pytest

from sim_core.rigs import config_folder, load_rig
from sim_core.rigs.motion import Experiment, load_experiment
from sysid.gradients import check_gradients

STEPS = (1e-3, 1e-4, 1e-5)

PULL = {"type": "slide", "by_m": [0.002, 0.0, 0.0], "speed_m_s": 0.01}
PRESS = {"type": "slide", "by_m": [0.001, 0.0, -0.002], "speed_m_s": 0.02}

RUNS: dict[str, tuple[str | dict[str, object], float]] = {
    "balancing": ("balance", 0.05),
    "bouncing": ("fall", 0.05),
    "card_flip": ("flip_card", 0.05),
    "card_press": ("slide", 0.8),
    "folding": ("fold", 0.3),
    "forming": ("form", 0.3),
    "lifting": ("lift", 0.1),
    "material_bench": ("rub_strip", 1.5),
    "pick_folding": ("pick_fold", 0.15),
    "proof_bench": ("press_post", 0.5),
    "push_block": ("push", 0.3),
    "separating": ("separate", 0.04),
    "sliding": ("push_off", 0.05),
    "strip_coarse": ("pull_strip", 1.0),
    "strip_pull": ("bend_and_release", 0.5),
    "tactip_cr": (PRESS, 0.1),
    "tissue_press": ("press_far", 0.3),
} | {
    f"knit_{yarn}_{axis}": (PULL, 0.2)
    for yarn in ("acrylic_garter", "acrylic_stockinette", "pearlized_cotton_stockinette")
    for axis in "xy"
}
"""Rig: what it does, and for how long [s]: until contacts are made, rub and, where there is plasticity, yield."""


def test_no_rig_is_left_out():
    assert set(RUNS) == {path.stem for path in (config_folder() / "rigs").glob("*.yaml")}


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_gradients_by_all_parameters(name):
    """Below 1e-5, or 1e-4 with contact or plastic flow, forwards as well as backwards."""
    motion, until = RUNS[name]
    rig = load_rig(name)
    if isinstance(motion, str):
        experiment = load_experiment(motion)
    else:
        motions = {next(iter(rig.end_effectors)): [motion]}
        experiment = Experiment.model_validate({"name": "short", "motions": motions})
    _, text = check_gradients(rig, experiment, until_s=until, steps=STEPS, as_json=True)
    rows = json.loads(text)["rows"]
    assert any(row["verdict"] == "agrees" for row in rows)
    differ = [row for row in rows if row["verdict"] == "differs"]
    assert not differ, [(row["parameter"], row["channel"], row["errors"], row["adjoint"]) for row in differ]
