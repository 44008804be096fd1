"""Write the recordings of one case: draw a stand, simulate its truth, spoil it with noise, write bags and rig."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sim_core.errors import ConvergenceError
from sysid.proof.truths import strip
from sysid.proof.truths.noise import white
from sysid.proof.truths.rod import RodError
from sysid.proof.truths.sensors import Streams, write_bag

NOISES = ("nasty", "white")

STANDS = ("strip",)
"""Stands whose truth this package makes."""

MOST_DRAWS = 5

TRUTH_FILE = "truth.json"


def record_cases(
    out: Path,
    stand: str,
    *,
    cases: int,
    seed: int,
    fast: bool = False,
    noise: str = "nasty",
    on_progress: Callable[[float, str], None] | None = None,
) -> str:
    """Write ``cases`` cases of one stand that conceal nothing, unsealed, each with its ``truth.json``. The returned
    text says what was written."""
    out.mkdir(parents=True)
    for k, own in enumerate(np.random.SeedSequence(seed).spawn(cases)):
        folder = out / f"case_{k + 1:02d}"

        def report(share: float, k: int = k, name: str = folder.name) -> None:
            if on_progress is not None:
                on_progress((k + share) / cases, name)

        truth = make_case(folder, stand, own, fast=fast, noise=noise, on_progress=report)
        (folder / TRUTH_FILE).write_text(json.dumps(truth, indent=2) + "\n")
    return f"{out}: {cases} cases of the stand {stand!r}, nothing concealed, {noise} noise."


def make_case(
    folder: Path,
    stand: str,
    seed: np.random.SeedSequence,
    *,
    fast: bool = False,
    noise: str = "nasty",
    on_progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Write ``folder`` with ``rig.yaml``, ``setup.yaml``, ``case.yaml`` and one bag a recording; the truth is
    returned. A draw that cannot be simulated is drawn again.

    ``fast``: fewer and shorter recordings. ``noise``: 'nasty' or 'white'.
    """
    for own in seed.spawn(MOST_DRAWS):
        try:
            return _strip_case(folder, own, fast=fast, noise=noise, on_progress=on_progress or (lambda share: None))
        except RodError:
            continue
    raise ConvergenceError(f"{folder.name}: no draw could be simulated.", "Use another seed.")


def _strip_case(
    folder: Path, seed: np.random.SeedSequence, *, fast: bool, noise: str, on_progress: Callable[[float], None]
) -> dict[str, Any]:
    for_stand, for_motion, for_noise = seed.spawn(3)
    stand = strip.draw_strip(np.random.default_rng(for_stand))
    if noise == "white":
        stand = replace(stand, levels=white(stand.levels.force, stand.levels.arm, stand.levels.px))
    size = "fast" if fast else "full"
    kinds, held_out = strip.KINDS[size], strip.HELD_OUT[size]
    motion = np.random.default_rng(for_motion)
    paths = {name: strip.draw_path(motion, stand, kind) for name, kind in kinds.items()}
    truth = strip.StripTruth(stand)
    topics = {k: k for k in ("target_pose", "current_pose", "wrench", "marker_tracks", "camera_info")}
    streams = Streams(topics, "base_link", "ee_frame", "camera_optical_frame", np.arange(len(stand.markers[0])))
    clean = {}
    for k, (name, path) in enumerate(paths.items()):
        on_progress(k / len(paths))
        clean[name] = truth.run(path)
    folder.mkdir(parents=True)
    for name, own in zip(clean, for_noise.spawn(len(clean)), strict=True):
        rng = np.random.default_rng(own)
        write_bag(folder / name, clean[name], streams, stand.camera, stand.camera, stand.levels, rng)
    _write_yaml(folder / "rig.yaml", strip.rig(stand, "strip_on_a_table"))
    _write_yaml(folder / "setup.yaml", strip.setup(stand, list(paths)))
    roles = {"training": [n for n in paths if n not in held_out], "held_out": list(held_out)}
    _write_yaml(folder / "case.yaml", roles)
    return {
        "case": folder.name,
        "rig": "strip",
        "truth": "rod",
        "effects": {},
        "materials": strip.truth_values(stand),
        "noise": stand.levels.as_dict(),
    }


def _write_yaml(path: Path, data: dict[str, Any]) -> None:
    path.write_text(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110))
