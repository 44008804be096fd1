"""The demonstration behind ``make demo``: simulate a gripper, record it, fit it back, compare, report.

A gel finger presses and bends a card and rubs on a post. Two recordings are fitted from a start that is
30 to 60 % off, a third is only predicted. Run with ``python -m sysid.demo [FOLDER]``.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from sim_core.errors import ConfigError, ThinshellError
from sim_core.rigs import Rig, list_parameters, load_rig, with_parameters
from sim_core.rigs.motion import load_experiment
from sysid.cli.progress import progress
from sysid.fit import fit_runs
from sysid.fit.result import Estimate
from sysid.model.load import load_run
from sysid.report import write_fit_report
from sysid.simulate import simulate_to_bag

TRUTH = {"card.E_pa": 3.1e9, "gel.E_pa": 1.6e5, "contacts.gel-post.friction": 0.55}
START = {"card.E_pa": 2.0e9, "gel.E_pa": 2.4e5, "contacts.gel-post.friction": 0.35}
TRAINING = ("press_hold_release", "press_post")
HELD_OUT = ("press_post_deeper",)
DEFAULT = Path("out/demo")
"""Folder of the demonstration where none is given."""


def main(folder: Path = DEFAULT) -> int:
    """Run the demonstration in ``folder``. What an earlier one left in the default folder is replaced."""
    _prepare(folder)
    rig = load_rig("card_press")
    truth = with_parameters(rig, TRUTH)
    for name in (*TRAINING, *HELD_OUT):
        experiment = load_experiment(name)
        with progress(f"simulate {name}") as report:
            print(simulate_to_bag(truth, experiment, folder / f"{name}.bag", seed=experiment.seed, on_progress=report))
    start = with_parameters(rig, START)
    runs, held_out = ([load_run(start, folder / f"{n}.bag") for n in names] for names in (TRAINING, HELD_OUT))
    with progress("fit", timed=False) as report:
        result, _ = fit_runs(start, runs, list(START), held_out=held_out, on_progress=report)
    result.write(folder / "fit.json")
    page = write_fit_report(result, folder / "report.html")
    print()
    print(result.table())
    print(_comparison(truth, result.estimates))
    print(f"Report: {page.resolve()}")
    return 0


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


def _comparison(truth: Rig, estimates: list[Estimate]) -> str:
    """Fitted values beside the true ones."""
    true = {p.name: p.value for p in list_parameters(truth)}
    lines = [f"{'parameter':<30}{'true':>12}{'fitted':>12}{'error':>9}  true value in the 95 % interval"]
    for e in estimates:
        value = true[e.name]
        assert value is not None
        inside = "yes" if e.ci95[0] <= value <= e.ci95[1] else "no"
        lines.append(f"{e.name:<30}{value:>12.5g}{e.value:>12.5g}{100 * (e.value / value - 1):>8.2f}%  {inside}")
    return "\n".join(lines)


if __name__ == "__main__":
    try:
        sys.exit(main(*map(Path, sys.argv[1:2])))
    except ThinshellError as error:
        sys.exit(f"demo: {error}")
