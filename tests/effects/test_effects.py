"""Every effect vanishes bit for bit, shows when it is there, and follows its law."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effect_examples import TYPICAL

from sim_core.effects import RecordingScales, active_effects, all_effects, amended, effect_by_name
from sim_core.effects.hooks import ClockMap, ReadingMap
from sim_core.errors import ConfigError
from sim_core.materials.elastic import plane_stress
from sim_core.rigs import list_parameters, parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, simulate, step_times
from sysid.diagnosis.candidates import hypotheses
from sysid.model.sensor_streams import predicted, predicted_back, predicted_derivatives, total_delay

MOTION = (
    [0.0, 0.1, 0.25, 0.4, 0.5, 0.6, 0.7, 0.8],
    [[0, 0, 0], [0, 0, -0.01], [0, 0, 0], [0.055, 0, 0], [0.055, 0, -0.0008], [0.058, 0, -0.0008],
     [0.055, 0, -0.0008], [0.055, 0, 0]],
)  # fmt: skip


def commanded(rig):
    """The rig with its finger driven by the poses that it was commanded."""
    finger = rig.end_effectors["finger"].model_copy(update={"driven_by": "commanded"})
    return rig.model_copy(update={"end_effectors": {"finger": finger}})


TRACES = {}
"""Rollouts by the rig's numbers and effects that act in them, and by the motion."""


def readings(rig, poses):
    times = step_times(0.0, float(poses["finger"].times[-1]), rig.solver.dt_s)
    within = {k: v for k, v in rig.effects.items() if not isinstance(effect_by_name(k), ReadingMap | ClockMap)}
    moved = amended(rig.model_copy(update={"effects": within}))
    key = moved.model_dump_json(), poses["finger"].times.tobytes(), poses["finger"].positions.tobytes()
    if key not in TRACES:
        TRACES[key] = simulate(build_scene(moved), poses, times)
    return {c: predicted(TRACES[key], rig, c, times) for c in TRACES[key].outputs}


def test_every_effect_is_tried_here():
    assert set(TYPICAL) == {e.name for e in all_effects().values()}


@pytest.mark.parametrize("name", sorted(TYPICAL))
def test_vanishes_and_shows_otherwise(small_rig, visit, name):
    effect = effect_by_name(name)
    off = {p.name: TYPICAL[name][p.name] if p.vanishing is None else p.vanishing for p in effect.parameters}
    plain = readings(small_rig(), visit(*MOTION))
    rig = small_rig()
    absent = readings(rig.model_copy(update={"effects": {name: off}}), visit(*MOTION))
    present = readings(small_rig(effects={name: TYPICAL[name]}), visit(*MOTION))
    for channel in plain:
        size = np.nanmax(np.abs(plain[channel]))  # searches end at 1e-6 of the largest force
        np.testing.assert_allclose(absent[channel], plain[channel], rtol=0.0, atol=1e-6 * size, err_msg=channel)
    assert max(np.nanmax(np.abs(plain[c] - present[c])) / np.nanmax(np.abs(plain[c])) for c in plain) > 1e-6


@pytest.mark.parametrize("effect", list(all_effects().values()), ids=lambda e: e.name)
def test_says_what_it_is(effect, small_rig):
    rig = commanded(small_rig())
    assert effect.title and effect.words.endswith(".") and effect.slot
    assert effect.variants(rig), "applies to a rig with a sheet, a gel, contact, sensors and a hand"
    assert any(p.vanishing is not None for p in effect.parameters)
    for variant in effect.variants(rig):
        assert set(variant) == {p.name for p in effect.parameters}
    assert set(effect.twins) < {*all_effects()} - {effect.name} and (effect.separated_by or not effect.twins)
    assert f"`{effect.name}`" in (Path(__file__).parents[2] / "docs" / "effects.md").read_text()


def test_hypotheses_cover_the_typical_values(small_rig):
    """Each time constant of a law is a point of the grid, and each amplitude has a column, alone."""
    scales = RecordingScales(1.0, 0.01, 1.0, 0.01, 0.1)
    found = hypotheses(commanded(small_rig()), scales)
    by_name = {name: [h for h in found if h.effect.name == name] for name in all_effects()}
    relaxation = by_name["gel_relaxation"]
    assert {h.shape["tau_s"] for h in relaxation} == {0.01, 0.05, 0.25}
    assert len({h.amplitudes[0].typical for h in by_name["bending_plasticity"]}) > 1
    assert len(by_name["wrench_offset"][0].amplitudes) == 12, "searches of offsets begin at nothing"
    for h in found:
        for amplitude, column in zip(h.amplitudes, h.columns(), strict=True):
            values = column[h.key]
            for other in h.amplitudes:
                alone = values[other.parameter.name]
                assert alone == (other.typical if other is amplitude else other.none)
        inside = h.values([1.0] * len(h.amplitudes))
        assert all(p.lower <= inside[p.name] <= p.upper for p in h.effect.parameters if p.name in inside)


