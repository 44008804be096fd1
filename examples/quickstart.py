"""Load a rig, simulate, record, fit. The strip is pulled along its length, which determines its modulus."""

import tempfile
from pathlib import Path

from sim_core import compile_experiment, list_parameters, load_experiment, load_rig, rollout, with_parameters
from sysid import FitOptions, fit_bags, simulate_to_bag


def main() -> float:
    """Returns the fitted modulus over the true one."""
    rig, pull = load_rig("strip_coarse"), load_experiment("pull_taut")
    trace = rollout(rig, compile_experiment(pull, rig))
    print(f"The load cell reads {trace.outputs['load_cell'][:, 0].max():.0f} N along the strip at most.")

    truth = {p.name: p.value for p in list_parameters(rig)}["strip.E_pa"]
    assert truth is not None
    with tempfile.TemporaryDirectory() as folder:
        bag, out = Path(folder) / "pull", Path(folder) / "fit"
        print(simulate_to_bag(rig, pull, bag, seed=1))
        start = with_parameters(rig, {"strip.E": 0.7 * truth})
        result = fit_bags(start, [bag], ["strip.E"], FitOptions(intervals="quadratic"), out=out)
        print(result.table())
    (estimate,) = result.estimates
    assert estimate.ci95[0] < truth < estimate.ci95[1], "the interval holds the truth"
    return estimate.value / truth


if __name__ == "__main__":
    main()
