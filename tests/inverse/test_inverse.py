"""Inverse tasks: what is sought comes back, by every method, and no search is made twice."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml

from sim_core.errors import ConfigError
from sim_core.rigs import load_rig
from sim_core.rigs.motion import load_experiment
from sysid.inverse import inverse_benchmark, inverse_task_names, load_inverse_task
from sysid.inverse.methods import METHODS, begun_at
from sysid.model.parameters import fit_parameters, start_of


@pytest.mark.parametrize("name", inverse_task_names())
def test_what_comes_with_the_package_names_a_parameter_and_a_motion(name):
    task = load_inverse_task(name)
    rig = load_rig(task.rig)
    load_experiment(task.experiment)
    (parameter,) = fit_parameters(rig, [task.seeks])
    truth = parameter.physical(float(start_of(rig, [parameter])[0]))
    for factor in task.begins:
        off = begun_at(rig, task.seeks, factor)
        assert parameter.physical(float(start_of(off, [parameter])[0])) == pytest.approx(factor * truth)


@pytest.fixture
def press(tmp_path):
    """The stiffness of a gel that is pressed on a post."""
    task = tmp_path / "press.yaml"
    given = {"rig": "card_press", "experiment": "press_post", "seeks": "gel.E_pa", "begins": [0.85]}
    task.write_text(yaml.safe_dump({"name": "press", "description": "A press.", **given}))
    return str(task)


@pytest.mark.slow
def test_every_method_finds_it_and_what_was_made_is_kept(press, tmp_path, monkeypatch):
    monkeypatch.setattr("sysid.inverse.methods.STEPS", 5)
    monkeypatch.setattr("sysid.inverse.methods.GENERATIONS", 1)
    out = tmp_path / "out"
    (fitted,) = inverse_benchmark([press], ["fit"], [0], out, workers=1)
    assert abs(fitted.error) < 0.02 and fitted.inside
    rows = inverse_benchmark([press], list(METHODS), [0], out, workers=1)
    assert [r.method for r in rows] == list(METHODS)
    assert rows[0] == fitted, "made again"
    assert json.loads((out / "rows.json").read_text())[0]["wall_s"] == fitted.wall_s
    by_name = {r.method: r for r in rows}
    # Five steps of at most a twelfth reach the truth from e^-0.16; ten draws of width 0.3 come as near as e^0.15.
    assert abs(by_name["gradient"].error) < 0.05 and by_name["gradient"].rollouts == 5
    assert abs(by_name["cma"].error) < 0.15 and by_name["cma"].rollouts == 10
    assert all(r.interval is None for r in rows[1:])
    table = (out / "table.md").read_text().splitlines()
    assert len(table) == 2 + len(METHODS)
    assert np.isfinite([r.wall_s for r in rows]).all()


def test_a_method_that_there_is_not_is_refused(press, tmp_path):
    with pytest.raises(ConfigError, match="There is no method 'adam'"):
        inverse_benchmark([press], ["adam"], [0], tmp_path)
