"""Gels on the compiled core, against differences of potentials and of rollouts."""

from __future__ import annotations

import numpy as np
import pytest
from against_differences import compare_derivatives
from scipy.spatial.transform import Rotation
from steps_of_rollouts import by_both_searches, check_steps
from strip_over_table import strip_rig

from sim_core.core.library import load
from sim_core.core.pardiso import pardiso_address
from sim_core.core.rollout import CoreRollout
from sim_core.gradients import directions, simulate_tangent
from sim_core.rigs import list_parameters, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.scene.solid_range import ElementInverted
from sim_core.simulate import simulate, step_times
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-13, force_tolerance=1e-11)

HEIGHT = 0.0052

DYNAMIC = {"dt_s": 0.005, "inertia": True, "integrator": "bdf2"}
STATIC = {"dt_s": 0.005, "inertia": False}


def gel_rig(solver=DYNAMIC, damping_s=2e-3, friction=0.3, **changes):
    """A block that a gripper holds by its top, a hair above the table."""
    material = {"E_pa": 2e4, "nu": 0.45, "density_kg_m3": 1000.0, "stiffness_damping_s": damping_s}
    rig = strip_rig().model_dump(mode="json", by_alias=True, exclude_none=True)
    seen = {"body": "gel", "points": {"positions_m": [[0.004, 0.003, 0.002], [-0.005, 0.0, 0.004]]}}
    return strip_rig(
        solver=solver,
        bodies={
            "gel": {
                "type": "gel",
                "shape": {"type": "block", "size_m": [0.02, 0.014, 0.01], "cells": [2, 1, 1]},
                "material": material,
                "bonded": "top",
                "mount": "gripper",
            },
            "table": rig["bodies"]["table"],
        },
        clamps=[],
        end_effectors={**rig["end_effectors"], "gripper": {"start": {"position_m": [0.0, 0.0, HEIGHT]}}},
        contacts=[{"between": ["gel", "table"], "friction": friction}],
        cameras={"side": {**rig["cameras"]["side"], "sees": [seen]}},
        **changes,
    )


def moved(shifts, turns_deg, until=0.05):
    times = np.linspace(0.0, until, len(shifts))
    turns = Rotation.from_rotvec(np.array(turns_deg), degrees=True).as_quat()
    return {"gripper": PoseTrajectory.from_samples(times, [0.0, 0.0, HEIGHT] + np.array(shifts), turns)}


SHAKEN = moved([[0, 0, 0.02], [0.004, 0.001, 0.024], [0, 0, 0.02]], [[0, 0, 0], [0, 30, 10], [0, 0, 0]])
PRESSED = moved([[0, 0, 0], [0, 0, -0.0012], [0.001, 0.0004, -0.0012]], [[0, 0, 0], [2, 0, 0], [2, 0, 3]])
TIMES = step_times(0.0, 0.05, 0.005)

EFFECTS = {"gel_stiffness_gradient": {"x_per_m": 20.0}}

CASES = {
    "shaken": (gel_rig, {}, SHAKEN),
    "pressed": (gel_rig, {}, PRESSED),
    "without damping": (gel_rig, {"damping_s": 0.0}, SHAKEN),
    "first order": (gel_rig, {"solver": {**DYNAMIC, "integrator": "implicit_euler"}}, PRESSED),
    "static": (gel_rig, {"solver": STATIC}, PRESSED),
    "graded": (gel_rig, {"effects": EFFECTS}, PRESSED),
}
NUMBERS = ["gel.E_pa", "gel.nu", "gel.density_kg_m3", "gel.stiffness_damping_s", "gripper.offset_x_m",
           "gripper.offset_rx_deg", "contacts.gel-table.friction"]  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_steps_end_in_balance_and_derivatives_of_potentials_are_those_of_differences(case):
    make, changes, poses = CASES[case]
    found = check_steps(build_scene(make(**changes)), poses, TIMES, every=2)
    assert max(r.contacts for r in found.reports) > 0 or poses is SHAKEN


@pytest.mark.parametrize("case", ["shaken", "pressed", "static"])
def test_both_searches_find_the_same(case):
    make, changes, poses = CASES[case]
    fast, guarded = by_both_searches(build_scene(make(**changes)), poses, TIMES)
    assert np.abs(fast.path.positions - guarded.path.positions).max() < 1e-12


