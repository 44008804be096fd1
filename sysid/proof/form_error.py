"""What a simulator is off in recordings of another formulation, by named approximation, from ledgers of empty cases.

Projected off the parameters of a rig, which take up what they can, an approximation with the columns E has the size
(tr E^T M E)^(1/2), with M what parameters leave of the identity: by how many standard deviations of the noise readings
are off if it has its whole size. Its posterior tells how much of it the recordings have, and what the evidence of
nothing missing loses without it, how much they need it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sysid.comparison.evidence import PLAIN
from sysid.comparison.learning import log_marginal
from sysid.comparison.ledger import Ledger
from sysid.proof.curve import empty_ledgers


def form_error_table(folder: Path) -> str:
    """The table of all empty ledgers of a folder. Raises ``ConfigError`` where there is none."""
    lines = [f"{'case':>12}{'approximation':>20}{'directions':>12}{'size [sd]':>11}{'of it':>16}{'needed [nats]':>15}"]
    for name, one in empty_ledgers(folder, 1).items():
        for owner in dict.fromkeys(c.owner for c in one.columns if c.kind == "approximation"):
            mine = [k for k, c in enumerate(one.columns) if c.kind == "approximation" and c.owner == owner]
            mean, sd = _posterior(one, mine)
            share = (
                f"{mean[0]:.2f} +- {sd[0]:.2f}" if len(mine) == 1 else f"rms {np.sqrt(np.mean(mean**2 + sd**2)):.2f}"
            )
            size, needed = _size(one, mine), log_marginal(one) - _without(one, mine)
            lines.append(f"{name:>12}{owner:>20}{len(mine):>12}{size:>11.1f}{share:>16}{needed:>15.1f}")
    lines.append(
        "size: of the whole approximation, projected off the parameters, in standard deviations of the noise; of it: "
        "how much the recordings have; needed: evidence of nothing missing that is lost without it."
    )
    return "\n".join(lines)


def _base(ledger: Ledger, without: list[int]) -> tuple[list[int], np.ndarray]:
    """Columns that all models have, but for some, and their precision before the recordings."""
    base = [k for k, c in enumerate(ledger.columns) if c.kind in PLAIN and k not in without]
    return base, np.array([ledger.columns[k].prior_sd ** -2 for k in base])


def _posterior(ledger: Ledger, wanted: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of coefficients ``(k,)``."""
    base, precision = _base(ledger, [])
    whole = ledger.gram
    covariance = np.linalg.inv(whole[np.ix_(base, base)] + np.diag(precision))
    prior = np.array([ledger.columns[k].prior_mean for k in base])
    mean = covariance @ (precision * prior - whole[base, -1])
    places = [base.index(k) for k in wanted]
    return mean[places], np.sqrt(np.diag(covariance)[places])


def _size(ledger: Ledger, wanted: list[int]) -> float:
    """Size of an approximation after projection off the parameters of the rig."""
    parameters = [k for k, c in enumerate(ledger.columns) if c.kind == "parameter"]
    whole = ledger.gram
    inner = whole[np.ix_(parameters, parameters)] + np.diag([ledger.columns[k].prior_sd ** -2 for k in parameters])
    cross = whole[np.ix_(parameters, wanted)]
    left = whole[np.ix_(wanted, wanted)] - cross.T @ np.linalg.solve(inner, cross)
    return float(np.sqrt(max(np.trace(left), 0.0)))


def _without(ledger: Ledger, gone: list[int]) -> float:
    """log p(y | nothing) of a model without these columns."""
    return log_marginal(ledger.less(gone))
