"""Plans experiments and writes the plan: the function behind the node's ``~/plan``."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from sim_core.rigs import Rig
from sim_core.rigs.motion import Experiment
from sysid.design.experiment_design import Plan, plan_experiments
from sysid.io.atomic_folder import whole_folder, write_results
from sysid.model.nuisance_parameters import KINDS
from sysid.progress import Progress


def plan_to_folder(
    rig: Rig,
    experiments: Sequence[Experiment],
    names: Sequence[str],
    *,
    out: Path,
    on_progress: Progress | None = None,
    nuisance: Collection[str] = KINDS,
) -> Plan:
    """Plan (:func:`plan_experiments`) and write ``plan.json`` into ``out``."""
    with whole_folder(out) as folder:
        found = plan_experiments(rig, experiments, names, on_progress, nuisance)
        write_results(folder, out, [lambda place: (place / "plan.json").write_text(found.to_json() + "\n")])
    return found
