"""Adhesion: its law against its own integrals (pull-off: tests/contact/test_added_laws.py)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from sim_core.effects.contact_adhesion import ContactAdhesion

LAW = {"work_j_m2": 0.4, "range_m": 2e-4}


def test_pressure_and_slope_are_the_derivatives_of_the_energy() -> None:
    law, h = ContactAdhesion(), 1e-9
    gaps = np.array([-1e-5, 3e-5, 1e-4, 1.9e-4, 2.5e-4])
    low, here, high = (law.energy.at(LAW, gaps + s) for s in (-h, 0.0, h))
    assert (high.v - low.v) / (2 * h) == pytest.approx(here.d[0], abs=1e-4)
    assert (high.d[0] - low.d[0]) / (2 * h) == pytest.approx(here.second(0, 0), rel=1e-6, abs=1e-2)
    for i, name in enumerate(law.energy.arguments[1:], start=1):
        step = 1e-6 * LAW[name]
        ends = [law.energy.at({**LAW, name: LAW[name] + s}, gaps).d[0] for s in (-step, step)]
        assert (ends[1] - ends[0]) / (2 * step) == pytest.approx(here.second(i, 0), rel=1e-6, abs=1e-6)


def test_parting_a_unit_of_area_takes_the_work_of_adhesion() -> None:
    law = ContactAdhesion()
    work, _ = quad(lambda g: float(law.energy.at(LAW, np.array([g])).d[0, 0]), 0.0, LAW["range_m"])
    assert work == pytest.approx(LAW["work_j_m2"], rel=1e-9)
