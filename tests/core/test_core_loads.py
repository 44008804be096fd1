"""Loads of a rig and sheets of rubber on the core, against differences of potentials and of rollouts."""

from __future__ import annotations

import pytest
from against_differences import compare_derivatives
from steps_of_rollouts import check_steps
from strip_over_table import SWING, strip_rig
from test_core_gels import SHAKEN, TIGHT, gel_rig
from test_core_gels import TIMES as GEL_TIMES
from test_core_materials import PRESSED_DOWN, TIMES, _against_differences

from sim_core.rigs import parse_rig
from sim_core.scene import build_scene

TABLE = {"times_s": [0.0, 0.04, 0.1], "values": [1.0, 3.0, 0.5]}


def loaded(rig, body, **face):
    """The rig with a load of each kind on a body, one of them by a table of times."""
    data = rig.model_dump(mode="json", by_alias=True, exclude_none=True)
    data["loads"] = [
        {"name": "push", "type": "force", "body": body, "force_n": [0.002, 0.001, 0.003], **TABLE, **face},
        {"name": "hung", "type": "weight", "body": body, "mass_kg": 1e-4, **face},
        {"name": "drawn", "type": "traction", "body": body, "traction_pa": [1.0, -2.0, 0.5], **face},
        {"name": "blown", "type": "pressure", "body": body, "pressure_pa": 2.0, **TABLE, **face},
    ]
    return parse_rig(data, "loaded")


def rubber():
    """A film that a hand swings and draws, above a table."""
    data = strip_rig().model_dump(mode="json", by_alias=True, exclude_none=True)
    data["bodies"]["strip"]["law"] = "neo_hookean"
    data["bodies"]["strip"]["material"] |= {"E_pa": 2e6, "nu": 0.5, "thickness_m": 1e-3}
    return parse_rig(data, "rubber")


NUMBERS = ["push.force_y_n", "hung.mass_kg", "drawn.traction_z_pa", "blown.pressure_pa"]
CASES = {
    "strip": (lambda: loaded(strip_rig(), "strip"), SWING, TIMES, [*NUMBERS, "strip.E_pa", "gripper.offset_z_m"]),
    "gel": (lambda: loaded(gel_rig(), "gel", face="bottom"), SHAKEN, GEL_TIMES, [*NUMBERS, "gel.E_pa"]),
    "rubber": (rubber, PRESSED_DOWN, TIMES, ["strip.E_pa", "strip.thickness_m", "gripper.offset_z_m"]),
}


@pytest.mark.parametrize("case", CASES)
def test_steps_end_in_balance_and_derivatives_of_potentials_are_those_of_differences(case):
    make, poses, times, _ = CASES[case]
    check_steps(build_scene(make()), poses, times)


@pytest.mark.parametrize("case", CASES)
def test_derivatives_between_impacts_against_differences_of_rollouts(case):
    make, poses, times, names = CASES[case]
    rig = make()
    sensors = {name: sensor for name, sensor in rig.sensors.items() if name != "under" or case == "rubber"}
    compare_derivatives(rig.model_copy(update={"sensors": sensors}), poses, times, names, TIGHT)


def test_derivatives_of_loads_against_differences_of_rollouts():
    make, poses, times, _ = CASES["strip"]
    _against_differences(make(), poses, times, NUMBERS)
