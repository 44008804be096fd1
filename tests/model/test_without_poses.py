"""Recordings without a hand: what falls, hangs or relaxes by itself."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np

from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import simulate
from sysid.model.load import load_run
from sysid.model.predictor import SerialPredictor
from sysid.recording import RecordingWriter
from tests.conftest import SMALL


def test_a_recording_without_poses_is_read_by_a_rig_without_end_effectors(tmp_path: Path) -> None:
    parts = copy.deepcopy(SMALL)
    rig = parse_rig(
        {
            **parts,
            "bodies": {"card": parts["bodies"]["card"]},
            "end_effectors": {},
            "contacts": [],
            "sensors": {},
        },
        "a card that hangs",
    )
    trace = simulate(build_scene(rig), {}, np.linspace(0.0, 0.1, 6))
    with RecordingWriter(tmp_path / "bag") as bag:
        for t, uv in zip(trace.times, trace.outputs["side"], strict=True):
            bag.tracks("marker_tracks", 10**9 + round(1e9 * t), uv, np.arange(len(uv)), np.ones(len(uv)), "camera")
    run = load_run(rig, tmp_path / "bag")
    assert run.poses == {}
    seen = SerialPredictor().predict(rig, run).values["side"]
    np.testing.assert_allclose(seen, run.measured[0].values, atol=1e-3)
