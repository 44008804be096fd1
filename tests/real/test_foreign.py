"""Recordings of a simulator that shares no method with this one, on short windows."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from sim_core.rigs import load_rig
from sysid.diagnosis.diagnose import diagnose_runs
from sysid.model.load import load_runs

SHARED = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
DATA = SHARED / "data" / "foreign"

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"no folder {DATA}: set THINSHELL_SHARED to the folder that holds data/"
)


@pytest.mark.slow
def test_where_nothing_is_concealed_nothing_is_missing() -> None:
    """A strip that is tilted, pressed and landed; its modulus is given by a data sheet that is off by a fifth."""
    case = DATA / "strip_a"
    rig = load_rig(case / "rig.yaml")
    runs, held_out = load_runs(rig, [case / "rec_01@0:1.5", case / "rec_03@0:1"], [case / "rec_02@0:0.8"])
    found, _ = diagnose_runs(rig, runs, held_out)
    assert found.verdict == "nothing_missing", found.sentence
    (modulus,) = (p for p in found.baseline_parameters if p.name.endswith(".E_pa"))
    true = json.loads((DATA / "answers.json").read_text())["strip_a"]["strip"]["E"]
    assert modulus.ci95[0] < true < modulus.ci95[1]
    assert modulus.value == pytest.approx(true, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["strip_a", "strip_b"])
def test_noise_as_sensors_have_it_is_nothing_that_is_missing(name: str) -> None:
    """Whole recordings, the second ones with coloured noise, a camera that shakes, lost markers and frames, and stamps
    that jitter: by a milliradian while the hand turns. The clock of the poses and the spectrum of the wrench decide on
    these."""
    case = DATA / name
    rig = load_rig(case / "rig.yaml")
    runs, held_out = load_runs(rig, [case / "rec_01", case / "rec_02"], [case / "rec_03"])
    found, _ = diagnose_runs(rig, runs, held_out)
    assert found.verdict == "nothing_missing", found.sentence
    true = json.loads((DATA / "answers.json").read_text())[name]["strip"]
    for p in found.baseline_parameters:
        key = {"E_pa": "E", "density_kg_m3": "rho", "friction": "mu"}.get(p.name.rsplit(".", 1)[-1])
        if key is not None:
            assert p.ci95[0] < true[key] < p.ci95[1], p.name
