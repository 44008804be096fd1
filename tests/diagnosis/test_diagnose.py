"""The whole diagnosis, from bags to files: a hidden law is named, and where there is none, none is."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from sim_core.rigs import load_rig, with_parameters
from sim_core.rigs.motion import Experiment
from sysid.comparison.ledger import read_ledger
from sysid.comparison.posterior import posterior
from sysid.diagnosis.result import NamedParameter
from sysid.simulate import simulate_to_bag
from sysid.workflow import diagnose_bags
from sysid.workflow.diagnose import write_rigs

PRESS = [
    {"type": "wait", "duration_s": 0.3},
    {"type": "waypoints", "speed_m_s": 0.02, "hold_s": 0.3,
     "poses": [{"position_m": [0.055, 0.0, 0.0]}, {"position_m": [0.055, 0.0, -0.0008]},
               {"position_m": [0.055, 0.0, 0.0]}]},
]  # fmt: skip
DEEPER = [
    {"type": "wait", "duration_s": 0.3},
    {"type": "waypoints", "speed_m_s": 0.03, "hold_s": 0.25,
     "poses": [{"position_m": [0.055, 0.0, 0.0]}, {"position_m": [0.055, 0.0, -0.001]},
               {"position_m": [0.055, 0.0, 0.0]}]},
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("effect", [None, {"gel_relaxation": {"share": 0.25, "tau_s": 0.15}}])
def test_a_hidden_law_is_named_and_none_where_there_is_none(small_rig, tmp_path: Path, effect) -> None:
    rig = small_rig()
    truth = with_parameters(rig, {"gel.E_pa": 1.3e5, "contacts.gel-post.friction": 0.45})
    if effect:
        truth = truth.model_copy(update={"effects": effect})
    for name, motion, seed in (("press", PRESS, 3), ("deeper", DEEPER, 4)):
        plan = Experiment.model_validate({"name": name, "seed": seed, "motions": {"finger": motion}})
        simulate_to_bag(truth, plan, tmp_path / name, seed=seed, refine=2)
    out = tmp_path / "out"
    said = diagnose_bags(rig, [tmp_path / "press"], held_out=[tmp_path / "deeper"], out=out).table()
    data = json.loads((out / "diagnosis.json").read_text())
    assert data["schema"] == "thinshell.diagnosis/3"
    written = {"diagnosis.json", "ledger.npz", "report.html", "rig.yaml", "amended_rig.yaml"}
    assert {f.name for f in out.iterdir()} == written | ({"next_experiment.yaml"} if effect else set())
    amended = load_rig(out / "amended_rig.yaml")
    judged = posterior(read_ledger(out))
    assert ("gel_relaxation" in judged.models[0].effects) == bool(effect), judged.models[:3]
    if effect is None:
        assert data["verdict"] == "nothing_missing", said
        assert not amended.effects
        return
    assert data["verdict"] == "named", said
    (found,) = data["effects"]
    assert found["name"] == "gel_relaxation"
    values = {p["name"].rsplit(".", 1)[1]: p["ci95"] for p in found["parameters"]}
    assert values["share"][0] <= 0.25 <= values["share"][1]
    assert values["tau_s"][0] <= 0.15 <= values["tau_s"][1]
    assert data["fit"]["amended"]["held_out"] < data["fit"]["baseline"]["held_out"]
    assert amended.effects["gel_relaxation"]["share"] == pytest.approx(0.25, rel=0.3)


def test_the_answer_is_an_overlay_of_the_rig_as_given(small_rig, tmp_path: Path) -> None:
    rig = small_rig()
    amended = with_parameters(rig, {"gel.E_pa": 1.3e5}).model_copy(
        update={"effects": {"air_drag": {"drag_coefficient": 1.0}}}
    )
    found = SimpleNamespace(
        sentence="Air is missing.",
        next_motion=None,
        baseline_parameters=(),
        amended_parameters=(
            NamedParameter("gel.E_pa", 1.3e5, (1.2e5, 1.4e5), "Pa", "modulus"),
            NamedParameter("side.latency_s[press]", 0.01, (0.0, 0.02), "s", "of one recording"),
        ),
    )
    write_rigs(rig, found, amended, tmp_path)
    assert {f.name for f in tmp_path.iterdir()} == {"rig.yaml", "amended_rig.yaml"}
    assert load_rig(tmp_path / "rig.yaml").bodies == rig.bodies
    answer = load_rig(tmp_path / "amended_rig.yaml")
    assert answer.bodies == amended.bodies and answer.effects == amended.effects
