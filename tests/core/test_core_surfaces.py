"""Contact of surfaces and of edges on the compiled core, against the same laws launched one by one from Python."""

from __future__ import annotations

import numpy as np
import pytest
from strip_over_table import by_python
from strips_that_touch import PRESS_AND_RUB, RIGS

from sim_core.core.covers import covers
from sim_core.core.rollout import CoreRollout
from sim_core.scene import build_scene
from sim_core.simulate import step_times
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-12, force_tolerance=1e-10)


@pytest.mark.parametrize("name", RIGS)
def test_rollouts_are_those_of_the_launched_laws(name):
    scene, times = build_scene(RIGS[name]()), step_times(0.0, 0.3, 0.01)
    assert covers(scene) is None
    core = CoreRollout(scene, PRESS_AND_RUB[name], times, TIGHT)
    core.settle()
    x = np.concatenate([chunk.at.x for chunk in core.run()])
    expected = by_python(build_scene(RIGS[name]()), PRESS_AND_RUB[name], times, TIGHT)
    assert np.abs(x - expected.path.positions[1:]).max() < 1e-8
    assert max(r.contacts for r in core.reports) > 0
    assert core.handed_over < len(times) - 1
