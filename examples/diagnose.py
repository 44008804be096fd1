"""A recording with physics that the rig lacks, a lens that distorts, and its name."""

import tempfile
from pathlib import Path

from sim_core import load_experiment, load_rig, with_parameters
from sysid.diagnosis import diagnose_runs
from sysid.model.load import load_run
from sysid.simulate import simulate_to_bag

K1 = 0.3
"""Radial distortion that the rig does not know."""


def main() -> str:
    """Returns the verdict."""
    rig, pull = load_rig("strip_coarse"), load_experiment("pull_taut")
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "pull"
        simulate_to_bag(with_parameters(rig, {"effects.camera_distortion.k1": K1}), pull, bag, seed=2)
        diagnosis, _ = diagnose_runs(rig, [load_run(rig, bag)], [])
    print(diagnosis.sentence)
    assert "camera_distortion" in [effect.name for effect in diagnosis.effects]
    return diagnosis.verdict


if __name__ == "__main__":
    main()
