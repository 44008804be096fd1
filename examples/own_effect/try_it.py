"""Simulate with the effect and without it. Needs 'pip install -e examples/own_effect' first."""

import numpy as np

from sim_core import compile_experiment, load_experiment, load_rig, rollout, with_parameters
from sysid.model.sensor_streams import predicted

LEAK = 5.0
"""Force over torque [1/m]."""


def main() -> float:
    """Returns the share of the effect in the force along z that is what its formula says; 1 is all."""
    rig = load_rig("strip_coarse")
    leaking = with_parameters(rig, {"effects.torque_leak.leak_per_m": LEAK})
    trace = rollout(rig, compile_experiment(load_experiment("bend_and_release"), rig))
    truth, read = (predicted(trace, one, "load_cell", trace.times) for one in (rig, leaking))
    leaked = read[:, 2] - truth[:, 2]
    print(f"The torque about z leaks up to {np.abs(leaked).max():.3g} N into the force along z.")
    share = float((leaked @ (LEAK * truth[:, 5])) / ((LEAK * truth[:, 5]) @ (LEAK * truth[:, 5])))
    assert abs(share - 1.0) < 1e-9
    return share


if __name__ == "__main__":
    main()
