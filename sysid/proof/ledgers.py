"""Ledgers of all cases of a folder: what a diagnosis sees, without its refits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from sim_core.rigs import load_rig
from sysid.diagnosis.diagnose import ledger_of
from sysid.model.load import load_runs
from sysid.progress.callback import Progress
from sysid.proof.run import case_folders

LEDGER_FILE = "ledger.npz"


def make_ledgers(folder: Path, *, on_progress: Progress | None = None) -> str:
    """Write ``ledger.npz`` into every case that has none yet; what a case conceals is not read."""
    cases = case_folders(folder)
    tell = on_progress or (lambda share, text: None)
    for k, case in enumerate(cases):
        if (case / LEDGER_FILE).is_file():
            continue

        def report(share: float, text: str, k: int = k, name: str = case.name) -> None:
            tell((k + share) / len(cases), f"{name}: {text}")

        roles, rig = yaml.safe_load((case / "case.yaml").read_text()), load_rig(case / "rig.yaml")
        # Nothing is refitted, so that one recording held out is enough: the baseline is checked by it.
        bags = [case / name for name in (*roles["training"], *roles["held_out"])]
        runs, held_out = load_runs(rig, bags[:-1], bags[-1:])
        partial = case / f"{LEDGER_FILE}.partial"
        ledger_of(rig, runs, held_out, shapes=np.random.default_rng(k), on_progress=report).write(partial)
        partial.rename(case / LEDGER_FILE)
    return f"{folder}: ledgers of {len(cases)} cases."
