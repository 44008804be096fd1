"""Laws that effects add to contact: derivatives of all kinds of contact terms, and the force of a known pull-off."""

import numpy as np
import pytest
from contact_scenes import LAW, Two, on_rigid
from potentials import check_derivatives

from sim_core.contact.shapes import HALF_SPACE, SPHERE
from sim_core.effects.contact_adhesion import ContactAdhesion
from sim_core.effects.static_friction import StaticFriction

STICKY = {"contact_adhesion.work_j_m2": 0.4, "contact_adhesion.range_m": 6e-4, "static_friction.excess": 0.4}
EFFECTS = (ContactAdhesion(), StaticFriction())
SQUARE = ([[0.0, 0.0, 0.0], [4e-4, 0.0, 0.0], [4e-4, 4e-4, 0.0], [0.0, 4e-4, 0.0]], [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("gap", [1e-4, 3e-4, 5e-4], ids=["pressed", "pulled", "far out"])
def test_derivatives_between_sheets(gap):
    """Within the range of pressure, and beyond it within that of attraction."""
    two = Two(gap=gap, law={**LAW, **STICKY}, effects=EFFECTS)
    x = two.nodes + 2e-5 * np.random.default_rng(5).standard_normal(two.nodes.shape)
    two.touching(x)
    x[two.upper] += [6e-7, -8e-7, 0.0]
    check_derivatives(two.look, x, h=1e-9, tolerance=1e-4)


@pytest.mark.parametrize("gap", [1e-4, 3e-4], ids=["pressed", "pulled"])
def test_without_curvature_the_hessian_stays_positive(gap):
    """Attraction that weakens with the gap is left out of it, as the curvature of gaps is."""
    two = Two(gap=gap, law={**LAW, **STICKY}, elastic=False, effects=EFFECTS)
    two.touching(two.nodes + 2e-5 * np.random.default_rng(3).standard_normal(two.nodes.shape))
    values = np.linalg.eigvalsh(two.look.hessian())
    assert values[0] > -1e-10 * values[-1]


@pytest.mark.parametrize("shape", [[HALF_SPACE, 0, 0, 0, 0], [SPHERE, 0.01, 0, 0, 0]], ids=["half space", "sphere"])
def test_derivatives_on_rigid_shapes(shape):
    nodes = np.array(SQUARE[0]) + [0.0, 0.0, 2.5e-4 if shape[0] == HALF_SPACE else 0.01 + 2.5e-4]
    look, _ = on_rigid(shape, nodes, SQUARE[1], {**LAW, **STICKY}, effects=EFFECTS)
    x = np.vstack([nodes, np.zeros(3)])
    look.begin(x, dt=0.01)
    check_derivatives(look, x, h=1e-9, tolerance=1e-5)


def test_a_patch_is_pulled_off_with_three_halves_of_the_work_over_the_range():
    """F = A 3 w / (2 d) at half the range d, where pressure has long ended."""
    work, span = 0.4, 1e-3
    law = {**LAW, "contact_adhesion.work_j_m2": work, "contact_adhesion.range_m": span}
    forces = []
    for gap in np.linspace(2e-4, 1.1e-3, 181):
        nodes = np.array(SQUARE[0]) + [0.0, 0.0, gap]
        look, _ = on_rigid([HALF_SPACE, 0, 0, 0, 0], nodes, SQUARE[1], law, effects=EFFECTS[:1])
        x = np.vstack([nodes, np.zeros(3)])
        look.begin(x, dt=0.01)
        look.x[:] = x
        forces.append(float(look.gradient()[:-1, 2].sum()))
        assert not look.end().internals["rigid"]["load"].any()
    area = (4e-4) ** 2
    assert max(forces) == pytest.approx(1.5 * area * work / span, rel=1e-3)
    assert forces[-1] == 0.0


def test_friction_goes_with_what_keeps_surfaces_apart():
    """Attraction presses surfaces together and so raises friction through the load alone (Derjaguin 1934)."""
    loads, rubbing = [], []
    for law, effects in (({**LAW, **STICKY}, EFFECTS[:1]), (LAW, ())):
        forces = []
        for friction in (LAW["friction"], 0.0):
            two = Two(gap=1e-4, law={**law, "friction": friction}, effects=effects)
            loads.append(two.touching(two.nodes)["down"]["load"])
            two.look.x[two.upper, 0] += 1e-4
            forces.append(two.look.at().forces["down"][two.upper, 0].sum())
        rubbing.append(forces[0] - forces[1])
    assert np.array_equal(loads[0], loads[2]) and loads[0].any()
    assert rubbing[0] == pytest.approx(rubbing[1], rel=1e-9) and rubbing[0] < 0.0
