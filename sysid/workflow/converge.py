"""Makes a rig converge along an experiment or a recording: the function behind ``thinshell converge``."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from sim_core.rigs import Rig, rig_to_yaml
from sim_core.rigs.motion import load_experiment
from sysid.discretisation.error_budget import Convergence, converge, refuse_no_noise
from sysid.model.load import load_runs
from sysid.noise.estimate import as_declared, channel_noise, undeclared
from sysid.progress.callback import Progress
from sysid.simulate import simulate_to_bag


def converge_rig(
    rig: Rig,
    motion: str,
    out: Path,
    *,
    most_s: float = 600.0,
    on_progress: Progress | None = None,
    on_warning: Callable[[str], None] | None = None,
) -> Convergence:
    """Refine a rig (:func:`sysid.discretisation.error_budget.converge`) along a ``motion``, a recording or an
    experiment, and write it to ``out``. The noise is that of the recording, or, along an experiment, that which the rig
    declares."""
    if Path(motion).exists() and Path(motion).suffix not in (".yaml", ".yml"):
        runs, _ = load_runs(rig, [Path(motion)], (), on_warning)
        noise = channel_noise(rig, runs)
    else:
        refuse_no_noise(undeclared(rig))
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / "motion"
            simulate_to_bag(rig, load_experiment(motion), bag)
            runs, _ = load_runs(rig, [bag])
        noise = {m.channel: as_declared(rig, m) for run in runs for m in run.measured}
    found = converge(rig, runs, noise, most_s=most_s, on_progress=on_progress)
    out.write_text(rig_to_yaml(found.rig))
    return found
