"""What ``thinshell bench RIG BAG`` measures."""

from __future__ import annotations

import json

import pytest
from strip import TRUTH, pulled, strip_rig
from typer.testing import CliRunner

from sim_core.errors import ConfigError
from sysid.bench import measure_recording, run_effects_benchmark, run_recording_benchmark
from sysid.cli.app import app


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    out = tmp_path_factory.mktemp("bench") / "bag"
    pulled(strip_rig(), TRUTH, out)
    return out


def test_figures_are_those_of_the_rollout(bag):
    found = json.loads(run_recording_benchmark(strip_rig(), bag, 2, as_json=True))
    assert found["steps"] >= 20 and found["columns"] == 2
    assert 0.0 < found["cpu_ms_per_step"] < found["cpu_ms_per_step_with_columns"]
    assert 1.0 <= found["factorisations_per_step"] < found["residuals_per_step"]


def test_the_table_of_effects_names_all_that_can_act(bag, monkeypatch):
    monkeypatch.setattr("sysid.bench.effects.STEPS", 3)
    rows = {row["effect"]: row for row in json.loads(run_effects_benchmark(strip_rig(), bag, as_json=True))}
    assert {"bending_plasticity", "viscoelastic_sheet", "sheet_thickness", "end_effector_compliance"} <= rows.keys()
    assert "gel_mullins" not in rows and "wrench_offset" not in rows
    assert rows["viscoelastic_sheet"]["cpu_ms_per_step"] > 0.0
    assert "viscoelastic_sheet" in run_effects_benchmark(strip_rig(), bag, as_json=False)


def test_more_columns_than_parameters_are_refused(bag):
    with pytest.raises(ConfigError, match="Give at most"):
        measure_recording(strip_rig(), bag, 999)


def test_a_rig_without_a_recording_is_refused():
    done = CliRunner().invoke(app, ["bench", "strip_pull"])
    assert done.exit_code != 0
