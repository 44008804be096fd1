"""Physics with known solutions, and that the simulator gets nearer to them on finer meshes."""

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.solve.step import NewtonSettings, advance
from sim_core.solve.system import System
from sysid.validation.elasticas import HEAVY, TIP, heavy_strip, tip_loaded_strip
from sysid.validation.obstacles import (
    RING,
    ROOF,
    exact_cylinder,
    exact_hemisphere,
    pinched_cylinder,
    pinched_hemisphere,
    ring,
    roof,
)
from sysid.validation.planar_elastica import heavy, tip_loaded
from sysid.validation.plates import LAMBDA, SAG, frequencies, plate, sag
from sysid.validation.shells import HEMISPHERE, SLIT, hemisphere, slit_annulus
from sysid.validation.small_motions import linear_response, natural_vibrations
from sysid.validation.specimens import rest


@pytest.mark.parametrize("gamma", [g for g in HEAVY if g <= 100.0])
@pytest.mark.parametrize(("pattern", "cells"), [("regular", (40, 4)), ("irregular", (40, 4)), ("crossed", (80, 2))])
def test_a_heavy_strip_sags_as_an_elastica(pattern, cells, gamma):
    """One material, any mesh: the droop does not depend on the pattern."""
    np.testing.assert_allclose(heavy_strip(gamma, pattern, cells), heavy(gamma), rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("gamma", [10.0, 100.0])
@pytest.mark.parametrize("pattern", ["regular", "crossed"])
def test_the_heavy_strip_converges_with_the_mesh(pattern, gamma):
    """At least in proportion to the cell, from errors that are not yet round-off."""
    errors = [abs(heavy_strip(gamma, pattern, (n, 4))[1] / heavy(gamma)[1] - 1.0) for n in (20, 40, 80)]
    order = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (order > 1.0).all(), errors


@pytest.mark.parametrize("alpha", TIP)
def test_a_strip_under_a_tip_load(alpha):
    np.testing.assert_allclose(tip_loaded_strip(alpha, "regular", (40, 4)), tip_loaded(alpha), rtol=0.01)


@pytest.mark.parametrize("pattern", ["regular", "crossed", "irregular"])
def test_a_supported_plate_sags_as_plate_theory_says(pattern):
    assert sag("supported", pattern, 20) == pytest.approx(SAG["supported"], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("pattern", ["regular", "crossed", "irregular"])
def test_a_clamped_plate_converges_to_plate_theory(pattern):
    errors = [abs(sag("clamped", pattern, n) / SAG["clamped"] - 1.0) for n in (10, 20, 40)]
    assert errors[-1] < 0.01
    assert (np.log2(np.array(errors[:-1]) / np.array(errors[1:])) > 1.0).all(), errors


@pytest.mark.parametrize(("edges", "nu"), LAMBDA)
@pytest.mark.parametrize("pattern", ["regular", "irregular"])
def test_a_plate_vibrates_as_plate_theory_says(pattern, edges, nu):
    """Within 2 % on 32 cells a side, and from 16 of them with at least the first order."""
    coarse, fine = (np.abs(frequencies(edges, nu, pattern, n) / LAMBDA[edges, nu] - 1.0) for n in (16, 32))
    assert fine.max() < 0.02
    assert np.all(np.log2(coarse / fine) > 1.0), (coarse, fine)


def test_shapes_of_vibration_are_orthogonal_and_of_unit_mass():
    system = plate("cantilever", 0.3, "irregular", 8)
    _, shapes = natural_vibrations(system, 3)
    products = np.einsum("anj,nm,bmj->ab", shapes, system.mass.toarray(), shapes)
    np.testing.assert_allclose(products, np.eye(3), atol=1e-8)
    assert np.abs(shapes[0][:, 2]).max() > 100.0 * np.abs(shapes[0][:, :2]).max()


def test_vibrations_of_a_free_plate_are_refused():
    system = plate("cantilever", 0.3, "regular", 4)
    free = System(system.nodes, system.mass, np.zeros_like(system.prescribed), system.terms, np.zeros(3), inertia=False)
    with pytest.raises(ConfigError, match="without resistance"):
        natural_vibrations(free, 3)


def test_more_vibrations_than_unknowns_are_refused():
    with pytest.raises(ConfigError, match="unknowns"):
        natural_vibrations(plate("supported", 0.3, "regular", 2), 50)


def test_a_slit_annulus_is_lifted_into_a_screw():
    """Within 4 % on 64 x 8 cells, from twice the error on half of them."""
    coarse, fine = (np.abs(np.array(slit_annulus(cells)) / list(SLIT.values()) - 1.0) for cells in ((32, 4), (64, 8)))
    assert fine.max() < 0.04
    assert np.all(fine < 0.6 * coarse)


def test_a_curved_shell_bends_without_stretching():
    """Within 5 % on 16 cells a quarter, at a tenth of the load and at all of it."""
    np.testing.assert_allclose(hemisphere(16), list(HEMISPHERE.values()), rtol=0.05)


def test_a_ring_is_pressed_together():
    assert ring(24) == pytest.approx(RING, rel=0.005)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("found", "reference"),
    [
        (lambda: roof((64, 64)), lambda: ROOF),
        (lambda: pinched_cylinder((24, 20)), exact_cylinder),
        (lambda: pinched_hemisphere(24), exact_hemisphere),
    ],
    ids=["roof", "cylinder", "hemisphere"],
)
def test_curved_shells_under_small_loads(found, reference):
    assert found() == pytest.approx(reference(), rel=0.01)


def test_the_answer_to_small_loads_is_that_of_a_small_step():
    system = plate("cantilever", 0.3, "irregular", 8)
    loads = np.zeros_like(system.nodes)
    loads[system.nodes[:, 0] > 0.049, 2] = 1e-7
    moved = linear_response(system, loads)
    system.loads[:] = loads
    state, _ = advance(system, rest(system), system.nodes, 1.0, NewtonSettings(step_tolerance_m=1e-13))
    np.testing.assert_allclose(moved[:, 2], (state.x - system.nodes)[:, 2], rtol=1e-4, atol=1e-12)


def test_loads_on_what_is_not_held_are_refused():
    for cells in (2, 3, 8):
        free = plate("supported", 0.3, "regular", cells)
        loose = System(free.nodes, free.mass, np.zeros_like(free.prescribed), free.terms, np.zeros(3), inertia=False)
        with pytest.raises(ConfigError, match="without resistance"):
            linear_response(loose, np.ones_like(free.nodes))
