"""Derivatives of rollouts on the compiled core, against differences of rollouts."""

from __future__ import annotations

import numpy as np
import pytest
from against_differences import compare_derivatives
from strip_over_table import LAND, SWING, motion, strip_rig

from sim_core.core import rollout
from sim_core.gradients import directions, simulate_tangent
from sim_core.rigs import list_parameters, with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-13, force_tolerance=1e-11)

NUMBERS = [
    "strip.E_pa",
    "strip.nu",
    "strip.thickness_m",
    "strip.density_kg_m3",
    "strip.mass_damping_per_s",
    "strip.stiffness_damping_s",
    "contacts.strip-table.friction",
    "gravity.x_m_s2",
    "gravity.z_m_s2",
    "gripper.offset_x_m",
    "gripper.offset_z_m",
    "gripper.offset_ry_deg",
    "tray.offset_z_m",
    "tray.offset_rx_deg",
]

PRESSED = {
    "gripper": motion(
        [0.0, 0.15, 0.3], [[0, 0, 0], [0, 0, -0.058], [0.01, 0.003, -0.058]], [[0, 0, 0], [0, 50, 0], [0, 50, 4]]
    )
}
"""Put down on the table and drawn over it: no impact but the first."""

EFFECTS = {
    "sheet_orthotropy": {"modulus_ratio": 2.0, "grain_angle_rad": 0.4},
    "sheet_stiffness_gradient": {"x_per_m": 3.0},
    "command_scale": {"scale_x": 0.1},
}
OF_EFFECTS = [
    "effects.sheet_orthotropy.modulus_ratio",
    "effects.sheet_stiffness_gradient.x_per_m",
    "effects.command_scale.scale_x",
]


STATIC = {"solver": {"dt_s": 0.01, "inertia": False, "integrator": "bdf2"}}

CASES = {
    "swing": ({}, SWING, NUMBERS),
    "pressed": ({}, PRESSED, NUMBERS),
    "land": ({}, LAND, NUMBERS),
    "first order": ({"solver": {"dt_s": 0.01, "inertia": True, "integrator": "implicit_euler"}}, LAND, NUMBERS),
    "static": (STATIC, SWING, [n for n in NUMBERS if "damping" not in n]),
    "effects": ({"effects": EFFECTS}, PRESSED, [*NUMBERS[:3], *OF_EFFECTS, "side.fx_px", "side.offset_x_m"]),
}


@pytest.mark.parametrize("case", CASES)
def test_derivatives_between_impacts_against_differences_of_rollouts(case):
    changes, poses, names = CASES[case]
    times = step_times(0.0, float(poses["gripper"].times[-1]), 0.01)
    trace = compare_derivatives(strip_rig(**changes), poses, times, names, TIGHT)
    assert max(r.contacts for r in trace.reports) > 0 or poses is SWING


SMOOTH = {
    "swing": ({}, SWING, [n for n in NUMBERS if n.startswith(("strip", "gravity", "gripper"))]),
    "drawn over the table": (
        STATIC,
        PRESSED,
        [n for n in NUMBERS if "damping" not in n],
    ),
}
"""Without impacts; with them derivatives are those of the branch that was taken (docs/validation.md)."""


ROUND_OFF = {"wrist": 4e-11, "side": 1e-9}
"""Of readings [N, px]: round-off of places of 0.1 m times the stiffness of the strip, E h = 6e5 N/m; and as seen."""


@pytest.mark.parametrize(("case", "name"), [(case, name) for case, (_, _, names) in SMOOTH.items() for name in names])
def test_derivatives_against_differences_of_rollouts(case, name):
    changes, poses, _ = SMOOTH[case]
    rig, times = strip_rig(**changes), step_times(0.0, 0.3, 0.01)
    (direction,) = directions(rig, [name])
    value = next(p.value for p in list_parameters(rig) if p.name == name)
    trace, derivatives = simulate_tangent(build_scene(rig), poses, times, [direction], settings=TIGHT)
    assert case == "swing" or max(r.contacts for r in trace.reports) > 0
    wide = 1e-4 * abs(value) or 1e-5
    low, high = (
        simulate(build_scene(with_parameters(rig, {name: value + s * wide})), poses, times, settings=TIGHT)
        for s in (-1, 1)
    )
    for channel in ("wrist", "side"):
        central = (high.outputs[channel] - low.outputs[channel]) / (2.0 * wide)
        error = np.abs(derivatives[channel][..., 0] - central)
        lost = ROUND_OFF[channel] / wide
        assert np.nanmax(error) < 1e-6 * np.nanmax(np.abs(central)) + lost, channel


def test_derivatives_of_steps_that_were_halved():
    """Mounts turn by up to 7 degrees in a step: their motions in its middle are not the mean of those at its ends."""
    few = NewtonSettings(fast_iterations=1, max_iterations=2, step_tolerance_m=1e-11, force_tolerance=1e-9)
    names, times = ["strip.E_pa", "gripper.offset_z_m", "gripper.offset_ry_deg"], step_times(0.0, 0.3, 0.01)
    trace = compare_derivatives(strip_rig(), SWING, times, names, few)
    assert max(r.parts for r in trace.reports) > 1


def test_derivatives_in_small_calls_are_the_same(monkeypatch):
    rig = strip_rig()
    scene, along, times = build_scene(rig), directions(rig, NUMBERS[:9]), step_times(0.0, 0.4, 0.01)
    whole = simulate_tangent(scene, LAND, times, along)[1]
    monkeypatch.setattr(rollout, "CHUNK_BYTES", 1)
    parts = simulate_tangent(scene, LAND, times, along)[1]
    assert all(np.array_equal(whole[c], parts[c], equal_nan=True) for c in whole)
