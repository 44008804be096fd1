"""Rollouts on the compiled core: balance of every step, both searches, steps in parts, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from steps_of_rollouts import by_both_searches, check_halved_step, check_steps
from strip_over_table import LAND, SWING, motion, strip_rig

from sim_core.core import library, rollout
from sim_core.core.covers import covers
from sim_core.energies.couple import Couple
from sim_core.errors import ConfigError, ConvergenceError
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


@pytest.mark.parametrize("case", CASES)
def test_steps_end_in_balance_and_derivatives_of_potentials_are_those_of_differences(case):
    changes, poses = CASES[case]
    found = check_steps(build_scene(strip_rig(**changes)), poses, TIMES["swing" if poses is SWING else "land"])
    assert max(r.contacts for r in found.reports) > 0 or poses is SWING


@pytest.mark.parametrize("case", ["swing", "land"])
def test_both_searches_find_the_same(case):
    changes, poses = CASES[case]
    fast, guarded = by_both_searches(build_scene(strip_rig(**changes)), poses, TIMES[case])
    assert np.abs(fast.path.positions - guarded.path.positions).max() < 1e-12
    assert [r.contacts for r in fast.reports] == [r.contacts for r in guarded.reports]
    assert sum(r.factorisations for r in fast.reports) < sum(r.factorisations for r in guarded.reports)


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


def test_a_warm_start_finds_the_same_with_fewer_factorisations():
    rig = strip_rig(solver={**SOLVER, "inertia": False})
    before = simulate(build_scene(rig), SWING, TIMES["swing"], keep_path=True)
    other = with_parameters(rig, {"strip.E_pa": 4.2e9})
    found, expected = (
        simulate(build_scene(other), SWING, TIMES["swing"], keep_path=True, warm_start=path)
        for path in (before.path, None)
    )
    assert np.abs(found.path.positions - expected.path.positions).max() < 2e-8
    assert sum(r.factorisations for r in found.reports) < sum(r.factorisations for r in expected.reports)


def test_a_step_that_the_fast_search_gives_up_is_guarded():
    scene, few = build_scene(strip_rig()), NewtonSettings(fast_iterations=3)
    found, expected = (simulate(scene, LAND, TIMES["land"], settings=s, keep_path=True) for s in (few, None))
    given_up = [r for r in found.reports if r.factorisations > few.fast_iterations]
    assert given_up and all(r.parts == 1 for r in found.reports)
    assert np.abs(found.path.positions - expected.path.positions).max() < 1e-7  # ten of what a search leaves


def test_a_step_that_no_search_finds_is_halved():
    check_halved_step(build_scene(strip_rig()), LAND, TIMES["land"])


RISEN = {
    "gripper": motion([0.0, 0.4], [[0, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 0, 0]]),
    "tray": motion(
        [0.0, 0.1, 0.3, 0.4],
        [[0, 0, -0.1], [0, 0, -0.02], [0.004, 0.002, -0.006], [0.004, 0.002, -0.006]],
        [[0, 0, 0], [0, -5, 0], [4, -9, 3], [4, -12, -3]],
    ),
}
"""The table comes up under the strip, and turns."""


def test_a_body_that_moves_into_a_sheet_is_foreseen():
    scene, times = build_scene(strip_rig()), TIMES["land"]
    trace = check_steps(scene, RISEN, times)
    fast, guarded = by_both_searches(scene, RISEN, times)
    assert np.abs(fast.path.positions - guarded.path.positions).max() < 1e-12
    halved = simulate(scene, RISEN, times, settings=NewtonSettings(fast_iterations=1, max_iterations=4))
    assert max(r.parts for r in halved.reports) > 2
    for found in (trace, halved):
        assert max(r.contacts for r in found.reports) > 0
        assert min(r.min_gap_m for r in found.reports) > 0.0


def test_steps_that_no_search_finds_are_refused_with_a_remedy():
    few = NewtonSettings(fast_iterations=1, max_iterations=3)
    with pytest.raises(ConvergenceError, match="did not converge") as found:
        simulate(build_scene(strip_rig()), LAND, TIMES["land"], settings=few)
    assert "solver.dt_s" in found.value.remedy


def test_without_a_compiler_an_error_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr(library, "BUILT", tmp_path)
    monkeypatch.setattr(library, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr("sim_core.core.build.compiler", lambda: None)
    scene = build_scene(strip_rig())
    library.load.cache_clear()
    try:
        with pytest.raises(ConfigError, match=r"compiled core.*is not there.*Install a C\+\+ compiler.*or a wheel"):
            simulate(scene, SWING, TIMES["swing"][:2])
    finally:
        library.load.cache_clear()


def test_a_wide_mesh_without_mkl_is_simulated_all_the_same_with_a_warning(monkeypatch):
    scene, loaded = build_scene(strip_rig()), library.load()
    monkeypatch.setattr("sim_core.core.state.WIDE", 1)
    monkeypatch.setattr("sim_core.core.state.load", lambda: replace(loaded, supernodes=False))
    with pytest.warns(UserWarning, match="without MKL") as said:
        for _ in range(2):
            assert len(simulate(scene, SWING, TIMES["swing"][:3]).reports) == 2
    assert len([w for w in said if "MKL" in str(w.message)]) == 1


class Torsion(Couple):
    """A term of another package."""


def test_what_the_core_does_not_cover_is_said():
    """Of terms that were added by hand."""
    scene = build_scene(strip_rig())
    scene.system.terms.append(Torsion("end", np.array([[0, 1]]), np.array([0.0, 1.0, 0.0]), np.ones(1)))
    assert covers(scene) == "The core has no elements for end (Torsion)."
    with pytest.raises(ConfigError, match="no elements for end"):
        simulate(scene, SWING, TIMES["swing"][:2])
