"""A fit does not worsen what it was given, and says why where an error rises all the same.

A search takes the error of mesh and time step, as one refinement shows it, out of the readings. Recordings that were
made with the very mesh and step of the rig, as simulated ones, are without that error: values that explain them are
then left for others, which do so less well. Where the rig as it was given explains every channel down to its noise,
or far better than the error of mesh and time step lets expect, and the fitted one errs more, the given values stay,
with intervals by the curvature there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from sim_core.errors import ThinshellError
from sysid.fit.result import ChannelError
from sysid.settings.fit import FIT
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

STAYS = "the values that the rig was given stay"
"""How the search is said to have ended."""


def worsened(errors: Iterable[ChannelError]) -> list[ChannelError]:
    """Channels of the recordings that were fitted whose error the fit made larger, beyond the noise."""
    return [
        e
        for e in errors
        if not e.held_out
        and e.before_over_noise is not None
        and e.after_over_noise is not None
        and e.after_over_noise > FIT.worse_error_ratio * max(e.before_over_noise, 1.0)
    ]


def rose(errors: Sequence[ChannelError]) -> bool:
    """Whether the error over all channels of the recordings that were fitted has become larger, and some channel's
    visibly so."""
    known = [e for e in errors if not e.held_out and e.before_over_noise and e.after_over_noise]
    before, after = (
        sum(ratio * ratio for ratio in ratios)
        for ratios in ([e.before_over_noise or 0.0 for e in known], [e.after_over_noise or 0.0 for e in known])
    )
    return after > before and bool(worsened(known))


def explained_as_given(errors: Sequence[ChannelError]) -> bool:
    """Whether the rig that was given explains every channel of the recordings that were fitted."""
    known = [e for e in errors if not e.held_out]
    return bool(known) and all(
        e.before <= max(FIT.explained_over_noise * e.noise, FIT.explained_over_discretisation * e.own) for e in known
    )


def given(problem: Problem, fitted: Fitted, first: np.ndarray, errors: Sequence[ChannelError]) -> Fitted | None:
    """The problem at the values ``first`` ``(p,)`` that the rig was given, where these are to stay; None elsewhere."""
    if not fitted.converged or not fitted.parameters or not (rose(errors) and explained_as_given(errors)):
        return None
    try:
        there = problem.evaluate(fitted.centre, fitted.parameters, first)
    except ThinshellError:
        return None
    return replace(there, evaluations=fitted.evaluations + 1, converged=True, message=STAYS, began=fitted.began)


def said_of_stay(errors: Sequence[ChannelError]) -> str:
    """Why the given values stay; ``errors``: of the fit that is not taken."""
    worst = max(worsened(errors), key=lambda e: e.after_over_noise or 0.0)
    return (
        f"The values of the rig as it was given stay: they leave {worst.before_over_noise:.2g} times the noise in "
        f"{_words(worst)}, and those of the search would leave {worst.after_over_noise:.2g} times. A search takes the "
        "error of mesh and time step out of the readings, which these recordings do not have."
    )


def said_of_rise(errors: Sequence[ChannelError]) -> list[str]:
    """Why errors are larger than before, where they are."""
    if not rose(errors):
        return []
    found = worsened(errors)
    where = ", ".join(dict.fromkeys(_words(e) for e in found))
    if any(e.own > e.noise for e in found):
        why = (
            "A fit takes the error of mesh and time step out of the readings before it compares, and the values that "
            "were given may have made up for it. Use finer cells or a shorter solver.dt_s, and fit again."
        )
    else:
        why = (
            "A fit weighs errors by the correlation of their noise and by what was known before, which the errors "
            "shown here do not."
        )
    return [f"The fitted rig errs more than the rig as it was given in {where}. {why}"]


def _words(error: ChannelError) -> str:
    return f"the {error.quantity or 'position'} of {error.channel}"
