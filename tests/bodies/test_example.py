"""The example that comes with the package: a gel finger pushes a free block, which pushes a ball."""

import numpy as np
import pytest
from body_scenes import G

from sim_core.rigs import load_rig
from sim_core.rigs.motion import compile_experiment, load_experiment
from sim_core.scene import build_scene
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation


def test_the_force_that_pushes_a_block_is_its_friction():
    """mu m g, by the wrench on the finger, while the block moves on at the finger's speed before it meets the ball."""
    rig = load_rig("push_block")
    path = compile_experiment(load_experiment("push"), rig)["finger"]
    simulation = Simulation(build_scene(rig))
    resting = simulation.read()["wrench_gel"][:3]
    dt, forces, places = rig.solver.dt_s, [], []
    for time in dt * np.arange(1, 121):
        simulation.step({"finger": frame_of(*path.at(time))}, dt)
        if time > 0.35:
            forces.append(np.linalg.norm(simulation.read()["wrench_gel"][:3] - resting))
            places.append(simulation.scene.pose_of("block", simulation.state.x)[0])
    weight = 1200.0 * 0.03 * 0.03 * 0.02 * G
    moved = np.diff(np.array(places)[:, 0]) / dt
    assert moved[5:30].mean() == pytest.approx(0.04, rel=0.2)
    assert np.mean(forces[5:30]) == pytest.approx(0.3 * weight, rel=0.05)
