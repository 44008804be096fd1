"""What kinds of rollouts cost over plain ones, as ``sysid/settings/progress.py`` has it from here:
``python tests/support/costs_of_rollouts.py`` diagnoses a recording of each of some rigs (about 10 minutes)."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sim_core.rigs import load_rig
from sim_core.rigs.motion import load_experiment
from sysid import diagnose_bags, fit_bags, simulate_to_bag
from sysid.progress.rollout_costs import Kind, kind_of
from sysid.progress.work import Work, stages_of
from sysid.settings.progress import PROGRESS

RECORDED = (
    ("strip_coarse", "pull_taut", ("strip.E", "strip.nu")),
    ("card_press", "press_post", ("gel.E", "gel-post.friction")),
    ("gel_sensor", "press_twist", ("gel.E",)),
)
KINDS = ("beginning", "shorter", "finer", "derivatives", "responses")


def ratios(rig_name: str, motion: str, names: Sequence[str]) -> dict[str, float]:
    """Costs of the kinds over that of a plain rollout, in a fit and a diagnosis of one recording."""
    rig = load_rig(rig_name)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        simulate_to_bag(rig, load_experiment(motion), bag)
        fit = Work(None, stages_of(PROGRESS.fit_rollouts, PROGRESS.fit_between_s), 1)
        fit_bags(rig, [bag], names, out=Path(folder) / "fit", on_progress=fit)  # type: ignore[arg-type]
        diagnosis = Work(None, stages_of(PROGRESS.diagnosis_rollouts, PROGRESS.diagnosis_between_s), 1)
        diagnose_bags(rig, [bag], out=Path(folder) / "diagnosis", on_progress=diagnosis)  # type: ignore[arg-type]
    found = {}
    for words in KINDS:
        costs = (diagnosis if words == "responses" else fit).costs
        if costs.count(kind_of(words)):
            found[words] = (costs.seconds(kind_of(words)) or np.nan) / (costs.seconds(Kind()) or np.nan)
    return found


def main() -> None:
    """Print the ratios of each rig, and their geometric mean."""
    all_of_them: dict[str, list[float]] = {words: [] for words in KINDS}
    for rig_name, motion, names in RECORDED:
        found = ratios(rig_name, motion, names)
        print(rig_name, {words: round(ratio, 2) for words, ratio in found.items()}, flush=True)
        for words, ratio in found.items():
            all_of_them[words].append(ratio)
    for words, each in all_of_them.items():
        print(f"{words}: {np.exp(np.mean(np.log(each))):.2g}")


if __name__ == "__main__":
    main()
