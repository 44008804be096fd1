"""Gradients by every class of parameters that a rig has, and by poses, start and fields, on every rig that comes with
the package."""

from __future__ import annotations

import json
from collections import Counter

import pytest

from sim_core.rigs import config_folder, list_parameters, load_rig
from sim_core.rigs.motion import Experiment, load_experiment
from sim_core.scene import build_scene
from sysid.gradients import check_gradients

PULL = {"type": "slide", "by_m": [0.002, 0.0, 0.0], "speed_m_s": 0.0005}
PRESS = {"type": "slide", "by_m": [0.001, 0.0, -0.002], "speed_m_s": 0.0005}
RUB = {
    "type": "waypoints", "speed_m_s": 0.01,
    "poses": [{"position_m": [-0.26, 7e-4, -0.0021]}, {"position_m": [-0.258, 7e-4, -0.0021]}],
}  # fmt: skip
# Off the middle of the strip: what its corners bear there has two sides.
ON_THE_STRIP = {
    "begin": {"gripper": {"position_m": [0.0015, 0.0, 0.0]}, "finger": {"position_m": [-0.26, 7e-4, -0.0016]}},
    "motions": {"finger": [RUB]},
}

RUNS: dict[str, tuple[str | dict[str, object], float]] = {
    "balancing": ("balance", 0.02),
    "bouncing": ("fall", 0.05),
    "card_flip": ("flip_card", 0.02),
    "card_press": ("slide", 0.8),
    "curled_card": ("fold", 0.3),
    "folding": ("fold", 0.3),
    "forming": ("form", 0.3),
    "gel_sensor": ("press_twist", 1.6),
    "lifting": ("lift", 0.03),
    "material_bench": (ON_THE_STRIP, 0.45),
    "pick_folding": ("pick_fold", 0.15),
    "proof_bench": ("press_post", 0.8),
    "push_block": ("push", 0.3),
    "separating": ("separate", 0.02),
    "sliding": ("push_off", 0.03),
    "strip_coarse": ("pull_strip", 1.0),
    "strip_pull": ("bend_and_release", 0.5),
    "tactip_cr": (PRESS, 4.0),
    "tissue_press": ("press_far", 0.3),
    "envelope": ("touch", 0.35),
    "gel_ear": ("touch", 0.35),
    "glove_finger": ("touch", 0.35),
    "mug_side": ("touch", 0.35),
    "punched_card": ("touch", 0.35),
} | {
    f"knit_{yarn}_{axis}": (PULL, 3.0)  # at 4 s flat knits are beyond their wrinkling load
    for yarn in ("acrylic_garter", "acrylic_stockinette", "pearlized_cotton_stockinette")
    for axis in "xy"
}
"""Rig: what it does, and for how long [s]: until contacts are made, rub and, where there is plasticity, yield."""

SLIDING = {
    "balancing": (0.25, ["ball-sheet"]),
    "card_flip": (0.1, ["gel_left-top"]),
    "lifting": (0.05, ["block-card"]),
    "separating": (0.166, ["card-table", "block-card"]),
    "sliding": (0.21, ["top-middle", "middle-bottom", "bottom-table"]),
}
"""Rig: until when [s] its run must go for these contacts to slide, which in :data:`RUNS` they do not."""


def test_no_rig_is_left_out():
    assert set(RUNS) == {path.stem for path in (config_folder() / "rigs").glob("*.yaml")}


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", RUNS)
def test_gradients_by_all_classes_of_parameters(name):
    """Below 1e-5, or 1e-4 with contact or plastic flow, forwards as well as backwards; one parameter of each name, and
    one field of each of gels and of sheets. Prints the largest error."""
    motion, until = RUNS[name]
    rig = load_rig(name)
    if isinstance(motion, str):
        experiment = load_experiment(motion)
    else:
        whole = motion if "motions" in motion else {"motions": {next(iter(rig.end_effectors)): [motion]}}
        experiment = Experiment.model_validate({"name": "short", **whole})
    classes: dict[str, str] = {}
    for parameter in list_parameters(rig):
        if parameter.value is not None:
            classes.setdefault(parameter.name.rpartition(".")[2], parameter.name)
    fields: dict[tuple[str, str], str] = {}
    for field in build_scene(rig).fields.names:
        body, _, quantity = field.rpartition(".")
        fields.setdefault((rig.bodies[body].type, quantity), f"fields.{field}")
    names = [*classes.values(), "poses", "start", *fields.values()]
    _, text = check_gradients(rig, experiment, names, until_s=until, as_json=True)
    rows = json.loads(text)["rows"]
    agree = [row for row in rows if row["verdict"] == "agrees"]
    assert agree
    worst = max(agree, key=lambda row: row["best"])
    others = Counter(row["verdict"] for row in rows if row["verdict"] in ("unresolved", "jumps"))
    print(
        f"{name} until {until:g} s: {len(agree)} agree, to {worst['best']:.0e} ({worst['parameter']}); {dict(others)}"
    )
    differ = [row for row in rows if row["verdict"] in ("differs", "one side")]
    assert not differ, [(row["parameter"], row["channel"], row["errors"], row["adjoint"]) for row in differ]


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", SLIDING)
def test_gradients_by_the_friction_of_what_slides(name):
    """Below 1e-4, forwards as well as backwards, in a channel of each: some stand next to a jump in others."""
    until, contacts = SLIDING[name]
    names = [f"contacts.{contact}.friction" for contact in contacts]
    experiment = load_experiment(str(RUNS[name][0]))
    steps = (1e-3, 1e-4, 1e-5, 1e-6)
    _, text = check_gradients(load_rig(name), experiment, names, until_s=until, steps=steps, as_json=True)
    rows = json.loads(text)["rows"]
    assert {row["parameter"] for row in rows if row["verdict"] == "agrees"} == set(names)
    assert not [row for row in rows if row["verdict"] in ("differs", "one side")]
