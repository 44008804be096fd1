"""Node positions, contact forces and pressures of a rollout: a gel finger presses on a block."""

import numpy as np

from sim_core import build_scene, compile_experiment, load_experiment, load_rig
from sim_core.postprocess import lay_out, quantity, surfaces
from sim_core.simulate import simulate, step_times


def main() -> float:
    """Returns the ratio of the force on the sensor to that at the contact, which is 1 while nothing accelerates."""
    rig = load_rig("gel_sensor")
    poses = compile_experiment(load_experiment("press_twist"), rig)
    trace = simulate(build_scene(rig), poses, step_times(0.0, 0.7, rig.solver.dt_s), keep_states=True)
    assert trace.states is not None

    layout = lay_out(rig)
    gel = surfaces(layout)[0]
    frames = layout.frames_along(poses, trace.times)
    pressure = quantity("pressure", layout, gel, trace.states, -1, frames[-1])
    force = trace.states.pair_forces["gel-block"][-1][layout.bodies["gel"].nodes].sum(axis=0)  # on the gel [N]
    print(
        f"At {trace.times[-1]:.2f} s the block pushes the gel by {force.round(3)} N, at most {pressure.max():.0f} Pa."
    )

    read = trace.outputs["wrench"][-1, :3]
    print(f"The sensor reads {np.linalg.norm(read):.3f} N.")
    ratio = float(np.linalg.norm(read) / np.linalg.norm(force))
    assert abs(ratio - 1.0) < 0.05, "what the block pushes arrives at the sensor, but for the weight of the gel"
    return ratio


if __name__ == "__main__":
    main()
