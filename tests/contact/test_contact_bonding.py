"""Adhesion that forms on touch: nothing on the way in, the cohesive law on the way out, until surfaces are apart."""

from __future__ import annotations

import numpy as np
import pytest
from contact_scenes import LAW, on_rigid

from sim_core.contact.shapes import HALF_SPACE
from sim_core.effects.contact_bonding import ContactBonding

SIDE_M, WORK, SPAN_M = 4e-4, 0.4, 1e-3
SQUARE = SIDE_M * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
GREATEST_N = SIDE_M**2 * 1.5 * WORK / SPAN_M
"""Attraction of the patch at half the range."""


def test_a_patch_is_held_from_the_step_after_it_has_touched_until_it_is_torn_off() -> None:
    law = {**LAW, "contact_bonding.work_j_m2": WORK, "contact_bonding.range_m": SPAN_M}
    look, _ = on_rigid([HALF_SPACE, 0, 0, 0, 0], SQUARE, [[0, 1, 2], [0, 2, 3]], law, effects=(ContactBonding(),))
    internals, before = look.system.initial_internals(), np.vstack([SQUARE + [0.0, 0.0, 2e-3], np.zeros(3)])
    found = []
    for gap in (5e-4, 1e-4, 5e-4, 5e-4, 1.1e-3, 5e-4):
        after = np.vstack([SQUARE + [0.0, 0.0, gap], np.zeros(3)])
        look.begin(before, dt=0.01, internals=internals)
        look.x[:] = after
        found.append(float(look.gradient()[:-1, 2].sum()))
        internals, before = look.end().internals, after
    touching = [bool(force < 0.0) for force in found]
    assert touching == [False, True, False, False, False, False]
    assert [found[k] for k in (0, 2, 3, 4, 5)] == pytest.approx([0.0, GREATEST_N, GREATEST_N, 0.0, 0.0], rel=1e-9)
    assert not internals["rigid"]["bonded"].any()
