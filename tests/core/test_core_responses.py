"""Responses along a frozen path on the compiled core, against changes of rollouts."""

from __future__ import annotations

import numpy as np
import pytest
from strip_over_table import motion, strip_rig

from sim_core.effects.registry import all_effects
from sim_core.gradients import directions, frozen_path
from sim_core.gradients.amendments import Amendment, Modulation
from sim_core.scene import build_scene
from sim_core.scene.kept import built_from
from sim_core.simulate import simulate, step_times
from sim_core.solve.report import NewtonSettings
from sysid.model.responses import way_of, with_effects

TIGHT = NewtonSettings(step_tolerance_m=1e-13, force_tolerance=1e-11)

PRESSED = {
    "gripper": motion(
        [0.0, 0.15, 0.3], [[0, 0, 0], [0, 0, -0.058], [0.01, 0.003, -0.058]], [[0, 0, 0], [0, 50, 0], [0, 50, 4]]
    )
}
TIMES = step_times(0.0, 0.3, 0.01)
NUMBERS = ["strip.E_pa", "contacts.strip-table.friction", "gripper.offset_x_m", "strip.density_kg_m3", "gravity.x_m_s2",
           "strip.stiffness_damping_s", "strip.mass_damping_per_s"]  # fmt: skip


STRONG = {"bending_plasticity", "static_friction", "stribeck_friction", "sheet_orthotropy", "pressure_friction"}
"""Laws that do not vanish with a number, or of which little does nothing here; the others are taken at a share of their
examples, with which what they do grows in proportion."""

SHARE = 1e-3


def _laws(rig):
    """Each law that may act on the rig, a little of it."""
    found = {}
    for name, effect in all_effects().items():
        example = dict(effect.example)
        if name not in STRONG and effect.applies(rig) and way_of(rig, {name: example}, built_from) == "law":
            vanishing = {q.name for q in effect.parameters if q.vanishing == 0.0}
            found[name] = {k: SHARE * v if k in vanishing else v for k, v in example.items()}
    return found


def test_responses_are_the_changes_of_rollouts_with_a_little_of_the_laws():
    rig = strip_rig()
    laws = _laws(rig)
    assert len(laws) > 12
    rigs = [with_effects(rig, {name: values}) for name, values in laws.items()]
    amendments = [Amendment(n, r, build_scene(r)) for n, r in zip(laws, rigs, strict=True)]
    trace, found = frozen_path.simulate_responses(build_scene(rig), PRESSED, TIMES, [], amendments)
    assert max(report.contacts for report in trace.reports) > 0
    plain = simulate(build_scene(rig), PRESSED, TIMES, settings=TIGHT).outputs
    for k, (name, amended) in enumerate(zip(laws, rigs, strict=True)):
        changed = simulate(build_scene(amended), PRESSED, TIMES, settings=TIGHT).outputs
        for channel, values in plain.items():
            true = np.nan_to_num(changed[channel] - values).reshape(len(TIMES), -1)
            error = np.abs(np.nan_to_num(found[channel][..., k]).reshape(true.shape) - true).max(axis=1)
            size = float(np.abs(true).max())
            assert size > 0.0, (channel, name)
            assert np.mean(error < 0.02 * size) > 0.8, (channel, name, size, error / size)  # but for impacts


def test_parameters_that_change_all_the_time_are_multiples_of_their_derivatives():
    rig = strip_rig()
    along = directions(rig, NUMBERS)
    courses = [Modulation({k: lambda t: 2.0 + 0.0 * t}) for k in range(len(NUMBERS))]
    _, found = frozen_path.simulate_responses(build_scene(rig), PRESSED, TIMES, along, [], courses)
    for channel, values in found.items():
        own, twice = values[..., : len(along)], values[..., len(along) :]
        np.testing.assert_allclose(twice, 2.0 * own, rtol=0.0, atol=1e-9 * np.nanmax(np.abs(own)), err_msg=channel)


def test_laws_of_other_mounts_that_give_way_too_are_followed():
    """A law and a compliance at once change what each of them does, and nothing else."""
    rig = strip_rig()
    some = _laws(rig)
    names = ["sheet_stiffening", "end_effector_compliance"]
    effects = [{n: some[n]} for n in names] + [{n: some[n] for n in names}]
    amendments = [Amendment(str(k), r := with_effects(rig, e), build_scene(r)) for k, e in enumerate(effects)]
    _, found = frozen_path.simulate_responses(build_scene(rig), PRESSED, TIMES, [], amendments)
    for channel, values in found.items():
        size = np.nanmax(np.abs(values[..., 2]))
        assert np.nanmax(np.abs(values[..., 0] + values[..., 1] - values[..., 2])) < 1e-9 * size, channel


@pytest.mark.parametrize("instants", [1, 4])
def test_columns_that_are_sums_move_mounts_as_the_matrix_of_their_weights_says(instants):
    rng, count = np.random.default_rng(5), 6
    moving = [{"hand": rng.normal(size=(6, count)) * ([1.0] * 3 + [0.0] * 3)} for _ in range(instants)]
    together = Modulation({0: lambda t: 1.0 - t, 2: np.sin})
    sums = frozen_path._sums([Modulation({1: np.cos}), together, Modulation({})], 3, np.linspace(0.0, 1.5, 4))
    found = frozen_path._mixed(moving, sums)
    assert len(found) == 4
    for k, t in enumerate(np.linspace(0.0, 1.5, 4)):
        weights = np.eye(count)
        weights[1, 3], weights[0, 4], weights[2, 4] = np.cos(t), 1.0 - t, np.sin(t)
        np.testing.assert_allclose(found[k]["hand"], moving[min(k, instants - 1)]["hand"] @ weights, atol=1e-15)
