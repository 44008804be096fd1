"""What ``thinshell bench RIG BAG`` measures, and what it says where steps do not run on the compiled core."""

from __future__ import annotations

import json

import pytest
from strip import TRUTH, pulled, strip_rig
from typer.testing import CliRunner

from sim_core.errors import ConfigError
from sysid.bench import measure_recording, run_recording_benchmark
from sysid.cli.app import app


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    out = tmp_path_factory.mktemp("bench") / "bag"
    pulled(strip_rig(), TRUTH, out)
    return out


def test_figures_are_those_of_the_rollout_and_the_path_is_named(bag):
    found = json.loads(run_recording_benchmark(strip_rig(), bag, 2, as_json=True))
    assert found["path"] == "compiled core"
    assert found["steps"] >= 20 and found["columns"] == 2
    assert 0.0 < found["cpu_ms_per_step"] < found["cpu_ms_per_step_with_columns"]
    assert 1.0 <= found["factorisations_per_step"] < found["residuals_per_step"]


def test_another_path_is_told_with_its_reason(bag):
    rig = strip_rig().model_copy(
        update={"effects": {"bending_plasticity": {"yield_curvature_per_m": 50.0, "hardening_ratio": 0.1}}}
    )
    found = measure_recording(rig, bag)
    assert "plastic flow" in found.path and found.residuals_per_step is None


def test_more_columns_than_parameters_are_refused(bag):
    with pytest.raises(ConfigError, match="Give at most"):
        measure_recording(strip_rig(), bag, 999)


def test_a_rig_without_a_recording_is_refused():
    done = CliRunner().invoke(app, ["bench", "strip_pull"])
    assert done.exit_code != 0
