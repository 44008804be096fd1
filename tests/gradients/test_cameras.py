"""Gradients by what cameras are, taken of all pictures at once."""

from __future__ import annotations

import numpy as np
import pytest
from test_adjoint import weights

from sim_core.gradients import Backward, Tape, directions
from sim_core.rigs import list_parameters, load_rig, with_parameters
from sim_core.rigs.motion import Experiment, compile_experiment
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times

PULL = {"type": "slide", "by_m": [0.0, 0.0, 0.0005], "speed_m_s": 0.001}


@pytest.mark.parametrize("name", ["knit_acrylic_garter_x", "strip_coarse", "tactip_cr"])
def test_cameras_against_other_cameras(name):
    """By intrinsics and offsets of a camera that shows its origin, of one that stands and of one that moves along: the
    rollout is the same, and pictures of it by other cameras differ by the derivative."""
    rig = load_rig(name)
    mount = next(iter(rig.end_effectors))
    experiment = Experiment.model_validate({"name": "pull", "motions": {mount: [PULL]}})
    poses, times = compile_experiment(experiment, rig), step_times(0.0, 0.3, rig.solver.dt_s)
    (camera,) = rig.cameras
    given = [p for p in list_parameters(rig) if p.name.startswith(f"{camera}.") and p.value is not None]
    names = [p.name for p in given if not p.name.endswith("latency_s")]
    assert len(names) >= 9
    scene = build_scene(rig)
    tape = Tape(scene, poses, times)
    drawn = {camera: weights(tape.trace)[camera]}
    found = Backward(tape, directions(rig, names)).gradient(0.0, drawn).parameters
    for parameter in given:
        if parameter.name not in names:
            continue
        h = 1e-4 * abs(parameter.value) or 1e-6
        ends = []
        for side in (h, -h):
            there = build_scene(with_parameters(rig, {parameter.name: parameter.value + side}))
            ends.append(np.nansum(simulate(there, poses, times).outputs[camera] * drawn[camera]))
        size = np.nansum(np.abs(tape.trace.outputs[camera] * drawn[camera]))
        expected = pytest.approx((ends[0] - ends[1]) / (2.0 * h), rel=1e-5, abs=1e-11 * size / h)
        assert found[parameter.name] == expected, parameter.name
