"""Experiments of the bench of materials: what a fit does not know must not make readings jump."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from sim_core.rigs import Rig, list_parameters, load_rig, with_parameters
from sim_core.rigs.motion import load_experiment
from sysid.model.load import load_run
from sysid.model.predictor import SerialPredictor
from sysid.simulate import simulate_to_bag

OFFSETS = [f"gripper.offset_{a}" for a in ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")]
SD = np.array([5e-4, 5e-4, 5e-4, 0.5, 0.5, 0.5])
STEP = 0.01
"""In standard deviations."""

MATERIALS = ["strip.E_pa", "strip.thickness_m", "strip.density_kg_m3"]


def moved(rig: Rig, by: np.ndarray) -> Rig:
    return with_parameters(rig, dict(zip(OFFSETS, by, strict=True)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pull_taut", "slacken", "rub_post", "rub_strip"])
def test_readings_change_smoothly_with_the_offsets_of_the_gripper(name: str, tmp_path: Path) -> None:
    """Second differences along a line through several places stay far below the noise; a strip that buckles at another
    instant, or the other way, is off by fifty times the noise of the camera."""
    rig = load_rig("material_bench")
    simulate_to_bag(rig, load_experiment(name), tmp_path / "bag")
    run, engine = load_run(rig, tmp_path / "bag"), SerialPredictor()
    rng = np.random.default_rng(4)
    for _ in range(3):
        at, along = SD * rng.standard_normal((2, 6))
        there = [engine.predict(moved(rig, at + k * STEP * along), run).values for k in range(3)]
        bent = there[2]["outside"] - 2.0 * there[1]["outside"] + there[0]["outside"]
        assert np.nanmax(np.abs(bent)) < 0.05


@pytest.mark.slow
def test_the_bow_hangs_whatever_the_strip_is_made_of(tmp_path: Path) -> None:
    """With twice and half of what the rig says of it and with the gripper off, it is nowhere 60 pixels higher; one that
    arches up is higher by 180."""
    rig = load_rig("material_bench")
    simulate_to_bag(rig, load_experiment("slacken"), tmp_path / "bag")
    run, engine = load_run(rig, tmp_path / "bag"), SerialPredictor()
    plain = engine.predict(rig, run).values["outside"][:, 1::2]
    usual = {p.name: p.value for p in list_parameters(rig) if p.value is not None}
    rng = np.random.default_rng(6)
    for corner in itertools.product((0.5, 2.0), repeat=3):
        other = with_parameters(rig, {n: by * usual[n] for n, by in zip(MATERIALS, corner, strict=True)})
        there = engine.predict(moved(other, SD * rng.standard_normal(6)), run).values["outside"][:, 1::2]
        assert np.nanmin(there - plain) > -60.0, corner
