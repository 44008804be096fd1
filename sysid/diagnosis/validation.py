"""How two models compare on recordings that neither was fitted to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sysid.diagnosis.evidence import held_out_gain, log_likelihood_ratio
from sysid.diagnosis.residual_analysis import whitened
from sysid.settings.diagnosis import DIAGNOSIS
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
    """Share of the robust misfit on held-out runs that an amendment removes (:func:`seen_by_both`); None where nothing
    is to be seen."""
    return None if both is None else held_out_gain(both[0].residual, both[1].residual)


def ratios_of(check: Problem, both: tuple[Fitted, Fitted] | None) -> tuple[np.ndarray, np.ndarray] | None:
    """Log likelihood ratios [nats] of two models by blocks of time of all held-out runs ``(b,)``, as their residuals
    are judged, beside what careful models differ in (:func:`sysid.diagnosis.residual_analysis.whitened`), and the
    squares of what they differ by there ``(b,)``. None where nothing is to be seen."""
    if both is None:
        return None
    white: list[tuple[np.ndarray, np.ndarray]] = []
    blocks: list[np.ndarray] = []
    for i, run in enumerate(check.runs):
        for m in run.measured:
            plain, amended = (whitened(check, model, i, m) for model in both)
            seen = np.isfinite(plain) & np.isfinite(amended)
            block = np.clip(
                (DIAGNOSIS.time_blocks * m.t / max(run.end, 1e-12)).astype(int), 0, DIAGNOSIS.time_blocks - 1
            )
            blocks.append(np.broadcast_to((i * DIAGNOSIS.time_blocks + block)[:, None], seen.shape)[seen])
            white.append((plain[seen], amended[seen]))
    plain, amended = (np.concatenate([pair[k] for pair in white]) for k in (0, 1))
    at = np.concatenate(blocks)
    there = np.bincount(at) > 0
    return (
        np.bincount(at, log_likelihood_ratio(plain, amended))[there],
        np.bincount(at, (plain - amended) ** 2)[there],
    )


def of_readings(fitted: Fitted) -> float:
    """Misfit without what priors add."""
    readings = fitted.residual[: len(fitted.residual) - fitted.pulls]
    return float(readings @ readings) / max(fitted.samples, 1)
