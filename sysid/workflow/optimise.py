"""Searches for a motion and draws how it was found: the function behind ``thinshell optimise`` and the node."""

from __future__ import annotations

from pathlib import Path

from sim_core.optimise import Result, Settings, optimise
from sim_core.optimise.problem import OnRollout
from sim_core.tasks import MadeTask
from sysid.report.optimisation_curve import draw_curves


def optimise_task(made: MadeTask, settings: Settings, out: Path, on_rollout: OnRollout | None = None) -> Result:
    """Search (:func:`sim_core.optimise.optimise`) in a folder, a new one or one that goes on, and draw the best reward
    over the rollouts into its ``curve.png``."""
    result = optimise(made, settings, out, on_rollout)
    draw_curves(out / "curve.png", [(settings.method, result.curve)], made)
    return result
