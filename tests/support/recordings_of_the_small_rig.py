"""Recordings of the small rig that the simulator makes: what is true, where fits begin, and how the finger moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sim_core.rigs import Rig, with_parameters
from sim_core.rigs.motion import Experiment
from sysid.model.load import load_run
from sysid.observations.observations import Run
from sysid.simulate import WhiteNoise, simulate_to_bag

TRUTH = {"card.E_pa": 2.6e9, "gel.E_pa": 1.3e5, "contacts.gel-post.friction": 0.5}
STARTS = (
    {"card.E_pa": 1.8e9, "gel.E_pa": 0.9e5, "contacts.gel-post.friction": 0.35},
    {"card.E_pa": 3.8e9, "gel.E_pa": 1.8e5, "contacts.gel-post.friction": 0.7},
    {"card.E_pa": 2.0e9, "gel.E_pa": 2.0e5, "contacts.gel-post.friction": 0.3},
)
START = STARTS[0]
BIAS = np.array([0.3, -0.2, 0.5, 0.0, 0.0, 0.0])

MOTION = [
    {"type": "wait", "duration_s": 0.4},
    {"type": "waypoints", "speed_m_s": 0.1, "hold_s": 0.1,
     "poses": [{"position_m": [0.0, 0.0, -0.012]}, {"position_m": [0.0, 0.0, 0.0]},
               {"position_m": [0.055, 0.0, 0.0]}]},
    {"type": "waypoints", "speed_m_s": 0.02, "hold_s": 0.1,
     "poses": [{"position_m": [0.055, 0.0, -0.0008]}, {"position_m": [0.059, 0.0, -0.0008]},
               {"position_m": [0.055, 0.0, 0.0]}]},
]  # fmt: skip


REST = [{"type": "wait", "duration_s": 0.8}]


def record(rig: Rig, hidden: dict[str, float], bias: np.ndarray, out: Path, motion: Any = MOTION) -> Run:
    true = with_parameters(rig, {**TRUTH, **hidden})
    white = WhiteNoise(true, 4)

    def noise(channel: str, kind: str, stamps: np.ndarray, clean: np.ndarray) -> np.ndarray:
        return white(channel, kind, stamps, clean) + (bias if kind == "wrench" else 0.0)

    experiment = Experiment.model_validate({"name": "visit", "motions": {"finger": motion}})
    simulate_to_bag(true, experiment, out, noise=noise)
    return load_run(rig, out)
