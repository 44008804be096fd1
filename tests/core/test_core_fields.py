"""Stiffness that changes in time, and from place to place, on the core, against differences of potentials and of
rollouts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from adjoint_against_columns import compare_with_columns, weights
from against_differences import compare_derivatives
from steps_of_rollouts import check_steps
from strip_over_table import strip_rig
from test_core_gels import PRESSED, SHAKEN, STATIC, TIGHT, gel_rig
from test_core_gels import TIMES as GEL_TIMES
from test_core_materials import PRESSED_DOWN, SWING, TIMES, _against_differences

from sim_core.core.pointwise import Law
from sim_core.effects import all_effects, registry
from sim_core.effects.sheet_soft_spot import SheetSoftSpot
from sim_core.gradients import Backward, Tape
from sim_core.rigs import with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import simulate


def drying(x: float, y: float, z: float, t: float, depth: float, x_m: float, y_m: float, radius_m: float) -> float:
    """A spot that comes in the course of a tenth of a second."""
    return 1.0 + depth * math.expm1(-t / 0.1) * math.exp(-0.5 * ((x - x_m) ** 2 + (y - y_m) ** 2) / radius_m**2)


class SheetDrying(SheetSoftSpot):
    name = "sheet_drying"
    changes = True
    formula = Law(drying, order=1)


@pytest.fixture
def theirs(monkeypatch):
    """An effect of another package, by which stretching and bending change in time, unevenly."""

    class Point:
        name, value = "sheet_drying", "their_package.sheet_drying"

        @staticmethod
        def load():
            return SheetDrying

    monkeypatch.setattr(registry, "entry_points", lambda group: [Point] if group == registry.GROUP else [])
    registry.all_effects.cache_clear()
    yield
    registry.all_effects.cache_clear()


WARMING = {"gel_warming": {"change": 0.6, "tau_s": 0.03}}
RELAXING = {"gel_relaxation": {"share": 0.3, "tau_s": 0.02}, "gel_stiffness_gradient": {"x_per_m": 20.0}}
OWN = ["effects.gel_warming.change", "effects.gel_warming.tau_s", "gel.E_pa", "gel.nu", "gel.stiffness_damping_s"]
MORE = ["effects.gel_relaxation.share", "effects.gel_stiffness_gradient.x_per_m"]


@pytest.mark.parametrize("effects", [WARMING, WARMING | RELAXING], ids=["alone", "with others"])
def test_a_gel_that_warms_up(effects):
    rig, names = gel_rig(effects=effects), OWN if effects is WARMING else OWN + MORE
    found = check_steps(build_scene(rig), PRESSED, GEL_TIMES)
    cold = {name: values for name, values in effects.items() if name not in WARMING}
    plain = simulate(build_scene(gel_rig(effects=cold)), PRESSED, GEL_TIMES, settings=TIGHT, keep_path=True)
    assert np.abs(found.path.positions - plain.path.positions).max() > 1e-7
    compare_derivatives(rig, PRESSED, GEL_TIMES, names, TIGHT)
    compare_with_columns(rig, PRESSED, GEL_TIMES, names)
    _against_differences(rig, SHAKEN, GEL_TIMES, names)


@pytest.mark.usefixtures("theirs")
@pytest.mark.parametrize("others", [(), ("bending_plasticity", "viscoelastic_sheet", "sheet_stiffness_gradient")])
def test_a_sheet_that_changes_in_time(others):
    effects = {name: dict(all_effects()[name].example) for name in ("sheet_drying", *others)}
    rig = strip_rig(effects=effects)
    check_steps(build_scene(rig), PRESSED_DOWN, TIMES)
    names = [f"effects.{name}.{p}" for name in effects for p in effects[name]]
    body = ["strip.E_pa", "strip.thickness_m", "strip.stiffness_damping_s", "gripper.offset_z_m"]
    compare_derivatives(rig, PRESSED_DOWN, TIMES, [*names, *body], TIGHT)
    compare_with_columns(rig, PRESSED_DOWN, TIMES, [*names, *body])


def stands_as_one_of_its_modulus(changing, plain, poses, times, factor, about):
    """In balance and without damping a step ends where the body ends whose moduli are those at the start of the step;
    ``factor``: of the places of elements and of the time."""
    found = simulate(changing, poses, times, settings=TIGHT, keep_path=True).path.positions
    here = plain.fields[about]
    for k in (1, len(times) // 2, len(times) - 1):
        plain.fields[about] = here * factor(float(times[k - 1]))
        expected = simulate(plain, poses, times, settings=TIGHT, keep_path=True).path.positions
        assert np.abs(found[k] - expected[k]).max() < 1e-13


def test_a_gel_that_warms_up_stands_as_one_of_its_modulus():
    rigs = [gel_rig(solver=STATIC, damping_s=0.0, effects=effects) for effects in (WARMING, {})]
    change, tau = WARMING["gel_warming"].values()

    def factor(t):
        return 1.0 + change * (1.0 - math.exp(-t / tau))

    stands_as_one_of_its_modulus(*map(build_scene, rigs), SHAKEN, GEL_TIMES, factor, "gel.E_pa")


@pytest.mark.usefixtures("theirs")
def test_a_sheet_that_dries_stands_as_one_of_its_moduli():
    example = dict(all_effects()["sheet_drying"].example)
    solver = {"dt_s": 0.01, "inertia": False, "integrator": "bdf2"}
    none = {"strip.stiffness_damping_s": 0.0, "strip.mass_damping_per_s": 0.0}
    changing, plain = (
        build_scene(with_parameters(strip_rig(solver=solver, effects=effects), none))
        for effects in ({"sheet_drying": example}, {})
    )
    mesh = plain.bodies["strip"].mesh
    x, y, _ = mesh.nodes[mesh.triangles].mean(axis=1).T
    spot = np.exp(-0.5 * ((x - example["x_m"]) ** 2 + (y - example["y_m"]) ** 2) / example["radius_m"] ** 2)

    def factor(t):
        return 1.0 - example["depth"] * (1.0 - math.exp(-t / 0.1)) * spot

    stands_as_one_of_its_modulus(changing, plain, SWING, TIMES, factor, "strip.E_pa")


@pytest.mark.usefixtures("theirs")
@pytest.mark.parametrize("others", [(), ("bending_plasticity", "viscoelastic_sheet")])
def test_fields_of_a_sheet_that_changes_in_time_against_differences_of_rollouts(others):
    """One value an element, at the start; the factor grows with the time."""
    effects = {name: dict(all_effects()[name].example) for name in ("sheet_drying", *others)}
    scene, rng = build_scene(strip_rig(effects=effects)), np.random.default_rng(5)
    tape = Tape(scene, SWING, TIMES, TIGHT)
    given = {"side": weights(tape.trace)["side"]}
    names = [n for n in scene.fields.names if n != "strip.rest_m"]
    found = Backward(tape, [], names).gradient(0.0, given).fields
    for name in names:
        here = scene.fields[name]
        along = rng.standard_normal(here.shape) * (here if np.abs(here).max() > 0.0 else 1.0)
        ends = []
        for h in (1e-5, -1e-5):
            scene.fields[name] = here + h * along
            ends.append(np.nansum(simulate(scene, SWING, TIMES, settings=TIGHT).outputs["side"] * given["side"]))
        scene.fields[name] = here
        expected = float(np.vdot(found[name], along))
        assert abs((ends[0] - ends[1]) / 2e-5 - expected) < 1e-6 * np.abs(found[name] * along).sum() + 1e-5, name