def test_the_search_begins_with_the_tangent_of_the_step_before():
    """Some steps of a gel that hangs still take none of their own."""
    reports = simulate(build_scene(gel_rig()), {}, TIMES).reports
    assert min(r.iterations for r in reports) > 0
    assert sum(r.factorisations for r in reports) < len(reports)


@pytest.mark.parametrize("case", CASES)
def test_derivatives_between_impacts_against_differences_of_rollouts(case):
    make, changes, poses = CASES[case]
    graded = ["effects.gel_stiffness_gradient.x_per_m"] if "effects" in changes else []
    names = [n for n in NUMBERS if "damping" not in n or changes.get("solver") is not STATIC] + graded
    compare_derivatives(make(**changes), poses, TIMES, names, TIGHT)


@pytest.mark.parametrize("name", NUMBERS[:6])
def test_derivatives_against_differences_of_rollouts(name):
    rig = gel_rig()
    (direction,) = directions(rig, [name])
    value = next(p.value for p in list_parameters(rig) if p.name == name)
    _, derivatives = simulate_tangent(build_scene(rig), SHAKEN, TIMES, [direction], settings=TIGHT)
    wide = 1e-4 * abs(value) or 1e-5
    low, high = (
        simulate(build_scene(with_parameters(rig, {name: value + s * wide})), SHAKEN, TIMES, settings=TIGHT)
        for s in (-1, 1)
    )
    for channel, lost in (("wrist", 1e-12), ("side", 1e-9)):
        central = (high.outputs[channel] - low.outputs[channel]) / (2.0 * wide)
        error = np.abs(derivatives[channel][..., 0] - central)
        assert np.nanmax(error) < 1e-6 * np.nanmax(np.abs(central)) + lost / wide, channel


@pytest.fixture
def without_mkl():
    load().functions.thinshell_pardiso(None)
    yield
    load().functions.thinshell_pardiso(pardiso_address())


def _finer():
    rig = gel_rig()
    block = rig.bodies["gel"]
    finer = block.model_copy(update={"shape": block.shape.model_copy(update={"cells": (3, 2, 1)})})
    return build_scene(rig.model_copy(update={"bodies": {**rig.bodies, "gel": finer}}))


def _supernodes(scene):
    core = CoreRollout(scene, PRESSED, TIMES, TIGHT)
    return bool(load().functions.thinshell_supernodes(core._handle))


@pytest.mark.skipif(pardiso_address() is None, reason="no wheel of MKL for this platform")
def test_both_factors_solve_the_same(request):
    scene = _finer()
    along = directions(scene.rig, NUMBERS)
    assert _supernodes(scene)
    trace, found = simulate_tangent(scene, PRESSED, TIMES, along, settings=TIGHT, keep_path=True)
    again = simulate_tangent(scene, PRESSED, TIMES, along, settings=TIGHT, keep_path=True)[0]
    assert np.array_equal(trace.path.positions, again.path.positions)
    request.getfixturevalue("without_mkl")
    assert not _supernodes(scene)
    other, expected = simulate_tangent(scene, PRESSED, TIMES, along, settings=TIGHT, keep_path=True)
    assert np.abs(trace.path.positions - other.path.positions).max() < 1e-13
    for channel, values in expected.items():
        scale = np.nanmax(np.abs(values), axis=tuple(range(values.ndim - 1)))
        assert np.nanmax(np.abs(found[channel] - values) / scale) < 1e-8, channel


def test_a_narrow_mesh_keeps_the_envelope():
    assert not _supernodes(build_scene(gel_rig()))


def test_a_gel_is_not_pressed_inside_out():
    poses = moved([[0, 0, 0], [0, 0, -0.011]], [[0, 0, 0], [0, 0, 0]])
    with pytest.raises(ElementInverted, match="inside out"):
        simulate(build_scene(gel_rig(solver=STATIC)), poses, TIMES)


def test_the_least_volume_of_a_turn_is_that_of_its_closed_form():
    """On the straight way of a turn by a it comes to cos(a/2)^2."""
    poses = moved([[0, 0, 0.05], [0, 0, 0.05]], [[0, 0, 0], [120, 0, 0]], until=0.005)
    scene = build_scene(gel_rig(solver=STATIC, damping_s=0.0, gravity_m_s2=[0.0, 0.0, 0.0]))
    core = CoreRollout(scene, poses, TIMES[:2], NewtonSettings())
    core.press(core.settle())
    for chunk in core.run():
        core.press(chunk)
    assert core.least_volumes["gel"].ratio == pytest.approx(0.25, rel=1e-9)
