"""Derivatives of rollouts on the compiled core, against differences of rollouts and against those of launched laws."""

from __future__ import annotations

import numpy as np
import pytest
from strip_over_table import LAND, SWING, motion, strip_rig

from sim_core.core import rollout
from sim_core.gradients import directions, simulate_tangent
from sim_core.gradients.directions import command_motions
from sim_core.gradients.tangent import TangentSimulation, recorded
from sim_core.rigs import list_parameters, with_parameters
from sim_core.scene import build_scene
from sim_core.sensing.observe import frame_of
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


def by_python(scene, poses, times, along, settings=TIGHT):
    """The same by launched laws."""
    tracks = {name: trajectory.sample(times) for name, trajectory in poses.items()}
    commanded = [{n: frame_of(p[k], q[k]) for n, (p, q) in tracks.items()} for k in range(len(times))]
    moving = command_motions(scene.rig, along, commanded, times)
    return recorded(TangentSimulation(scene, along, settings, moving), poses, times, along)


CASES = {
    "swing": ({}, SWING, NUMBERS),
    "pressed": ({}, PRESSED, NUMBERS),
    "land": ({}, LAND, NUMBERS),
    "first order": ({"solver": {"dt_s": 0.01, "inertia": True, "integrator": "implicit_euler"}}, LAND, NUMBERS),
    "static": ({"solver": {"dt_s": 0.01, "inertia": False, "integrator": "bdf2"}}, SWING, NUMBERS),
    "effects": ({"effects": EFFECTS}, PRESSED, [*NUMBERS[:3], *OF_EFFECTS, "side.fx_px", "side.offset_x_m"]),
}


@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_the_launched_laws(case):
    changes, poses, names = CASES[case]
    rig = strip_rig(**changes)
    scene, along = build_scene(rig), directions(rig, names)
    times = step_times(0.0, float(poses["gripper"].times[-1]), 0.01)
    trace, found = simulate_tangent(scene, poses, times, along, settings=TIGHT)
    _, expected = by_python(scene, poses, times, along)
    assert max(r.contacts for r in trace.reports) > 0 or poses is SWING
    sizes = {p.name: abs(p.value or 0.0) or 1.0 for p in list_parameters(rig)}
    for channel, values in expected.items():
        for k, name in enumerate(names):
            size = float(np.nanmax(np.abs(values[..., k])))
            # The others go by steps of numbers to both sides, which lose five digits to round-off.
            lost = 3e-9 * float(np.nanmax(np.abs(trace.outputs[channel]))) / sizes[name]
            # A shift of everything strains nothing: what is left of 6e5 N/m times 1 m is round-off.
            lost = max(lost, 2e-8) if ".offset_" in name else lost
            np.testing.assert_allclose(
                found[channel][..., k], values[..., k], atol=3e-6 * size + lost, err_msg=f"{channel} by {name}"
            )


SMOOTH = {
    "swing": ({}, SWING, [n for n in NUMBERS if n.startswith(("strip", "gravity", "gripper"))]),
    "drawn over the table": (
        {"solver": {"dt_s": 0.01, "inertia": False, "integrator": "bdf2"}},
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


def test_derivatives_of_steps_that_were_handed_over():
    few = NewtonSettings(fast_iterations=2, step_tolerance_m=1e-12, force_tolerance=1e-10)
    rig = strip_rig()
    scene, along = build_scene(rig), directions(rig, ["strip.E_pa", "gripper.offset_z_m"])
    times = step_times(0.0, 0.4, 0.01)
    found = simulate_tangent(scene, LAND, times, along, settings=few)[1]
    expected = simulate_tangent(scene, LAND, times, along, settings=TIGHT)[1]
    for channel, values in expected.items():
        np.testing.assert_allclose(found[channel], values, atol=1e-5 * float(np.nanmax(np.abs(values))))


def test_derivatives_in_small_calls_are_the_same(monkeypatch):
    rig = strip_rig()
    scene, along, times = build_scene(rig), directions(rig, NUMBERS[:9]), step_times(0.0, 0.4, 0.01)
    whole = simulate_tangent(scene, LAND, times, along)[1]
    monkeypatch.setattr(rollout, "CHUNK_BYTES", 1)
    parts = simulate_tangent(scene, LAND, times, along)[1]
    assert all(np.array_equal(whole[c], parts[c], equal_nan=True) for c in whole)
