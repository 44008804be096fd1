"""A strip that is pulled once, on a coarse mesh: a fit of it takes seconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim_core.rigs import Rig, load_rig, parse_rig, with_parameters
from sim_core.rigs.motion import Experiment
from sysid.model.load import load_run
from sysid.observations.observations import Run
from sysid.simulate import WhiteNoise, simulate_to_bag

TRUTH = {"strip.E_pa": 4.6e9, "strip.nu": 0.34}
START = {"strip.E_pa": 4.0e9, "strip.nu": 0.30}
PULL = Experiment.model_validate(
    {
        "name": "pull",
        "motions": {
            "gripper": [
                {"type": "wait", "duration_s": 0.3},
                {"type": "pull", "distance_m": 0.0006, "along": [1.0, 0.0, 0.0], "speed_m_s": 0.001, "hold_s": 0.3},
            ]
        },
    }
)


def strip_rig() -> Rig:
    data = load_rig("strip_pull").model_dump()
    data["bodies"]["strip"]["shape"]["cells"] = [8, 2]
    data["solver"]["dt_s"] = 0.05
    return parse_rig(data, "coarse strip")


def pulled(rig: Rig, values: dict[str, float], out: Path, seed: int = 1, jumps: np.ndarray | None = None) -> Run:
    """A recording of a strip with these values; ``jumps``: added to the tracks, [px] ``(n, 33, 2)``."""
    true = with_parameters(rig, values)
    white = WhiteNoise(true, seed)

    def noise(channel: str, kind: str, stamps: np.ndarray, clean: np.ndarray) -> np.ndarray:
        drawn = white(channel, kind, stamps, clean)
        return drawn + jumps if kind == "tracks" and jumps is not None else drawn

    simulate_to_bag(true, PULL, out, noise=noise)
    return load_run(rig, out)
