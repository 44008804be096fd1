"""Compile the laws of all effects of the package, as a wheel holds them: ``python -m sim_core.shipped_laws FOLDER``.

Without a compiler the laws of effects run in numpy, called back at every residual. Which libraries there are to be is
asked of rollouts: each effect is set up on a rig that has whatever it may act on.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.core import build
from sim_core.core.record import record_values
from sim_core.core.slopes import NumberSlopes
from sim_core.effects import all_effects
from sim_core.rigs import Rig, parse_rig
from sim_core.scene import build_scene
from sim_core.solve.report import NewtonSettings

__all__ = ["compile_laws", "rig_with"]

RIG: dict[str, Any] = {
    "name": "laws",
    "bodies": {
        "sheet": {
            "type": "sheet",
            "shape": {"type": "rectangle", "length_m": 0.02, "width_m": 0.01, "cells": [2, 1], "pattern": "regular"},
            "pose": {"position_m": [0.0, 0.0, 0.02]},
            "material": {"E_pa": 1e6, "nu": 0.5, "thickness_m": 1e-3, "density_kg_m3": 1000.0},
        },
        "gel": {
            "type": "gel",
            "shape": {"type": "block", "size_m": [0.01, 0.01, 0.005], "cells": [1, 1, 1]},
            "material": {"E_pa": 1e5, "nu": 0.4, "density_kg_m3": 1000.0},
            "bonded": "bottom",
            "mount": "hand",
        },
        "floor": {"type": "rigid", "shape": {"type": "plane"}, "pose": {"position_m": [0.0, 0.0, -0.02]}},
    },
    "clamps": [{"body": "sheet", "region": {"x_m": [-0.01, -0.009]}, "mount": "world"}],
    "end_effectors": {"hand": {"start": {"position_m": [0.0, 0.0, 0.0]}}},
    "contacts": [{"between": [body, "floor"], "friction": 0.4} for body in ("sheet", "gel")],
    "sensors": {
        "wrench": {"type": "wrench", "on": "hand", "rate_hz": 50.0},
        "markers": {"type": "markers", "body": "gel", "points": {"face": "top", "grid": [2, 2]}, "rate_hz": 25.0},
    },
    "cameras": {
        "camera": {
            "model": "pinhole", "width_px": 640, "height_px": 480, "fx_px": 600.0, "fy_px": 600.0, "cx_px": 320.0,
            "cy_px": 240.0, "rate_hz": 25.0, "pose": {"position_m": [0.0, 0.0, 0.2], "rpy_deg": [180.0, 0.0, 0.0]},
            "sees": [{"body": "sheet", "points": {"grid": [2, 2]}}],
        }
    },
}  # fmt: skip
"""A sheet, a gel on a hand and a floor, measured."""


def rig_with(effect: str | None) -> Rig:
    """The rig with an effect; None: with a sheet of rubber."""
    if effect is not None:
        return parse_rig({**RIG, "effects": {effect: dict(all_effects()[effect].example)}}, "laws of effects")
    sheet = {**RIG["bodies"]["sheet"], "law": "neo_hookean"}
    return parse_rig({**RIG, "bodies": {**RIG["bodies"], "sheet": sheet}}, "laws of effects")


def compile_laws(effect: str | None) -> None:
    """Have the laws of a rig with an effect."""
    scene = build_scene(rig_with(effect))
    record_values(scene, NewtonSettings(), np.empty(0, dtype=int), NumberSlopes(), 0)


def shipped() -> Iterator[str | None]:
    """Effects of the package, and the rubber of sheets."""
    yield None
    yield from (name for name, effect in all_effects().items() if type(effect).__module__.startswith("sim_core."))


def main(folder: Path) -> None:
    """Compile all laws into a folder."""
    with tempfile.TemporaryDirectory() as cache, ThreadPoolExecutor(os.cpu_count()) as threads:
        os.environ["XDG_CACHE_HOME"] = cache
        list(threads.map(compile_laws, shipped()))
        folder.mkdir(parents=True, exist_ok=True)
        libraries = sorted((build.cache_folder() / build.LAWS_OF_EFFECTS).glob("*.so"))
        for library in libraries:
            shutil.copy2(library, folder)
    print(f"{len(libraries)} laws of effects compiled into {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
