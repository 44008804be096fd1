"""Recordings of the same bodies one after another, against one that was never interrupted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_core.gradients.amendments import Amendment
from sim_core.gradients.frozen_path import let_remember
from sim_core.permanent_state import lasting
from sim_core.rigs import parse_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import step_times
from sysid.model.parameters import fit_parameters, rig_at, start_of
from sysid.model.predictor import SerialPredictor
from sysid.model.sequence import earlier_motion
from sysid.observations.observations import Measured, Run

YIELDS = {"bending_plasticity": {"yield_curvature_per_m": 5.0, "hardening_ratio": 0.3}}
RUBS = {"bending_friction": {"share": 0.5, "slip_curvature_per_m": 3.0}}
BEND_S = 0.4
STAMPS = np.linspace(0.02, BEND_S, 15)


def strip(others=None, **effects):
    """A strip that two hands hold by its ends, upright so that its weight does not bend it; with ``others`` next to
    it."""
    ends = {"left": [-0.05, -0.04], "right": [0.04, 0.05]}
    return parse_rig(
        {
            "name": "bent",
            "solver": {"dt_s": 0.02},
            "gravity_m_s2": [0.0, 9.81, 0.0],
            "bodies": {
                "strip": {
                    "type": "sheet",
                    "shape": {"type": "rectangle", "length_m": 0.1, "width_m": 0.02, "cells": [10, 1]},
                    "material": {"E_pa": 2.0e9, "nu": 0.0, "thickness_m": 2.5e-4, "density_kg_m3": 700.0},
                },
                **(others or {}),
            },
            "clamps": [
                {"name": f"{h}_clamp", "body": "strip", "region": {"x_m": e}, "mount": h} for h, e in ends.items()
            ],
            "end_effectors": {
                h: {
                    "start": {"position_m": [e[0], 0.0, 0.0]},
                    "topics": {"target_pose": f"{h}/target_pose", "current_pose": f"{h}/current_pose"},
                }
                for h, e in ends.items()
            },
            "sensors": {
                "wrist": {"type": "wrench", "on": "right", "frame_id": "right", "rate_hz": 100.0, "topic": "wrench"}
            },
            "effects": effects,
        },
        "test",
    )


def bend(angle, turned=0.0):
    """The right hand turns by an angle [rad] and back, with both hands ``turned`` about y as one."""
    times = np.linspace(0.0, BEND_S, 21)
    way = np.sin(np.pi * times / BEND_S) ** 2
    still = np.zeros_like(times)

    def posed(x, height, turn):
        c, s = np.cos(turned), np.sin(turned)
        about = np.stack([still, np.sin((turn + turned) / 2), still, np.cos((turn + turned) / 2)], axis=-1)
        return PoseTrajectory.from_samples(times, np.stack([c * x + s * height, still, c * height - s * x], -1), about)

    right = posed(0.04 - 0.008 * angle**2 * way, -0.02 * angle * way, angle * way)
    return {"left": posed(-0.05 + still, still, still), "right": right}


def run_of(name, poses, begin_s, end=BEND_S, stamps=STAMPS):
    blank = (Measured("wrist", "wrench", stamps, np.zeros((len(stamps), 6)), tuple("abcdef")),)
    return Run(name, name, (), poses, blank, end, span_ns=(round(1e9 * begin_s), round(1e9 * (begin_s + end))))


def joined(first, second):
    """One motion after the other, with a pause of their length between."""
    out = {}
    for name in first:
        a, b = first[name], second[name]
        pause = np.linspace(0.0, BEND_S, 21)[1:]
        out[name] = PoseTrajectory.from_samples(
            np.concatenate([a.times, a.times[-1] + pause, a.times[-1] + BEND_S + b.times[1:]]),
            np.concatenate([a.positions, np.repeat(a.positions[-1:], 20, axis=0), b.positions[1:]]),
            np.concatenate([a.quaternions, np.repeat(a.quaternions[-1:], 20, axis=0), b.quaternions[1:]]),
        )
    return out


def in_turn(turned=0.0):
    """A strong bend, then a weak one; the second recording ``turned`` as a whole."""
    strong, weak = run_of("strong", bend(1.2), 10.0), run_of("weak", bend(0.2, turned), 20.0)
    return strong, replace(weak, earlier=earlier_motion([weak, strong], weak))


@pytest.mark.parametrize("effects", [YIELDS, RUBS])
def test_a_recording_after_another_is_as_if_it_had_not_stopped_between(effects):
    rig, predictor = strip(**effects), SerialPredictor()
    strong, weak = in_turn()
    whole = run_of("whole", joined(strong.poses, weak.poses), 0.0, 3.0 * BEND_S, STAMPS + 2.0 * BEND_S)
    expected = predictor.predict(rig, whole).values["wrist"]
    found = predictor.predict(rig, weak).values["wrist"]
    virgin = predictor.predict(rig, replace(weak, earlier=())).values["wrist"]
    off, lost = (np.abs(values - expected).max(axis=0) for values in (found, virgin))
    assert np.all(off < 0.01 * np.abs(expected).max(axis=0))
    assert lost[0] > 100.0 * off[0]


def test_a_set_goes_along_with_hands_that_begin_elsewhere():
    """The wrench is measured in the hand's frame; weight is along the strip's width, about which hands turn."""
    rig, predictor = strip(**YIELDS), SerialPredictor()
    expected = predictor.predict(rig, in_turn()[1]).values["wrist"]
    found = predictor.predict(rig, in_turn(turned=2.5)[1]).values["wrist"]
    np.testing.assert_allclose(found, expected, atol=2e-4 * np.abs(expected).max())


LOOSE = {
    "type": "sheet",
    "shape": {"type": "rectangle", "length_m": 0.02, "width_m": 0.02, "cells": [1, 1]},
    "pose": {"position_m": [0.0, 0.0, 1.0]},
    "material": {"E_pa": 2.0e9, "nu": 0.0, "thickness_m": 2.5e-4, "density_kg_m3": 700.0},
}


@pytest.mark.parametrize(("effects", "others"), [(YIELDS, {}), (RUBS, {}), (YIELDS, {"loose": LOOSE})])
def test_derivatives_go_through_recordings_before(effects, others):
    """Also with a body that nothing holds, with which nothing settles."""
    rig, predictor = strip(others, **effects), SerialPredictor()
    _, weak = in_turn()
    ((name, numbers),) = effects.items()
    parameters = fit_parameters(rig, ["strip.E_pa", *(f"effects.{name}.{number}" for number in numbers)])
    at = start_of(rig, parameters)
    slopes = predictor.predict_with_derivatives(rig, weak, parameters, at).derivatives["wrist"]
    alone = predictor.predict_with_derivatives(rig, replace(weak, earlier=()), parameters, at).derivatives["wrist"]
    for k in range(len(parameters)):
        h = 1e-3 * np.eye(len(parameters))[k]  # shorter ones show round-off
        high, low = (predictor.predict(rig_at(rig, parameters, at + s * h), weak).values["wrist"] for s in (1, -1))
        numeric = (high - low) / 2e-3
        scale = np.abs(numeric).max()
        assert np.abs(slopes[..., k] - numeric).max() < 1e-3 * scale
        assert np.abs(alone[..., k] - numeric).max() > 0.05 * scale


def test_what_does_not_last_is_not_simulated_before(monkeypatch):
    """An elastic strip forgets: recordings before cost nothing."""
    made = []
    monkeypatch.setattr("sysid.model.sequence.simulate", lambda *a, **k: made.append(a))
    SerialPredictor().predict(strip(), in_turn()[1])
    assert not made


def test_recordings_before_are_simulated_once(monkeypatch):
    import sysid.model.sequence as sequence

    made, simulate = [], sequence.simulate
    monkeypatch.setattr(sequence, "simulate", lambda *a, **k: made.append(a) or simulate(*a, **k))
    rig, predictor = strip(**YIELDS), SerialPredictor()
    strong, weak = in_turn()
    third = run_of("third", bend(0.2), 30.0)
    third = replace(third, earlier=earlier_motion([strong, weak, third], third))
    predictor.predict(rig, weak)
    predictor.predict(rig, third)
    predictor.predict(rig, third)
    assert len(made) == 2  # strong, then weak after it
    predictor.predict(strip(**{"bending_plasticity": {"yield_curvature_per_m": 6.0, "hardening_ratio": 0.3}}), weak)
    assert len(made) == 3


def test_the_order_is_that_of_the_stamps():
    first, second, third = (run_of(n, bend(0.2), t) for n, t in (("first", 1.0), ("second", 2.0), ("third", 3.0)))
    everything = [third, first, second]
    names = {run.name: [before.name for before in earlier_motion(everything, run)] for run in everything}
    assert names == {"first": [], "second": ["first"], "third": ["first", "second"]}
    undated = replace(first, span_ns=None)
    assert earlier_motion([undated, second], second) == () == earlier_motion([undated, second], undated)


def test_of_recordings_that_overlap_none_comes_before_another():
    first, second, third = (run_of(n, bend(0.2), t) for n, t in (("first", 1.0), ("second", 2.0), ("third", 3.0)))
    other = run_of("other", bend(0.2), 2.2)
    assert earlier_motion([first, second, other, third], third) == ()
    assert earlier_motion([first, second, other, third], other) == ()


def test_a_part_of_a_recording_comes_after_what_was_before_it():
    first, second = run_of("first", bend(0.2), 1.0), run_of("second", bend(0.2), 2.0)
    part = replace(second, name="second@0.1:0.3", since=0.1, until=0.3, end=0.2)
    before = earlier_motion([first, second], part)
    assert [(run.name, run.end) for run in before] == [("first", BEND_S), ("second", 0.1)]
    assert not before[0].measured


def test_what_a_law_would_have_left_is_looked_at_along_the_frozen_paths():
    """The axial force of a strip with a set is far from linear in it; the least cosine is that of yielding itself."""
    rig, predictor = strip(), SerialPredictor()
    _, weak = in_turn()
    yields = {"bending_plasticity": {"yield_curvature_per_m": 11.0, "hardening_ratio": 0.3}}
    plain = predictor.predict(rig, weak).values["wrist"]
    true = predictor.predict(rig.model_copy(update={"effects": yields}), weak).values["wrist"] - plain
    found, alone = (
        predictor.predict_responses(rig, run, [], np.zeros(0), [yields]).derivatives["wrist"][..., 0]
        for run in (weak, replace(weak, earlier=()))
    )
    assert float(found.ravel() @ true.ravel()) > 0.6 * np.linalg.norm(found) * np.linalg.norm(true)
    assert 0.5 < np.linalg.norm(found) / np.linalg.norm(true) < 2.0
    assert np.linalg.norm(alone) < 0.1 * np.linalg.norm(true)


@pytest.mark.parametrize("effects", [YIELDS, RUBS])
def test_what_a_law_remembers_along_the_path_of_itself_is_what_it_leaves(effects):
    """Where the baseline has the law too, its path is that of the law."""
    plain = strip(**effects)
    scene, times = build_scene(plain), step_times(0.0, BEND_S, 0.02)
    amendment = Amendment("law", plain, build_scene(plain))
    left = let_remember(scene, bend(0.8), times, [amendment]).left
    assert max(np.abs(v).max() for own in left.internals.values() for v in own.values()) > 0.1
    assert amendment.kept.keys() == left.internals.keys()
    for term, own in left.internals.items():
        for name, value in own.items():
            np.testing.assert_allclose(amendment.kept[term][name], value, rtol=1e-9, atol=1e-12, err_msg=name)


def test_laws_that_last_are_looked_at_with_one_that_the_rig_has():
    """Two sizes at once, after two recordings: what each leaves is its own."""
    rig, predictor = strip(**YIELDS), SerialPredictor()
    strong, weak = in_turn()
    third = run_of("third", bend(0.3), 30.0)
    third = replace(third, earlier=earlier_motion([strong, weak, third], third))
    sizes = [{"bending_friction": {"share": share, "slip_curvature_per_m": 3.0}} for share in (0.2, 0.4)]
    both = predictor.predict_responses(rig, third, [], np.zeros(0), sizes).derivatives["wrist"]
    for k, size in enumerate(sizes):
        alone = predictor.predict_responses(rig, third, [], np.zeros(0), [size]).derivatives["wrist"][..., 0]
        np.testing.assert_allclose(both[..., k], alone, atol=1e-9 * np.abs(alone).max())


def test_what_a_recording_has_for_itself_holds_before_it():
    """Derivatives by a number of one recording alone are those of the same rollouts."""
    rig, predictor = strip(**YIELDS), SerialPredictor()
    _, weak = in_turn()
    (shared,) = fit_parameters(rig, ["effects.bending_plasticity.yield_curvature_per_m"])
    own = replace(shared, name=f"{shared.name}[weak]", bag="weak")
    at = start_of(rig, [shared])
    found, expected = (
        predictor.predict_with_derivatives(rig, weak, [p], at).derivatives["wrist"] for p in (own, shared)
    )
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_a_body_that_nothing_holds_begins_as_new():
    rig = strip({"loose": LOOSE}, **YIELDS)
    assert {term.split(".")[0] for term in lasting(build_scene(rig))} == {"strip"}
