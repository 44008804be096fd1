"""Material laws, plastic flow and air drag on the core, against differences of potentials and of rollouts."""

from __future__ import annotations

import numpy as np
import pytest
from against_differences import compare_derivatives
from steps_of_rollouts import check_halved_step, check_steps
from strip_over_table import SWING, motion, strip_rig
from test_core_gels import PRESSED, SHAKEN, gel_rig
from test_core_gels import TIMES as GEL_TIMES

from sim_core.core.rollout import CoreRollout
from sim_core.effects import all_effects
from sim_core.effects.hooks import MaterialLaw
from sim_core.gradients import directions, simulate_tangent
from sim_core.rigs import list_parameters, with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-13, force_tolerance=1e-11)

NUMBERS = {"sheet_stiffening": {"coefficient": 1e9}, "sheet_swelling": {"strain_x": 2e-5, "strain_y": -1e-5}}
"""In place of examples that are as stiff as a stop, or buckle the sheet between its clamps, where searches that differ
by round-off end on different branches."""

SHEETS, GELS = (
    [n for n, e in all_effects().items() if isinstance(e, MaterialLaw) and ("solid" in e.parts) == solid]
    for solid in (False, True)
)
SHEETS = [*SHEETS, "bending_plasticity", "air_drag"]

PRESSED_DOWN = {
    "gripper": motion(
        [0.0, 0.15, 0.3], [[0, 0, 0], [0, 0, -0.058], [0.01, 0.003, -0.058]], [[0, 0, 0], [0, 50, 0], [0, 50, 4]]
    )
}
TIMES = step_times(0.0, 0.3, 0.01)


def values(name):
    return dict(NUMBERS.get(name, all_effects()[name].example))


def case(name, **changes):
    """A rig with the effect, motions that show it, and instants."""
    if name in GELS:
        return gel_rig(effects={name: values(name)}, **changes), PRESSED, GEL_TIMES
    return strip_rig(effects={name: values(name)}, **changes), PRESSED_DOWN, TIMES


@pytest.mark.parametrize("name", [*SHEETS, *GELS])
def test_steps_end_in_balance_and_derivatives_of_potentials_are_those_of_differences(name):
    """With what bodies remember there, and the law does something."""
    rig, poses, times = case(name)
    found = check_steps(build_scene(rig), poses, times)
    without = build_scene(gel_rig() if name in GELS else strip_rig())
    plain = simulate(without, poses, times, settings=TIGHT, keep_path=True)
    assert np.abs(found.path.positions - plain.path.positions).max() > 1e-7


def own(name):
    return [f"effects.{name}.{p}" for p in values(name)]


@pytest.mark.parametrize("name", [*SHEETS, *GELS])
def test_derivatives_between_impacts_against_differences_of_rollouts(name):
    rig, poses, times = case(name)
    body = ["gel.E_pa", "gel.nu"] if name in GELS else ["strip.E_pa", "strip.thickness_m"]
    compare_derivatives(rig, poses, times, [*own(name), *body, "gripper.offset_z_m"], TIGHT)


def test_derivatives_of_laws_on_graded_sheets_against_differences_of_rollouts():
    effects = {
        "viscoelastic_sheet": values("viscoelastic_sheet"),
        "bending_plasticity": values("bending_plasticity"),
        "sheet_stiffness_gradient": {"x_per_m": 3.0},
    }
    names = ["effects.sheet_stiffness_gradient.x_per_m", "effects.bending_plasticity.hardening_ratio", "strip.E_pa"]
    compare_derivatives(strip_rig(effects=effects), PRESSED_DOWN, TIMES, names, TIGHT)


def test_derivatives_of_laws_on_graded_gels_against_differences_of_rollouts():
    effects = {"viscoelastic_gel": values("viscoelastic_gel"), "gel_stiffness_gradient": {"x_per_m": 20.0}}
    names = ["effects.gel_stiffness_gradient.x_per_m", "effects.viscoelastic_gel.tau_s"]
    compare_derivatives(gel_rig(effects=effects), PRESSED, GEL_TIMES, names, TIGHT)


ROUND_OFF = {"wrist": 4e-11, "side": 4e-11}
"""Of readings [N, px]: round-off of places of 0.1 m times the stiffness of the strip, E h = 6e5 N/m; and as seen."""


@pytest.mark.parametrize("name", [*SHEETS, *GELS])
def test_derivatives_against_differences_of_rollouts(name):
    """In the air, where nothing strikes."""
    poses, times = (SHAKEN, GEL_TIMES) if name in GELS else (SWING, TIMES)
    _against_differences(case(name)[0], poses, times, own(name))


