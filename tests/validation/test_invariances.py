"""Orientation, units and repetition do not matter; momentum and balance are kept."""

import numpy as np
import pytest

from sysid.validation.invariances import balance, flight, repeated, turned_scene, units


def test_a_scene_turned_as_a_whole_does_the_same():
    """Sheet, gel, contact and friction together."""
    positions, energy, force = turned_scene()
    assert positions < 1e-9
    assert abs(energy) < 1e-9
    assert force < 1e-7


def test_what_holds_a_scene_carries_its_weight():
    excess, inner, free = balance()
    assert excess < 1e-8
    assert inner < 1e-12
    assert free < 1e-8


def test_a_second_run_is_the_same_bit_for_bit():
    assert repeated() == 0.0


def test_units_do_not_matter():
    assert units() < 1e-9


@pytest.mark.parametrize(("second_order", "order"), [(False, 1.0), (True, 2.0)], ids=["Euler", "BDF2"])
def test_a_free_card_keeps_its_momentum_and_loses_spin_with_the_order_of_the_integrator(second_order, order):
    linear, _ = flight(second_order, 50, bend=4.0)
    assert linear < 1e-11
    coarse, fine = (flight(second_order, steps)[1] for steps in (50, 100))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.15)
