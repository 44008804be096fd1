"""What of the simulator's own error follows no shape, and repeats itself from sample to sample.

Fits weigh samples down by it (:mod:`sysid.fit.directions`), as if it were independent in each of them. But nothing says
that it changes faster than the sizes of what has a shape may, and intervals must not shrink with the rate of a sensor
whose readings all are off by it. For them it is therefore the same throughout each interval b between the instants of
the finest level of those sizes, column by column. With w the weight of a sample, of whose variance it is then the share
1 - w^2, the scores J^T r have the covariance

    sum_b s_b s_b^T,  s_b = sum_{k in b} sqrt(1 - w_k^2) J_k,    instead of    sum_k (1 - w_k^2) J_k J_k^T.

Estimates, and the misfit that tells whether something is missing, stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sysid.fit.directions import LEVELS


class Rough(NamedTuple):
    """Of a channel of one run: which samples are ``there`` ``(n, m)``, the ``share`` of their variance that follows no
    shape ``(n, m)``, and the interval that each instant is in ``(n,)``, from 0."""

    there: np.ndarray
    share: np.ndarray
    block: np.ndarray


def rough_of(there: np.ndarray, weights: np.ndarray, t: np.ndarray, end: float) -> Rough:
    """Of samples ``(n, m)`` with these ``weights`` ``(n, m)`` at times [s] ``(n,)`` of a run until ``end``."""
    count = LEVELS[-1][0] - 1
    block = np.clip((t / max(end, 1e-9) * count).astype(int), 0, count - 1)
    return Rough(there, 1.0 - weights**2, block)


def coherent_scores(parts: Sequence[tuple[Rough, np.ndarray]], p: int) -> np.ndarray:
    """By how much the covariance of the scores exceeds that of independent samples ``(p, p)``; with the rows of the
    jacobian of the samples that are there ``(rows, p)``."""
    excess = np.zeros((p, p))
    for rough, rows in parts:
        scores = np.zeros((*rough.there.shape, p))
        scores[rough.there] = rows * np.sqrt(rough.share[rough.there])[:, None]
        together = np.zeros((int(rough.block.max(initial=0)) + 1, *scores.shape[1:]))
        np.add.at(together, rough.block, scores)
        excess += np.tensordot(together, together, ((0, 1), (0, 1))) - np.tensordot(scores, scores, ((0, 1), (0, 1)))
    return excess
