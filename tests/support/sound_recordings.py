"""Sound recordings: real ones, those of other simulators, and simulated ones of shipped rigs, and what `inspect --rig`
says against each.

    python tests/support/sound_recordings.py --seed 7
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from graded_setups import SETUPS

from sim_core.rigs import load_rig
from sim_core.rigs.motion import load_experiment
from sysid.cli.app import main as thinshell
from sysid.simulate import simulate_to_bag

DATA = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared")) / "data"

FURTHER = (
    ("tissue_press", "press_far"),
    ("material_bench", "slacken"),
    ("card_press", "press_hold_release"),
    ("card_press", "slide"),
)
"""Rigs and experiments other than those in which mistakes are made."""


def simulated(folder: Path, seed: int) -> Iterator[tuple[str, Path]]:
    """Rigs and recordings that are simulated with a seed of their own."""
    for rig, experiment in (*SETUPS, *FURTHER):
        bag = folder / f"{rig}+{experiment}+{seed}"
        if not bag.exists():
            simulate_to_bag(load_rig(rig), load_experiment(experiment), bag, seed=seed)
        yield rig, bag


def of_others(stride: int = 1) -> Iterator[tuple[str, Path]]:
    """Rigs and recordings of other simulators, and of a real knitted sheet, every ``stride``-th; nothing where they are
    not there."""
    for bag in sorted((DATA / "foreign").glob("*/rec_*"))[::stride]:
        yield str(bag.parent / "rig.yaml"), bag
    for bag in sorted((DATA / "knit_fabric_stretch").glob("*_pull*"))[::stride]:
        yield "knit_" + re.sub(r"_pull\d+$", "", bag.name), bag


def presses(folder: Path) -> Iterator[tuple[str, Path]]:
    """The rig and the presses of a real TacTip."""
    source = DATA / "tactip_shear" / "cr_tactip"
    if source.is_dir():
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            if not (folder / "pins").exists():
                thinshell(["track", str(source), "--out", str(folder / "pins")])
            if not (folder / "presses").exists():
                thinshell(["presses", "tactip_cr", str(folder / "pins" / "tracked"), "--out", str(folder / "presses")])
        for bag in sorted((folder / "presses").glob("*/*")):
            if bag.is_dir():
                yield "tactip_cr", bag


def accusations(rig: str, bag: Path) -> list[str]:
    """What stops a fit, as `inspect` says it; the exit code where it is not 0."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = thinshell(["inspect", str(bag), "--rig", rig])
    lines = said.getvalue().splitlines()
    return [line for line in lines if line.startswith("stops a fit")] or ([f"exit {code}: {lines[-1]}"] if code else [])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--stride", type=int, default=1, help="every so many of the recordings of others")
    parser.add_argument("--folder", type=Path, help="keep simulated recordings there")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        count = accused = 0
        for source in (simulated(folder, given.seed), of_others(given.stride), presses(folder)):
            for rig, bag in source:
                begun = time.process_time()
                found = accusations(rig, bag)
                count, accused = count + 1, accused + bool(found)
                print(
                    f"{bag.parent.name}/{bag.name}: {found or 'sound'} {time.process_time() - begun:.0f} s", flush=True
                )
    print(f"Of {count} sound recordings {accused} are accused.")


if __name__ == "__main__":
    main()
