"""Affine bodies and joints on the compiled core, against differences of potentials and of rollouts."""

from __future__ import annotations

import numpy as np
import pytest
from adjoint_against_columns import compare_with_columns
from against_differences import compare_derivatives
from body_scenes import affine, rig_of
from steps_of_rollouts import by_both_searches, check_steps
from test_sensitivities import path, pushed, swung, thrown

from sim_core.gradients import directions, simulate_tangent
from sim_core.rigs import list_parameters, with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-13, force_tolerance=1e-11)


def flung():
    """A bead that slides out along a rod which spins, and tumbles; what the rod does to it is measured on both."""
    spin, size = 360.0, 0.01
    bodies = {
        "rod": affine((6.0 * size, size, size), angular_velocity_deg_s=[30.0, spin, 0.0]),
        "bead": affine((size, size, size), (2.0 * size, 0.0, 0.0), angular_velocity_deg_s=[30.0, spin, 0.0]),
    }
    bodies["bead"]["velocity_m_s"] = [0.0, 0.0, -np.deg2rad(spin) * 2.0 * size]
    joint = {"type": "slider", "body": "bead", "to": "rod", "axis": [1.0, 0.0, 0.0]}
    seen = {"body": "bead", "points": {"positions_m": [[0.004, 0.003, 0.0], [-0.004, 0.0, 0.002]]}}
    camera = {"model": "pinhole", "width_px": 640, "height_px": 480, "fx_px": 500.0, "fy_px": 500.0, "cx_px": 320.0,
              "cy_px": 240.0, "pose": {"position_m": [0.0, 0.0, -0.3]}, "sees": [seen], "rate_hz": 30.0}  # fmt: skip
    return rig_of(bodies, 0.002, "bdf2", (0.0, 0.0, -1.0), joints=[joint], cameras={"above": camera})


CASES = {
    "pushed": (pushed, path(0.03), step_times(0.0, 0.3, 0.01)),
    "swung": (swung, path(0.01), step_times(0.0, 0.4, 0.01)),
    "thrown": (thrown, path(0.0), step_times(0.0, 0.12, 0.002)),
    "flung": (flung, {}, step_times(0.0, 0.1, 0.002)),
}
"""The block that is pushed slides back in the end, which is sharp."""
BY = {
    "pushed": ("E_pa", "friction", "density"),  # by a shift of the hand differences jump between stick and slip
    "swung": ("density", "gravity.z"),
    "thrown": ("friction", "gravity.z"),
    "flung": ("density", "gravity.z"),
}
"""What readings depend on."""


@pytest.mark.parametrize("case", CASES)
def test_steps_end_in_balance_and_derivatives_of_potentials_are_those_of_differences(case):
    make, poses, times = CASES[case]
    scene = build_scene(make())
    found = check_steps(scene, poses, times)
    assert case in ("swung", "flung") or max(r.contacts for r in found.reports) > 0
    x = found.path.positions
    assert np.abs(x[-1] - x[0]).max() > 1e-3


@pytest.mark.parametrize("case", CASES)
def test_both_searches_find_the_same(case):
    make, poses, times = CASES[case]
    fast, guarded = by_both_searches(build_scene(make()), poses, times)
    assert np.abs(fast.path.positions - guarded.path.positions).max() < 1e-10


@pytest.mark.parametrize("case", CASES)
def test_derivatives_between_impacts_against_differences_of_rollouts(case):
    make, poses, times = CASES[case]
    rig = make()
    names = [p.name for p in list_parameters(rig) if p.value is not None and any(w in p.name for w in BY[case])]
    compare_derivatives(rig, poses, times, names, TIGHT, round_off=2e-9)  # bodies stretch as little as those of 1 GPa


@pytest.mark.parametrize("case", [*CASES, "felt"])
def test_gradients_on_the_way_back_are_those_of_the_columns(case):
    """Of loads on free bodies too."""
    make, poses, times = CASES["pushed" if case == "felt" else case]
    rig, wanted = make(), BY["pushed" if case == "felt" else case]
    if case == "felt":
        rig, times = felt(rig), step_times(0.0, 0.1, 0.01)
    names = [p.name for p in list_parameters(rig) if p.value is not None and any(w in p.name for w in wanted)]
    # What rests near the verge of slip knows slopes of friction less well than places (docs/design/compiled_core.md).
    compare_with_columns(rig, poses, times, names, 2e-8 if case == "pushed" else 1e-9)


@pytest.mark.parametrize(
    ("make", "distance", "names"),
    [
        (thrown, 0.0, ["contacts.block-table.friction", "gravity.z_m_s2"]),
        (lambda: felt(pushed()), 0.03, ["pad.E_pa", "block.density_kg_m3"]),
    ],
)
def test_loads_on_free_bodies_against_differences_of_rollouts(make, distance, names):
    """In the frame of the body, which moves and turns with it."""
    rig, poses, times = make(), path(distance), step_times(0.0, 0.1, 0.005)
    known = {p.name: p.value for p in list_parameters(rig)}
    _, found = simulate_tangent(build_scene(rig), poses, times, directions(rig, names), settings=TIGHT)
    for k, name in enumerate(names):
        wide = 1e-3 * abs(known[name])
        low, high = (
            simulate(build_scene(with_parameters(rig, {name: known[name] + s * wide})), poses, times, settings=TIGHT)
            for s in (-1, 1)
        )
        central = (high.outputs["load"] - low.outputs["load"]) / (2.0 * wide)
        error, size = np.abs(found["load"][..., k] - central), np.abs(central[:, :3]).max()
        assert size > 0.0
        assert error[:, :3].max() < 2e-5 * size, name
        assert error[:, 3:].max() < 2e-5 * size * 0.005, name  # half the size of the block [m]


def felt(rig):
    """With a sensor on the block in place of that on the hand."""
    sensor = thrown().sensors["load"].model_copy(update={"rate_hz": 50.0})
    return rig.model_copy(update={"sensors": {**rig.sensors, "load": sensor}})
