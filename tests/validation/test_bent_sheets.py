"""Sheets that keep a bend, and strips that bend across as well."""

import numpy as np
import pytest

from sysid.validation.anticlastic import SHEET, ashwell, bent_strip
from sysid.validation.springback import LENGTH, STIFFNESS, YIELD, Bender, dissipated

MESHES = pytest.mark.parametrize(("pattern", "cells"), [("regular", (10, 4)), ("irregular", (20, 6))])


@MESHES
@pytest.mark.parametrize("hardening", [0.02, 0.5])
def test_a_sheet_keeps_what_its_yield_curvature_says(pattern, cells, hardening):
    """On any mesh, in any number of steps, and no more when it is bent again."""
    plastic = 2.0 / (1.0 + hardening)
    for parts in (2, 11):
        bender = Bender(pattern, cells, hardening)
        moment = bender.bend((YIELD * np.linspace(0.0, 3.0, parts)[1:]).tolist())[-1]
        assert moment == pytest.approx((3.0 - plastic) * STIFFNESS * YIELD, rel=0.002)
        kept = bender.release()
        assert kept == pytest.approx(plastic * YIELD, rel=0.005)
        bender.bend([3.0 * YIELD])
        assert bender.release() == pytest.approx(kept, rel=0.002)


@MESHES
def test_below_its_yield_curvature_a_sheet_is_elastic(pattern, cells):
    yielding, elastic = Bender(pattern, cells), Bender(pattern, cells, yield_curvature=np.inf)
    for bender in (yielding, elastic):
        bender.bend([0.4 * YIELD, 0.9 * YIELD])
    assert not yielding.state.internals["bending"]["plastic_curvature"].any()
    np.testing.assert_allclose(yielding.state.x, elastic.state.x, atol=1e-9)


def test_the_work_lost_is_that_of_the_yield_moment():
    plastic, hardening = 2.0 / 1.1, 0.1
    lost = dissipated(Bender("regular", (10, 4), hardening), 3.0 * YIELD)
    exact = plastic + 0.5 * hardening * plastic**2
    assert lost == pytest.approx(exact * STIFFNESS * YIELD**2 * LENGTH, rel=0.002)


def test_the_closed_form_has_the_limits_of_a_bar_and_of_a_plate():
    narrow, wide = (ashwell(k, np.zeros(1))[0] for k in (1e-4, 2e3))
    assert narrow == pytest.approx(1.0, abs=1e-4)
    assert wide == pytest.approx(1.0 / (1.0 - SHEET["nu"] ** 2), rel=1e-3)


@pytest.mark.parametrize("pattern", ["regular", "irregular"])
def test_a_strip_bends_across_as_ashwell_says(pattern):
    """Moment within 1.5 %, curvature across within 5 % of nu k, on a coarse mesh; both change five times that much
    from bar to plate."""
    for expected, ours in bent_strip(pattern, (40, 16)):
        assert ours[0] == pytest.approx(expected[0], rel=0.015)
        assert ours[1] == pytest.approx(expected[1], abs=0.05)
