"""Contact of surfaces and of edges on the compiled core, against differences of potentials and of rollouts."""

from __future__ import annotations

import pytest
from against_differences import compare_derivatives
from steps_of_rollouts import check_steps
from strips_that_touch import PRESS_AND_RUB, RIGS

from sim_core.rigs import list_parameters
from sim_core.scene import build_scene
from sim_core.simulate import step_times
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-12, force_tolerance=1e-10)


@pytest.mark.parametrize("name", RIGS)
def test_steps_end_in_balance_and_derivatives_of_potentials_are_those_of_differences(name):
    found = check_steps(build_scene(RIGS[name]()), PRESS_AND_RUB[name], step_times(0.0, 0.3, 0.01))
    assert max(r.contacts for r in found.reports) > 0


@pytest.mark.parametrize("name", ["under_a_box", "folded"])
def test_derivatives_between_impacts_against_differences_of_rollouts(name):
    rig, times = RIGS[name](), step_times(0.0, 0.2, 0.01)
    wanted = ("E_pa", "friction", "thickness", "offset_z", "offset_x_m")
    names = [p.name for p in list_parameters(rig) if p.value is not None and any(w in p.name for w in wanted)]
    compare_derivatives(rig, PRESS_AND_RUB[name], times, names, TIGHT)
