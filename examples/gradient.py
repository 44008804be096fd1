"""The gradient of a loss by parameters of a rig, computed backwards through a whole rollout, against a difference."""

import numpy as np

from sim_core import build_scene, compile_experiment, load_experiment, load_rig, with_parameters
from sim_core.gradients import directions, simulate_adjoint
from sim_core.simulate import Trace, simulate, step_times

NAMES = ["strip.E_pa", "strip.nu"]


def loss(trace: Trace) -> tuple[float, dict[str, np.ndarray]]:
    """Mean square of the load cell's force along x [N^2], and its derivatives by all readings."""
    force = trace.outputs["load_cell"][:, 0]
    slope = np.zeros_like(trace.outputs["load_cell"])
    slope[:, 0] = 2.0 * force / len(force)
    return float((force**2).mean()), {"load_cell": slope}


def main() -> float:
    """Returns the relative difference of the adjoint's slope by the modulus from a central difference."""
    rig = load_rig("strip_coarse")
    poses = compile_experiment(load_experiment("pull_taut"), rig)
    times = step_times(0.0, 1.5, rig.solver.dt_s)
    scene = build_scene(rig)
    found = simulate_adjoint(scene, poses, times, loss, directions(rig, NAMES))
    print(f"loss {found.value:.6g} N^2, by {found.parameters}")

    modulus = rig.bodies["strip"].material.E_pa  # type: ignore[union-attr]
    ends = []
    for factor in (0.999, 1.001):
        moved = build_scene(with_parameters(rig, {"strip.E_pa": factor * modulus}))
        ends.append(loss(simulate(moved, poses, times))[0])
    difference = (ends[1] - ends[0]) / (0.002 * modulus)
    error = abs(found.parameters["strip.E_pa"] / difference - 1.0)
    print(f"The central difference agrees to {error:.1e}.")
    assert error < 1e-4
    return float(error)


if __name__ == "__main__":
    main()