def test_derivatives_of_a_graded_sheet_that_yields_against_differences_of_rollouts():
    effects = {"bending_plasticity": values("bending_plasticity"), "sheet_stiffness_gradient": {"x_per_m": 3.0}}
    name = "effects.sheet_stiffness_gradient.x_per_m"
    _against_differences(strip_rig(effects=effects), SWING, TIMES, [name])


def _against_differences(rig, poses, times, names):
    along, known = directions(rig, names), {p.name: p.value for p in list_parameters(rig)}
    _, derivatives = simulate_tangent(build_scene(rig), poses, times, along, settings=TIGHT)
    for k, name in enumerate(names):
        wide = 1e-4 * abs(known[name])
        low, high = (
            simulate(build_scene(with_parameters(rig, {name: known[name] + s * wide})), poses, times, settings=TIGHT)
            for s in (-1, 1)
        )
        for channel in ("wrist", "side"):
            central = (high.outputs[channel] - low.outputs[channel]) / (2.0 * wide)
            error = np.nanmax(np.abs(derivatives[channel][..., k] - central))
            assert error < 1e-6 * np.nanmax(np.abs(central)) + ROUND_OFF[channel] / wide, (channel, name)


LASTING = {"bending_plasticity": ["strip.E_pa"], "bending_friction": [], "gel_mullins": ["gel.E_pa"]}


@pytest.mark.parametrize("name", LASTING)
def test_what_is_left_and_its_derivatives_go_on_into_the_next_rollout(name):
    """Derivatives are those of differences of both rollouts, in a row."""
    rig, poses, times = case(name)
    names = [*own(name), *LASTING[name]]
    scene, along = build_scene(rig), directions(rig, names)
    first, _ = simulate_tangent(scene, poses, times, along, settings=TIGHT)
    _, found = simulate_tangent(scene, poses, times, along, settings=TIGHT, left=first.left)
    known = {p.name: p.value for p in list_parameters(rig)}

    def off(slopes, low, high, wide):
        """Largest errors by instants."""
        error = np.abs(slopes - (high - low) / (2.0 * wide)).reshape(len(slopes), -1)
        return np.nanmax(error, axis=1) / np.nanmax(np.abs(slopes))

    for k, parameter in enumerate(names):
        errors = []
        for wide in (1e-4 * known[parameter], 1e-5 * known[parameter]):
            memory, shape, readings = [], [], []
            for sign in (-1, 1):
                end = build_scene(with_parameters(rig, {parameter: known[parameter] + sign * wide}))
                before = simulate(end, poses, times, settings=TIGHT)
                own_memory = [v.ravel() for kept in before.left.internals.values() for v in kept.values()]
                memory.append(np.concatenate(own_memory)[None])
                shape.append(before.left.x[None])
                readings.append(simulate(end, poses, times, settings=TIGHT, left=before.left).outputs)
            by = np.concatenate([v[..., k].ravel() for kept in first.left.by_internals.values() for v in kept.values()])
            errors.append(
                {
                    "memory": off(by[None], *memory, wide),
                    "shape": off(first.left.by_x[None, ..., k], *shape, wide),
                    **{c: off(slopes[..., k], *(r[c] for r in readings), wide) for c, slopes in found.items()},
                }
            )
        for what in errors[0]:
            nearest = np.minimum(errors[0][what], errors[1][what])
            assert np.mean(nearest < 3e-4) > 0.9, (what, parameter, nearest)


@pytest.mark.parametrize("name", LASTING)
def test_the_next_rollout_begins_with_what_is_left(name):
    """To the bit before anything moves, which is not what virgin bodies remember."""
    rig, poses, times = case(name)
    scene = build_scene(rig)
    left = simulate(scene, poses, times, settings=TIGHT).left
    found = []
    for before in (left, None):
        core = CoreRollout(scene, poses, times, TIGHT)
        core.settle(left=before, balanced=False)
        found.append(core.state_now(0.0).internals)
    for term, own in left.internals.items():
        for memory, value in own.items():
            assert np.array_equal(found[0][term][memory], value)
            assert np.abs(found[1][term][memory] - value).max() > 0.1 * np.abs(value).max() > 0.0


@pytest.mark.parametrize("name", ["viscoelastic_sheet", "bending_plasticity"])
def test_halved_steps_go_on_from_what_bodies_remember(name):
    rig, poses, times = case(name)
    check_halved_step(build_scene(rig), poses, times)
