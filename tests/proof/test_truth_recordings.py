"""Recordings of the independent truths: the contract, the noise, the same seed, agreement with the simulator."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from sim_core.rigs import load_rig, with_parameters
from sim_core.rigs.load import parse_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sysid.model.load import load_run
from sysid.model.predictor import SerialPredictor
from sysid.proof import record_cases
from sysid.proof.truths import gel
from sysid.proof.truths.noise import coloured, nasty, spoil_tracks, stamps, wrench_noise
from sysid.proof.truths.paths import Path as Route


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
    assert truth["effects"] == []
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


@pytest.mark.slow
def test_the_layer_and_the_simulator_agree_as_far_as_a_coarse_mesh_goes() -> None:
    """Pressed and slid: errors of the markers below the noise, forces within what 10 x 10 x 3 cells can do."""
    pad = gel.draw_pad(np.random.default_rng(5))
    path = Route((0.0, 0.0, 2e-5)).wait(0.2).move((0.0, 0.0, -pad.depth - 2e-5), 0.4).wait(0.2)
    path.move((1.5e-3, 0.0, 0.0), 0.8).wait(0.2)
    clean = gel.PadTruth(pad).run(path)
    pixels = pad.camera.project(clean.markers)
    described = gel.rig(pad, "pad", values={"E_pa": pad.modulus, "nu": pad.poisson, "friction": pad.friction})
    described["bodies"]["gel"]["shape"]["cells"] = [10, 10, 3]
    rig = parse_rig(described, "pad")
    t = np.arange(0.0, path.end_s + 1e-9, 0.02)
    poses = PoseTrajectory(t, pad.origin + path(t), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    trace = simulate(build_scene(rig), {"hand": poses}, step_times(0.0, path.end_s, 0.1))
    for at in (0.7, 1.7):
        k, j = int(np.argmin(np.abs(trace.times - at))), int(np.argmin(np.abs(clean.t - at)))
        assert trace.outputs["wrench"][k][[0, 2]] == pytest.approx(clean.wrench[j][[0, 2]], rel=0.06, abs=1e-3)
        moved = (trace.outputs["below"][k] - trace.outputs["below"][0]).reshape(-1, 2) - (pixels[j] - pixels[0])
        assert np.sqrt(np.mean(moved**2)) < pad.levels.px
