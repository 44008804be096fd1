"""Recordings of the independent truths: the contract, the noise, the same seed, agreement with the simulator."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from sim_core.rigs import load_rig, with_parameters
from sysid.model.load import load_run
from sysid.model.predictor import SerialPredictor
from sysid.proof import record_cases
from sysid.proof.truths.noise import coloured, nasty, spoil_tracks, stamps, wrench_noise


def test_noise_is_common_coloured_heavy_and_lossy() -> None:
    rng = np.random.default_rng(0)
    levels = nasty(0.01, 0.02, 0.1)
    force = wrench_noise(rng, levels, 40_000)
    assert force[:, 0].std() == pytest.approx(np.hypot(0.01, 0.015), rel=0.05)
    assert force[:, 4].std() == pytest.approx(0.02 * force[:, 0].std(), rel=0.1)
    slow = coloured(rng, 40_000, 1, 0.95)[:, 0]
    assert slow.std() == pytest.approx(1.0, rel=0.05)
    assert np.corrcoef(slow[1:], slow[:-1])[0, 1] == pytest.approx(0.95, abs=0.01)
    uv = spoil_tracks(rng, levels, np.full((4000, 20, 2), 300.0), np.array([320.0, 240.0])) - 300.0
    lost = np.isnan(uv[..., 0])
    assert lost.mean() == pytest.approx(0.02, abs=0.003)
    assert np.nanstd(np.nanmedian(uv, axis=1)[:, 0]) == pytest.approx(0.18, rel=0.1)
    far = np.abs(uv - np.nanmedian(uv, axis=1, keepdims=True)).max(axis=-1) > 1.0
    assert 0.012 < far.mean() < 0.02
    t = stamps(rng, levels, 30.0, 100.0, drops=0.05)
    assert len(t) == pytest.approx(3000 * 0.95, rel=0.01)
    assert (np.diff(t) > 0.0).all()


@pytest.fixture(scope="module")
def strip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("truth") / "strip"
    record_cases(out, "strip", cases=1, seed=3, fast=True, noise="white")
    return out / "case_01"


@pytest.mark.slow
def test_recordings_follow_the_contract(strip: Path) -> None:
    roles = yaml.safe_load((strip / "case.yaml").read_text())
    rig = load_rig(strip / "rig.yaml")
    truth = json.loads((strip / "truth.json").read_text())
    for name in (*roles["training"], *roles["held_out"]):
        run = load_run(rig, strip / name)
        assert {m.channel for m in run.measured} == {*rig.sensors, *rig.cameras}
    assert truth["effects"] == {}
    assert set(truth["materials"]) == {"strip.E_pa", "strip.density_kg_m3", "contacts.strip-table.friction"}


@pytest.mark.slow
def test_the_rod_and_the_simulator_agree_within_the_noise(strip: Path) -> None:
    """Lowered, pressed and slid on the table: two formulations, the same truth."""
    truth = json.loads((strip / "truth.json").read_text())
    rig = with_parameters(load_rig(strip / "rig.yaml"), truth["materials"])
    run = load_run(rig, strip / "rec_02")
    found = SerialPredictor().predict(rig, run, 1, 0.01).values
    measured = {m.channel: m for m in run.measured}
    force = (measured["wrist"].values - found["wrist"].reshape(-1, 6))[:, [0, 2]]
    assert np.sqrt(np.mean(force**2)) < 1.25 * truth["noise"]["force"]
    pixels = measured["outside"].values - found["outside"].reshape(len(measured["outside"].t), -1)
    assert np.nanmedian(np.abs(pixels)) / 0.6745 < 1.5 * truth["noise"]["px"]