def test_measured_poses_have_the_lag_of_the_command_in_them(small_rig):
    """So it is no hypothesis there; driven by commands it is."""
    lag = all_effects()["command_lag"]
    assert not lag.variants(small_rig()) and len(lag.variants(commanded(small_rig()))) == 2


def test_what_a_rig_does_not_have_is_not_tried(small_rig):
    empty = small_rig().model_copy(
        update={"bodies": {}, "clamps": (), "contacts": (), "sensors": {}, "cameras": {}, "end_effectors": {}}
    )
    assert not [e.name for e in all_effects().values() if e.applies(empty) or e.variants(empty)]


def test_orthotropy_gives_the_two_moduli_and_their_mean():
    c = plane_stress({"E_pa": 1e9, "nu": 0.3, "anisotropy_ratio": 4.0})
    compliance = np.linalg.inv(c)
    first, second = 1.0 / compliance[0, 0], 1.0 / compliance[1, 1]
    assert first / second == pytest.approx(4.0)
    assert np.sqrt(first * second) == pytest.approx(1e9)
    turned = np.linalg.inv(
        plane_stress({"E_pa": 1e9, "nu": 0.3, "anisotropy_ratio": 4.0, "grain_angle_rad": np.pi / 2})
    )
    assert 1.0 / turned[0, 0] == pytest.approx(second)


def test_compliance_moves_the_gel_by_force_times_compliance(small_rig, visit):
    compliance = 5e-4
    rig = small_rig(effects={"end_effector_compliance": {"compliance_m_per_n": compliance}})
    scene = build_scene(rig)
    poses = visit([0.0, 0.2, 0.4, 0.8], [[0, 0, 0], [0.055, 0, 0], [0.055, 0, -0.0008], [0.055, 0, -0.0008]])
    trace = simulate(scene, poses, step_times(0.0, 0.8, 0.02), keep_states=True)
    deflection = trace.states.origins["finger"][-1] - poses["finger"].positions[-1]
    force = trace.outputs["wrench"][-1, :3]
    assert force[2] > 0.1
    # The sensor does not feel the weight of the glued nodes (below 1 mN), the spring does.
    assert deflection == pytest.approx(compliance * force, rel=1e-3, abs=compliance * 1e-3)


def test_a_compliant_hand_begins_every_rollout_alike(small_rig, visit):
    """What it gave way at the end of one is forgotten, also where nothing settles."""
    data = small_rig(effects={"end_effector_compliance": {"compliance_m_per_n": 1e-3}}).model_dump()
    data["bodies"]["ball"] = {
        "type": "affine", "shape": {"type": "sphere", "radius_m": 0.004}, "pose": {"position_m": [0.0, 0.1, 0.05]},
        "material": {"density_kg_m3": 1000.0},
    }  # fmt: skip
    scene, poses = build_scene(parse_rig(data, "giving way")), visit([0.0, 0.04], [[0, 0, 0], [0, 0, 0.001]])
    first, second = (simulate(scene, poses, step_times(0.0, 0.04, 0.02)).outputs["wrench"] for _ in range(2))
    assert np.array_equal(first, second) and np.abs(first[-1]).max() > 0.0


def test_static_friction_holds_by_its_excess_and_then_lets_go(small_rig, visit):
    slow = visit([0.0, 0.2, 0.4, 0.6, 3.0],
                 [[0, 0, 0], [0.055, 0, 0], [0.055, 0, -0.0006], [0.055, 0, -0.0006], [0.058, 0, -0.0006]])  # fmt: skip
    plain = readings(small_rig(), slow)["wrench"]
    sticky = readings(small_rig(effects={"static_friction": {"excess": 0.5}}), slow)["wrench"]
    ratio = np.abs(plain[:, 0]) / np.maximum(plain[:, 2], 1e-6)
    assert ratio[-1] == pytest.approx(0.4, rel=0.02)
    held = np.abs(sticky[:, 0]) / np.maximum(sticky[:, 2], 1e-6)
    assert held[40:].max() == pytest.approx(0.6, rel=0.08)


def test_a_sheet_that_falls_flat_reaches_its_terminal_speed(small_rig):
    rig = small_rig(effects={"air_drag": {"drag_coefficient": 1.5}})
    bodies = {"card": rig.bodies["card"]}
    alone = rig.model_copy(
        update={"bodies": bodies, "clamps": (), "contacts": (), "sensors": {}, "cameras": {}, "end_effectors": {}}
    )
    simulation = Simulation(build_scene(alone))
    for _ in range(150):
        simulation.step({}, 0.02)
    weight = 400.0 * 3e-4 * 9.81
    terminal = np.sqrt(2.0 * weight / (1.2 * 1.5))
    assert simulation.state.v[:, 2] == pytest.approx(-terminal, rel=1e-3)


