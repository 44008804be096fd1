"""How two models compare on recordings that neither was fitted to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sysid.diagnosis.baseline import Baseline
from sysid.diagnosis.result import Misfit
from sysid.discretisation.refinement import error_sizes
from sysid.fit.result import ChannelError, rms_errors
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


def seen_by_both(check: Problem, plain: Fitted | None, amended: Fitted | None) -> tuple[Fitted, Fitted] | None:
    """Two models on what both see of the held-out runs ``check``; None where that is nothing.

    A reading that one of them hides tells neither for it nor against it, also not through the discretisation error that
    is fitted to it.
    """
    if plain is None or amended is None:
        return None
    pair = (plain.predictions, amended.predictions)
    sight = [
        {c: np.isfinite(v) & np.isfinite(there.values[c]) for c, v in here.values.items()}
        for here, there in zip(*pair, strict=True)
    ]
    found = []
    for model, predictions in zip((plain, amended), pair, strict=True):
        both = list(zip(predictions, sight, strict=True))
        if all(np.array_equal(s[c], np.isfinite(v)) for p, s in both for c, v in p.values.items()):
            found.append(model)
        else:
            common = [replace(p, values={c: np.where(s[c], v, np.nan) for c, v in p.values.items()}) for p, s in both]
            found.append(check.compare(common, model.rig, [], np.zeros(0)))
    return (found[0], found[1]) if found[0].samples else None


def gain_of(both: tuple[Fitted, Fitted] | None) -> float | None:
    """Share of the misfit on held-out runs that an amendment removes (:func:`seen_by_both`); None where nothing is to
    be seen."""
    return None if both is None else 1.0 - of_readings(both[1]) / of_readings(both[0])


def misfit_of(base: Baseline, fitted: Fitted, there: Fitted | None) -> Misfit:
    """Misfit of a model, with the errors of the baseline next to its own."""
    both = seen_by_both(base.check, base.there, there)
    errors = rms_errors(base.problem, base.fitted, fitted, held_out=False, own=error_sizes(base.problem))
    if base.there is not None and there is not None:
        errors += rms_errors(base.check, base.there, there, held_out=True, own=error_sizes(base.check))
    return Misfit(of_readings(fitted), None if both is None else both[1].misfit, tuple(errors))


def worst_quantity(misfit: Misfit) -> str:
    """The quantity that a model misses most over its noise, in words with units."""

    def multiple(e: ChannelError) -> float:
        return e.after_over_noise or 0.0

    if not misfit.errors:
        return ""
    e = max(misfit.errors, key=multiple)
    what = f"the {e.quantity or 'position'} of {e.channel} in {e.run}"
    return f"{what}: {e.after:.3g} {e.unit}, {multiple(e):.1f} times its noise"


def beyond_noise(plain: Fitted, amended: Fitted) -> float:
    """Share of the misfit beyond noise that an amendment removes, 0 to 1."""
    before, after = of_readings(plain), of_readings(amended)
    return float(np.clip((before - after) / max(before - 1.0, before - after, 1e-12), 0.0, 1.0))


def of_readings(fitted: Fitted) -> float:
    """Misfit without what priors add."""
    readings = fitted.residual[: len(fitted.residual) - fitted.pulls]
    return float(readings @ readings) / max(fitted.samples, 1)
