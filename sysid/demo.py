"""The demonstration behind ``make demo``: find out what a rig leaves out, and compare with the truth.

A gel finger presses on a block. Its gel is softer than the rig says, and something else, drawn from a few effects, acts
on the recordings, of which the rig knows nothing. What that is, is sealed: its digest is printed before anything is
fitted. The diagnosis sees the rig and three recordings, one of them held out; at the end the seal is opened. Run with
``python -m sysid.demo [FOLDER]``.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.effects import effect_by_name
from sim_core.errors import ConfigError, ThinshellError
from sim_core.rigs import load_rig, with_parameters
from sim_core.rigs.motion import load_experiment
from sysid.diagnosis.diagnose import diagnose_runs
from sysid.diagnosis.result import Diagnosis
from sysid.model.load import load_run
from sysid.progress import progress
from sysid.proof.seal import open_seal, write_seal
from sysid.report import REPORT, write_diagnosis_report
from sysid.simulate import simulate_to_bag

RIG = "gel_sensor"
TRUTH = {"gel.E_pa": 1.6e5, "contacts.gel-block.friction": 0.5}
CONCEALED: dict[str, dict[str, float]] = {
    "gel_relaxation": {"share": 0.25, "tau_s": 0.3},
    "wrench_gain": {"force_z": 0.15},
    "stream_delay": {"vision_s": 0.05},
    "wrench_offset": {"bias_x_n": 0.08, "bias_z_n": -0.1},
}
SEED = 11
TRAINING = ("press_and_hold", "press_twist")
HELD_OUT = ("press_and_rub",)
DEFAULT = Path("out/demo")
"""Folder of the demonstration where none is given."""


def main(folder: Path = DEFAULT) -> int:
    """Run the demonstration in ``folder``. What an earlier one left in the default folder is replaced."""
    _prepare(folder)
    rig = load_rig(RIG)
    rng = np.random.default_rng(SEED)
    name = str(rng.choice(sorted(CONCEALED)))
    values = _values(name, float(rng.uniform(0.9, 1.1)))
    digest = write_seal(folder, {"materials": TRUTH, "effect": {name: values}}, salt=rng.bytes(16).hex())
    print(f"Something is concealed and sealed; SHA-256 of what it is: {digest}")
    truth = with_parameters(rig, TRUTH).model_copy(update={"effects": {name: values}})
    for motion in (*TRAINING, *HELD_OUT):
        experiment = load_experiment(motion)
        with progress(f"record {motion}") as report:
            print(simulate_to_bag(truth, experiment, folder / motion, seed=experiment.seed, on_progress=report))
    runs, held_out = ([load_run(rig, folder / n) for n in names] for names in (TRAINING, HELD_OUT))
    with progress("diagnose") as report:
        diagnosis, _ = diagnose_runs(rig, runs, held_out, on_progress=report)
    diagnosis.write(folder / "diagnosis.json")
    page = write_diagnosis_report(diagnosis, folder / REPORT)
    print()
    print(_found(diagnosis))
    print(_unsealed(open_seal(folder), diagnosis))
    print(f"Report: {page.resolve()}")
    return 0


def _values(name: str, factor: float) -> dict[str, float]:
    """Parameters of a concealed effect, its sizes times a factor."""
    shapes = {p.name for p in effect_by_name(name).parameters if p.log}
    return {key: value if key in shapes else factor * value for key, value in CONCEALED[name].items()}


def _prepare(folder: Path) -> None:
    """An empty folder. Raises ``ConfigError`` where something would be lost that is not the default's."""
    if folder == DEFAULT:
        if folder.exists():
            shutil.rmtree(folder)
    elif folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise ConfigError(
            f"The folder {folder} already exists and is not empty.",
            f"Name a new one; only the default, {DEFAULT}, is replaced.",
        )
    folder.mkdir(parents=True, exist_ok=True)


def _found(diagnosis: Diagnosis) -> str:
    """The answer, and how the errors on the recording that was held out fall with it."""
    lines = [diagnosis.sentence, ""]
    shown = diagnosis.amended or diagnosis.baseline
    lines.append(f"{'held-out error':<34}{'rig, fitted':>14}{'amended':>12}{'noise':>11}")
    for e in shown.errors:
        if e.held_out:
            what = f"{e.quantity} of {e.channel}" if e.quantity else e.channel
            after = e.after if diagnosis.amended else e.before
            lines.append(f"{what:<34}{e.before:>12.3g} {e.unit:<2}{after:>11.3g}{e.noise:>11.3g}")
    return "\n".join(lines)


def _unsealed(truth: dict[str, Any], diagnosis: Diagnosis) -> str:
    """What was concealed, next to what was found."""
    found = {p.name: p for p in diagnosis.amended_parameters or diagnosis.baseline_parameters}
    lines = ["", f"{'unsealed':<34}{'true':>12}{'found':>12}  true value in the 95 % interval"]
    numbers = dict(truth["materials"])
    for name, values in truth["effect"].items():
        numbers |= {f"effects.{name}.{key}": value for key, value in values.items()}
    for name, value in numbers.items():
        p = found.get(name)
        in_words = (
            f"{p.value:>12.4g}  {'yes' if p.ci95[0] <= value <= p.ci95[1] else 'no'}" if p else f"{'not found':>12}"
        )
        lines.append(f"{name:<34}{value:>12.4g}{in_words}")
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=DEFAULT, help="where recordings and results go")
    try:
        sys.exit(main(parser.parse_args().folder))
    except ThinshellError as error:
        sys.exit(f"demo: {error}")
