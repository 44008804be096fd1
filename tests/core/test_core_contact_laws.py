"""Laws that effects add to contacts, on the compiled core, against differences of potentials and of rollouts."""

from __future__ import annotations

import numpy as np
import pytest
from against_differences import compare_derivatives
from steps_of_rollouts import check_steps
from strip_over_table import motion, strip_rig
from strips_that_touch import PRESS_AND_RUB, RIGS

from sim_core.effects.hooks import FrictionLaw, NormalLaw
from sim_core.effects.registry import all_effects
from sim_core.gradients import directions, simulate_tangent
from sim_core.rigs import list_parameters, with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-12, force_tolerance=1e-10)

WEAK = {
    "contact_adhesion": {"work_j_m2": 5e-3, "range_m": 2e-4},
    "contact_bonding": {"work_j_m2": 0.02, "range_m": 2e-4},
    "soft_layer": {"pressure_pa": 20.0, "thickness_m": 5e-4},
}
"""Attraction that lets go without a jump, after which searches that differ by round-off end on different branches; a
layer that the strip presses flat."""

LAWS = {n: WEAK.get(n, dict(e.example)) for n, e in all_effects().items() if isinstance(e, NormalLaw | FrictionLaw)}

DRAWN = {
    "gripper": motion(
        [0.0, 0.15, 0.2, 0.3],
        [[0, 0, 0], [0, 0, -0.058], [0.01, 0.003, -0.057], [0.0102, 0.003, -0.057]],
        [[0, 0, 0], [0, 50, 0], [0, 50, 4], [0, 50, 4]],
    )
}
"""Put down on the table, and drawn over it, fast and slowly, until it slides."""

ROUND_OFF = {"wrist": 1e-11, "side": 1e-12}
"""Of readings [N, px]: round-off of places of 0.1 m times the stiffness of the strip, E h = 6e5 N/m; and as seen."""

TIMES = step_times(0.0, 0.3, 0.01)


@pytest.mark.parametrize("name", LAWS)
def test_steps_end_in_balance_and_derivatives_of_potentials_are_those_of_differences(name):
    """Of contact with a shape, and the law does something there."""
    found = check_steps(build_scene(strip_rig(effects={name: LAWS[name]})), DRAWN, TIMES)
    without = simulate(build_scene(strip_rig()), DRAWN, TIMES, settings=TIGHT, keep_path=True)
    assert max(r.contacts for r in found.reports) > 0
    assert np.abs(found.path.positions - without.path.positions).max() > 1e-7


@pytest.mark.parametrize("name", ["contact_adhesion", "soft_layer", "pressure_friction", "stribeck_friction"])
@pytest.mark.parametrize("rig", ["crossing", "folded"])
def test_steps_of_surfaces_and_edges_end_in_balance(rig, name):
    scene = build_scene(RIGS[rig]().model_copy(update={"effects": _parsed(name)}))
    found = check_steps(scene, PRESS_AND_RUB[rig], TIMES)
    assert max(r.contacts for r in found.reports) > 0


def _parsed(name):
    return strip_rig(effects={name: LAWS[name]}).effects


def _parameters(name):
    return [f"effects.{name}.{p}" for p in LAWS[name]]


@pytest.mark.parametrize("name", LAWS)
def test_derivatives_between_impacts_against_differences_of_rollouts(name):
    rig = strip_rig(effects={name: LAWS[name]})
    names = [*_parameters(name), "strip.E_pa", "contacts.strip-table.friction", "gripper.offset_z_m"]
    compare_derivatives(rig, DRAWN, TIMES, names, TIGHT)


@pytest.mark.parametrize("name", ["contact_adhesion", "pressure_friction", "stribeck_friction"])
@pytest.mark.parametrize("rig", ["crossing", "folded"])
def test_derivatives_of_surfaces_and_edges_against_differences_of_rollouts(rig, name):
    changed = RIGS[rig]().model_copy(update={"effects": _parsed(name)})
    compare_derivatives(changed, PRESS_AND_RUB[rig], TIMES, _parameters(name), TIGHT)


@pytest.mark.parametrize("name", LAWS)
def test_derivatives_against_differences_of_rollouts(name):
    """In balance, so that nothing strikes."""
    settings = NewtonSettings(step_tolerance_m=1e-13, force_tolerance=1e-11)
    rig = strip_rig(effects={name: LAWS[name]}, solver={"dt_s": 0.01, "inertia": False, "integrator": "bdf2"})
    along = directions(rig, _parameters(name))
    values = {p.name: p.value for p in list_parameters(rig)}
    trace, derivatives = simulate_tangent(build_scene(rig), DRAWN, TIMES, along, settings=settings)
    assert max(r.contacts for r in trace.reports) > 0
    for k, direction in enumerate(along):
        wide = 1e-4 * abs(values[direction.name])
        low, high = (
            simulate(
                build_scene(with_parameters(rig, {direction.name: values[direction.name] + s * wide})),
                *(DRAWN, TIMES), settings=settings,
            )
            for s in (-1, 1)
        )  # fmt: skip
        for channel in ("wrist", "side"):
            central = (high.outputs[channel] - low.outputs[channel]) / (2.0 * wide)
            error = np.nanmax(np.abs(derivatives[channel][..., k] - central))
            assert error < 1e-6 * np.nanmax(np.abs(central)) + ROUND_OFF[channel] / wide, (channel, direction.name)
