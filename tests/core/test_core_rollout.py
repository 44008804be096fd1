"""Rollouts on the compiled core against the same laws launched one by one from Python."""

from __future__ import annotations

import numpy as np
import pytest
from strip_over_table import LAND, SWING, by_python, strip_rig

from sim_core.core import library, rollout
from sim_core.core.covers import covers
from sim_core.core.rollout import CoreRollout
from sim_core.rigs import with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sim_core.solve.report import NewtonSettings

SOLVER = {"dt_s": 0.01, "inertia": True, "integrator": "bdf2"}
TIMES = {"swing": step_times(0.0, 0.3, 0.01), "land": step_times(0.0, 0.4, 0.01)}

CASES = {
    "swing": ({}, SWING),
    "land": ({}, LAND),
    "first order": ({"solver": {**SOLVER, "integrator": "implicit_euler"}}, LAND),
    "static": ({"solver": {**SOLVER, "inertia": False}}, SWING),
    "nothing to touch": ({"contacts": []}, SWING),
    "effects": (
        {
            "effects": {
                "sheet_orthotropy": {"modulus_ratio": 2.0, "grain_angle_rad": 0.4},
                "sheet_stiffness_gradient": {"x_per_m": 3.0},
                "gravity_direction": {"tilt_x_rad": 0.05},
                "command_scale": {"scale_x": 0.1},
            }
        },
        LAND,
    ),
}


TIGHT = NewtonSettings(step_tolerance_m=1e-12, force_tolerance=1e-10)


def compared(rig, poses, times, settings=None, beside=None):
    """Traces by the core and by Python."""
    scene = build_scene(rig)
    assert covers(scene) is None
    return simulate(scene, poses, times, settings=settings, keep_path=True, beside=beside), by_python(
        scene, poses, times, settings
    )


def agree(found, expected, atol_m=1e-9):
    assert np.abs(found.path.positions - expected.path.positions).max() < atol_m
    for channel, values in expected.outputs.items():
        scale = float(np.nanmax(np.abs(values)))
        np.testing.assert_allclose(found.outputs[channel], values, atol=1e-6 * scale, err_msg=channel)


@pytest.mark.parametrize("case", CASES)
def test_positions_and_readings_are_those_of_the_launched_laws(case):
    changes, poses = CASES[case]
    times = TIMES["swing" if poses is SWING else "land"]
    agree(*compared(strip_rig(**changes), poses, times, TIGHT))


@pytest.mark.parametrize("case", ["swing", "land"])
def test_the_search_takes_the_steps_of_the_other(case):
    changes, poses = CASES[case]
    found, expected = compared(strip_rig(**changes), poses, TIMES[case])
    assert np.abs(found.path.positions - expected.path.positions).max() < 1e-9
    ours, theirs = (sum(r.factorisations for r in trace.reports) for trace in (found, expected))
    assert abs(ours - theirs) <= 0.02 * theirs
    touched = [r.contacts for r in found.reports]
    assert touched == [r.contacts for r in expected.reports]
    assert max(touched) > 0 or poses is SWING


def test_values_of_a_rig_that_was_given_other_numbers():
    rig = with_parameters(strip_rig(), {"strip.E_pa": 6e9, "strip.thickness_m": 2e-4, "gripper.offset_ry_deg": 1.5})
    agree(*compared(rig, LAND, TIMES["land"], TIGHT))


def test_two_rollouts_give_the_same_bits():
    scene = build_scene(strip_rig())
    one, other = (simulate(scene, LAND, TIMES["land"], keep_path=True) for _ in range(2))
    assert np.array_equal(one.path.positions, other.path.positions)
    assert all(np.array_equal(one.outputs[c], other.outputs[c], equal_nan=True) for c in one.outputs)


def test_a_rollout_in_small_calls_is_the_same(monkeypatch):
    scene = build_scene(strip_rig())
    whole = simulate(scene, LAND, TIMES["land"], keep_path=True)
    monkeypatch.setattr(rollout, "CHUNK_BYTES", 1)
    done = []
    parts = simulate(scene, LAND, TIMES["land"], lambda k, n: done.append((k, n)), keep_path=True)
    assert np.array_equal(whole.path.positions, parts.path.positions)
    assert done == [(k, 40) for k in range(1, 41)]


def test_beside_a_path_near_by_fewer_factorisations_find_the_same():
    rig = strip_rig(solver={**SOLVER, "inertia": False})
    before = simulate(build_scene(rig), SWING, TIMES["swing"], keep_path=True)
    other = with_parameters(rig, {"strip.E_pa": 4.2e9})
    found, expected = compared(other, SWING, TIMES["swing"], beside=before.path)
    assert np.abs(found.path.positions - expected.path.positions).max() < 2e-8
    assert sum(r.factorisations for r in found.reports) < sum(r.factorisations for r in expected.reports)


def test_steps_that_the_search_gives_up_are_made_by_the_slower_ones():
    few = NewtonSettings(fast_iterations=3)
    scene = build_scene(strip_rig())
    core = CoreRollout(scene, LAND, TIMES["land"], few)
    core.settle()
    x = np.concatenate([chunk.at.x for chunk in core.run()])
    expected = by_python(scene, LAND, TIMES["land"], few)
    assert 3 < core.handed_over < 40
    assert np.abs(x - expected.path.positions[1:]).max() < 1e-8


def test_without_the_library_a_sentence_says_so_and_rollouts_are_made_all_the_same(monkeypatch):
    lack = "The compiled core is not there (no C++ compiler was found)."
    monkeypatch.setattr("sim_core.core.covers.load", lambda: library.Loaded(None, lack, 0.0))
    scene = build_scene(strip_rig())
    assert covers(scene) == lack
    trace = simulate(scene, SWING, TIMES["swing"][:4])
    assert len(trace.reports) == 3


def test_without_a_compiler_a_warning_says_once_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr(library, "BUILT", tmp_path)
    monkeypatch.setattr(library, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr("sim_core.core.build.compiler", lambda: None)
    scene = build_scene(strip_rig())
    library.load.cache_clear()
    try:
        with pytest.warns(UserWarning) as said:
            simulate(scene, SWING, TIMES["swing"][:2])
            simulate(scene, SWING, TIMES["swing"][:2])
    finally:
        library.load.cache_clear()
    (sentence,) = (str(w.message) for w in said if "compiled core" in str(w.message))
    assert "install g++ or clang++, or set CXX" in sentence


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"effects": {"bending_plasticity": {"yield_curvature_per_m": 20.0, "hardening_ratio": 0.1}}}, "plastic flow"),
        ({"effects": {"contact_adhesion": {"work_j_m2": 0.5, "range_m": 2e-4}}}, "laws that effects add"),
        ({"effects": {"end_effector_compliance": {"compliance_m_per_n": 2e-4}}}, "give way"),
        ({"effects": {"air_drag": {"drag_coefficient": 1.0}}}, "no elements"),
    ],
)
def test_what_the_core_does_not_cover_is_said(changes, said):
    reason = covers(build_scene(strip_rig(**changes)))
    assert reason is not None and said in reason
