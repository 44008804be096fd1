"""A rig small enough for tests that step the whole simulator: a card, a gel finger, a post."""

from __future__ import annotations

import copy
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import variations
from fit_fixtures import declared, vectors, workers
from processor_time import pytest_runtest_logstart, pytest_runtest_makereport, pytest_terminal_summary
from threadpoolctl import threadpool_limits

from sim_core.rigs import Rig, parse_rig
from sim_core.rigs.trajectory import PoseTrajectory

__all__ = [
    "declared",
    "pytest_runtest_logstart",
    "pytest_runtest_makereport",
    "pytest_terminal_summary",
    "vectors",
    "workers",
]


def pytest_configure(config: pytest.Config) -> None:
    """One thread of linear algebra a process, and the variation that :mod:`variations` asks for.

    Where Python is set to keep no bytecode, as it is in many containers, every process that a test starts would
    compile all that it imports: those keep it in one folder.
    """
    threadpool_limits(1)
    variations.vary()
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
        os.environ["PYTHONPYCACHEPREFIX"] = str(Path(tempfile.gettempdir()) / f"thinshell_bytecode_{os.getuid()}")


SMALL: dict[str, Any] = {
    "name": "small",
    "solver": {"dt_s": 0.02, "inertia": True},
    "bodies": {
        "card": {
            "type": "sheet",
            "shape": {"type": "rectangle", "length_m": 0.08, "width_m": 0.03, "cells": [6, 2], "pattern": "regular"},
            "pose": {"position_m": [0.0, 0.0, 0.05]},
            "material": {"E_pa": 2.0e9, "nu": 0.3, "thickness_m": 3.0e-4, "density_kg_m3": 400.0},
        },
        "gel": {
            "type": "gel",
            "shape": {"type": "block", "size_m": [0.01, 0.01, 0.004], "cells": [1, 1, 1]},
            "pose": {"position_m": [0.0, 0.0, -0.002], "rpy_deg": [180.0, 0.0, 0.0]},
            "material": {"E_pa": 1.0e5, "nu": 0.4, "density_kg_m3": 1000.0},
            "bonded": "bottom",
            "mount": "finger",
        },
        "post": {
            "type": "rigid",
            "shape": {"type": "box", "size_m": [0.04, 0.04, 0.04]},
            "pose": {"position_m": [0.08, 0.0, 0.03]},
        },
    },
    "clamps": [{"name": "vice", "body": "card", "region": {"x_m": [-0.04, -0.02]}, "mount": "world"}],
    "end_effectors": {"finger": {"start": {"position_m": [0.025, 0.004, 0.0545]}}},
    "contacts": [
        {"between": ["gel", "card"], "friction": 0.4},
        {"between": ["gel", "post"], "friction": 0.4},
    ],
    "sensors": {
        "wrench": {"type": "wrench", "on": "finger", "rate_hz": 50.0, "noise": {"force_n": 1e-3, "torque_nm": 1e-5}},
        "markers": {
            "type": "markers",
            "body": "gel",
            "points": {"face": "top", "grid": [3, 3]},
            "rate_hz": 25.0,
            "noise": {"position_m": 5e-6},
        },
    },
    "cameras": {
        "side": {
            "model": "pinhole",
            "width_px": 1280,
            "height_px": 720,
            "fx_px": 1400.0,
            "fy_px": 1400.0,
            "cx_px": 640.0,
            "cy_px": 360.0,
            "pose": {"position_m": [0.0, -0.25, 0.12], "rpy_deg": [-105.0, 0.0, 0.0]},
            "sees": [{"body": "card", "points": {"grid": [5, 2]}}],
            "rate_hz": 25.0,
            "noise": {"position_px": 0.1},
        }
    },
}


@pytest.fixture(scope="session")
def small_rig() -> Callable[..., Rig]:
    """Build the small rig, with effects and other top-level keys replaced."""

    def build(**changes: Any) -> Rig:
        return parse_rig({**copy.deepcopy(SMALL), **changes}, "small rig")

    return build


@pytest.fixture(scope="session")
def visit() -> Callable[..., dict[str, PoseTrajectory]]:
    """Poses of the finger through offsets [m] from its start at times [s]."""

    def build(times: list[float], offsets: list[list[float]]) -> dict[str, PoseTrajectory]:
        start = np.array(SMALL["end_effectors"]["finger"]["start"]["position_m"])
        quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1))
        return {"finger": PoseTrajectory(np.array(times), start + np.array(offsets), quaternions)}

    return build
