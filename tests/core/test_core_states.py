"""States that a rollout keeps, positions, frames, forces of contacts, pressures and slip, against steps from Python."""

from __future__ import annotations

import numpy as np
import pytest
from strips_that_touch import PRESS_AND_RUB, RIGS
from test_core_compliance import yielding
from test_core_gels import PRESSED, TIGHT, gel_rig
from test_core_gels import TIMES as GEL_TIMES

from sim_core.core.covers import covers
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, run, simulate, step_times

CASES = {
    "gel on a table": (gel_rig, PRESSED, GEL_TIMES, True),
    "hands that give way": (lambda: yielding(gel_rig()), PRESSED, GEL_TIMES, True),
    **{name: (make, PRESS_AND_RUB[name], step_times(0.0, 0.3, 0.01), False) for name, make in RIGS.items()},
}
"""Rig, motion, instants; whether it slides there."""


@pytest.mark.parametrize("case", CASES)
def test_states_of_a_rollout_are_those_of_steps_from_python(case):
    make, poses, times, slides = CASES[case]
    scene = build_scene(make())
    assert covers(scene) is None
    found = simulate(scene, poses, times, settings=TIGHT, keep_states=True).states
    expected = run(Simulation(build_scene(make()), TIGHT), poses, times, keep_states=True).states
    assert np.abs(found.positions - expected.positions).max() < 1e-8
    for mount, origins in expected.origins.items():
        np.testing.assert_allclose(found.origins[mount], origins, atol=1e-8)
        np.testing.assert_allclose(found.quaternions[mount], expected.quaternions[mount], atol=1e-12)
    assert found.pair_forces.keys() == expected.pair_forces.keys()
    for pair, forces in expected.pair_forces.items():
        assert np.abs(forces).max() > 0.0
        np.testing.assert_allclose(found.pair_forces[pair], forces, atol=1e-5 * np.abs(forces).max(), err_msg=pair)
    assert not slides or expected.slip_speeds.any()
    for part in ("pressures", "slip_speeds"):
        values = getattr(expected, part)
        np.testing.assert_allclose(getattr(found, part), values, atol=1e-5 * np.abs(values).max() + 1e-12, err_msg=part)


def test_states_that_are_not_asked_for_are_not_kept():
    assert simulate(build_scene(gel_rig()), PRESSED, GEL_TIMES).states is None
