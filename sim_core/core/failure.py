"""What is said of a step of which the core finds no end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim_core.errors import ConvergenceError
from sim_core.scene.scene import Frame, Scene
from sim_core.scene.solid_range import volumes_left
from sim_core.solve.report import Result

BLOCKED, NOT_FACTORISED, TURNED_OVER = 2, 4, 5
RESULTS = dict(enumerate((Result.ITERATION_LIMIT, Result.LINE_SEARCH_FAILED, Result.BLOCKED, Result.NOT_FINITE)))
"""``Failure`` of include/record.hpp."""


def failure_of(
    scene: Scene, counts: np.ndarray, terms: Sequence[str], before: np.ndarray, there: np.ndarray, t: float, dt: float
) -> ConvergenceError:
    """The error of a step of ``dt`` [s] from ``t`` [s], where nodes were at ``before``, of which the search ended
    ``there`` [m] ``(n, 3)`` and did what ``counts`` say; ``terms``: names of contacts."""
    failure = int(counts["failure"])
    if failure == TURNED_OVER:
        return min(
            volumes_left(scene, np.stack([before, there]), np.array([t])), key=lambda found: found.ratio
        ).refused()
    if failure == NOT_FACTORISED:
        return ConvergenceError(
            "The stiffness matrix cannot be factorised.",
            "Check that every body is held by a clamp, a mount or contact, or switch inertia on.",
        )
    if failure == BLOCKED:
        bodies = terms[int(counts["tightest"])].removeprefix("contact.").split(".")[0].replace("-", " and ")
        return ConvergenceError(
            f"From t = {t:.4f} s on, {bodies} cannot give way any further to the motion that is prescribed: their gap "
            f"is {max(float(counts['gap']), 0.0):.1g} m and must stay above 0.",
            "End the motion there, or leave more room between what is held and what moves.",
        )
    return ConvergenceError(
        f"The step from t = {t:.4f} s (dt = {dt:g} s) did not converge: {RESULTS[failure].value} after "
        f"{counts['iterations']} Newton iterations, residual {counts['residual']:.3g} N, last update "
        f"{counts['update']:.3g} m.",
        "Use a smaller solver.dt_s, a slower motion, or a finer mesh where the sheet folds.",
    )


def unmade(start: Mapping[str, Frame], end: Mapping[str, Frame], share: float) -> str:
    """How much of the mounts' motion in a step was made, in words."""
    parts = []
    for mount, (there, _) in end.items():
        whole = 1e3 * float(np.linalg.norm(there - start[mount][0]))
        if whole > 0.0:
            parts.append(f"{mount} has made {share * whole:.3g} of the {whole:.3g} mm of this step.")
    return " ".join(parts)
