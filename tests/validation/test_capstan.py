"""Friction around a drum on an ordinary mesh, and a word where the mesh is too coarse for it."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.preflight import review
from sysid.validation.capstan import MU, RADIUS, capstan_rig, tension_ratio


def test_tensions_around_a_drum_follow_eytelwein() -> None:
    """Cells of 2.8 mm around a radius of 10 mm, 0.1 mm flatter than the drum in their middle."""
    assert tension_ratio(90.0, 20, (4, 8)) == pytest.approx(np.exp(0.5 * np.pi * MU), rel=0.03)


def test_cells_too_coarse_for_a_drum_are_named_with_the_size_to_use() -> None:
    (found,) = [f for f in review(capstan_rig(180.0, 11)) if f.kind == "coarse cells"]
    assert "strip are 6." in found.problem
    assert "drum" in found.problem
    assert f"at most {0.5e3 * RADIUS:g} mm" in found.remedy
    assert not [f for f in review(capstan_rig(180.0, 40)) if f.kind == "coarse cells"]