def test_sensor_effects_change_readings_exactly(small_rig, visit):
    poses = visit([0.0, 0.4], [[0, 0, 0], [0, 0, -0.002]])
    times = step_times(0.0, 0.4, 0.02)
    rig = small_rig(effects={"wrench_offset": TYPICAL["wrench_offset"], "stream_delay": TYPICAL["stream_delay"]})
    trace = simulate(build_scene(rig), poses, times)
    late = np.array([0.2, 0.3])
    reading = predicted(trace, rig, "wrench", late)
    expected = trace.at("wrench", late - 0.03)
    expected += 0.1 + 0.05 * late[:, None]
    assert np.allclose(reading, expected, atol=1e-15)
    assert total_delay(rig, "side", "tracks") == pytest.approx(0.05)


@pytest.mark.parametrize("effect", list(all_effects().values()), ids=lambda e: e.name)
def test_derivatives_pass_the_sensors_of_every_effect_as_readings_do(effect, small_rig):
    """By central differences, forwards and backwards, whatever the size of the readings."""
    rig, rng = small_rig(effects={effect.name: TYPICAL[effect.name]}), np.random.default_rng(3)
    times, stamps = np.linspace(0.0, 0.5, 11), rng.uniform(0.0, 0.5, 7)
    blank = simulate(build_scene(small_rig()), {}, np.array([0.0, 0.02]))
    shapes = {channel: (len(times), *readings.shape[1:]) for channel, readings in blank.outputs.items()}
    assert {blank.kinds[channel] for channel in shapes} == {"wrench", "markers", "tracks"}
    for size, (channel, shape) in itertools.product((1e-3, 1.0, 1e3), shapes.items()):
        outputs, change = size * rng.standard_normal(shape), size * rng.standard_normal(shape)
        before, after = (
            predicted(replace(blank, times=times, outputs={channel: outputs + h * change}), rig, channel, stamps)
            for h in (-1e-4, 1e-4)
        )
        difference = (after - before) / 2e-4
        trace = replace(blank, times=times, outputs={channel: outputs})
        moved = predicted_derivatives(trace, change[..., None], rig, channel, stamps)[..., 0]
        assert np.abs(moved).max() > 0.1 * size
        np.testing.assert_allclose(difference, moved, rtol=0.0, atol=1e-7 * (1e-2 + np.abs(moved).max()))
        weights = rng.standard_normal(before.shape)
        by_readings, _ = predicted_back(trace, rig, channel, stamps, weights)
        assert np.vdot(by_readings, change) == pytest.approx(np.vdot(weights, difference), rel=1e-5)


def test_names_and_values_are_checked(small_rig):
    with pytest.raises(ConfigError, match="Did you mean 'air_drag'"):
        active_effects(small_rig(effects={"air_drga": {"drag_coefficient": 1.0}}))
    with pytest.raises(ConfigError, match="no parameter 'drag'"):
        active_effects(small_rig(effects={"air_drag": {"drag": 1.0}}))
    with pytest.raises(ConfigError, match="outside of"):
        active_effects(small_rig(effects={"gel_relaxation": {"share": 2.0, "tau_s": 0.1}}))
    with pytest.raises(ConfigError, match="needs the parameter"):
        active_effects(small_rig(effects={"gel_relaxation": {"share": 0.2}}))


def test_effect_parameters_are_listed_with_the_rig(small_rig):
    rig = small_rig(effects={"air_drag": {"drag_coefficient": 1.0}})
    assert "effects.air_drag.drag_coefficient" in {p.name for p in list_parameters(rig)}


@pytest.mark.parametrize("effect", list(all_effects().values()), ids=lambda e: e.name)
def test_equivalent_descriptions_read_the_same(effect, small_rig, visit):
    bounds = {p.name: (p.lower, p.upper) for p in effect.parameters}
    for same in effect.equivalents(TYPICAL[effect.name]):
        if not all(bounds[k][0] <= v <= bounds[k][1] for k, v in same.items()):
            continue
        given = readings(small_rig(effects={effect.name: TYPICAL[effect.name]}), visit(*MOTION))
        other = readings(small_rig(effects={effect.name: dict(same)}), visit(*MOTION))
        for channel in given:
            size = np.nanmax(np.abs(given[channel]))
            assert np.allclose(given[channel], other[channel], rtol=0, atol=1e-6 * size, equal_nan=True), channel
