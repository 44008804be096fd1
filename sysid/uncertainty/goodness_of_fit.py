"""What a fit leaves unexplained, quantity by quantity.

One wrench among a thousand markers may be missed by far while the misfit of all readings together is that of noise, so
each quantity of each channel of each run is judged by itself: the mean square of its whitened residual, 1 where noise
alone is left. The discretisation error is allowed for as far as it is credible
(:func:`sysid.solve.discretisation_basis.credible_error`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.noise.estimate import quantities
from sysid.settings.uncertainty import UNCERTAINTY
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


@dataclass(frozen=True)
class QuantityMisfit:
    """Mean square of the whitened residual of one ``quantity`` of a ``channel`` in a ``run``; empty: in all that have
    few readings of it. ``samples``: number of readings."""

    run: str
    channel: str
    quantity: str
    misfit: float
    samples: int

    @property
    def excess(self) -> float:
        """The misfit in units of what noise may leave, times ``UNCERTAINTY.good_misfit``."""
        return (
            UNCERTAINTY.good_misfit
            * self.misfit
            / max(UNCERTAINTY.good_misfit, 1.0 + UNCERTAINTY.chance_sd * float(np.sqrt(2.0 / self.samples)))
        )


def misfit_by_quantity(problem: Problem, fitted: Fitted) -> list[QuantityMisfit]:
    """All quantities, the discretisation error and biases allowed for."""
    found = []
    few: dict[tuple[str, str], list[np.ndarray]] = {}
    for i, run in enumerate(problem.runs):
        for m in run.measured:
            white = problem.judged(i, m, m.values - problem.explained(fitted, i, m))
            for quantity, group in quantities(m):
                seen = white[:, group][np.isfinite(white[:, group])]
                if len(seen) >= UNCERTAINTY.fewest_readings:
                    found.append(QuantityMisfit(run.name, m.channel, quantity, float(np.mean(seen**2)), len(seen)))
                elif len(seen):
                    few.setdefault((m.channel, quantity), []).append(seen)
    for (channel, quantity), parts in few.items():
        seen = np.concatenate(parts)
        found.append(QuantityMisfit("", channel, quantity, float(np.mean(seen**2)), len(seen)))
    return found


def worst(problem: Problem, fitted: Fitted) -> float:
    """The largest :attr:`QuantityMisfit.excess` of any quantity; 0 without readings."""
    return max((found.excess for found in misfit_by_quantity(problem, fitted)), default=0.0)


def noise_multiples(problem: Problem, fitted: Fitted) -> dict[str, float]:
    """By quantity and channel, in words, the largest root mean square of what a fit leaves, in units of its noise."""
    most: dict[str, float] = {}
    for found in misfit_by_quantity(problem, fitted):
        words = f"the {found.quantity} of {found.channel}"
        most[words] = max(most.get(words, 0.0), float(np.sqrt(found.misfit)))
    return most


def no_success(multiples: Mapping[str, float], tried: Sequence[str]) -> str:
    """What is said, before anything else, of a model that misses readings by more than
    ``UNCERTAINTY.failed_noise_multiple`` times their noise (:func:`noise_multiples`); empty where none does. ``tried``:
    what was tried to explain it, in words."""
    worst = {words: times for words, times in multiples.items() if times > UNCERTAINTY.failed_noise_multiple}
    if not worst:
        return ""
    missed = ", ".join(f"{times:.3g} times the noise in {words}" for words, times in worst.items())
    sentences = " ".join(["Tried to explain it:", *tried]) if tried else "No mistake of set-up was tried to explain it."
    return (
        f"This is no success: the model misses the recordings by {missed} (more than "
        f"{UNCERTAINTY.failed_noise_multiple:g} times). Take its values as no result. {sentences}"
    )


def unexplained(problem: Problem, fitted: Fitted) -> list[str]:
    """Sentences, if more than noise is left in any quantity: in which, and what that means for the values. Also whether
    the recordings may be of another rig."""
    most: dict[tuple[str, str], QuantityMisfit] = {}
    for found in misfit_by_quantity(problem, fitted):
        known = most.get((found.channel, found.quantity))
        if found.excess > max(UNCERTAINTY.good_misfit, known.excess if known else 0.0):
            most[found.channel, found.quantity] = found
    if not most:
        return []
    parts = [
        f"{np.sqrt(found.misfit):.2g} times the noise in the {quantity} of {channel}"
        + (f" ({found.run})" if found.run and len(problem.runs) > 1 else "")
        for (channel, quantity), found in most.items()
    ]
    said = f"The rig does not explain the recordings: what it leaves is {', '.join(parts)}."
    if problem.error_shapes:
        said += " Twice the error of mesh and time step that one refinement shows is allowed for."
    if fitted.parameters:
        said += (
            " Intervals are widened by the misfit, but a law that is missing, or a minimum that is not the lowest, can "
            "pull values further away than they say: 'thinshell diagnose' looks for the one, '--starts 5' for the "
            "other."
        )
    foreign = {run.path: f"{run.name}: {run.unlike}" for run in problem.runs if run.unlike}
    return [said, *foreign.values()]
