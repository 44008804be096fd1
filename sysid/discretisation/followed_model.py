"""Which of two models recordings follow: coarse or fine cells, narrow or wide pads, long or short time steps.

A recording may itself be a simulation with the discretisation of the rig. Of readings m, predictions y of one model
with derivatives J, and changes d to another one, all in units of the noise, the least squares m - y = J dtheta + a d
with what is known of theta tell the share a of the way that the recordings have gone to the other one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Run
from sysid.settings.discretisation import DISCRETISATION


@dataclass(frozen=True)
class Share:
    """How far recordings have gone from one model to another one, 0 to 1; None where both are alike. ``sd``: its
    standard deviation by noise alone [1]; ``robust_sd``: by how parts of the time differ [1]: what both models leave
    out is no noise, and goes on from reading to reading."""

    value: float | None
    sd: float
    robust_sd: float = 0.0

    @property
    def refines(self) -> bool:
        """They follow the other one rather than this, which they do unless they tell otherwise."""
        return self.value is None or self.value >= 0.5

    @property
    def surely_refines(self) -> bool:
        """The same, where what both models leave out does not decide on it."""
        if self.value is None or self.robust_sd <= DISCRETISATION.confounded_sd_ratio * self.sd:
            return self.refines
        return self.value - 2.0 * self.robust_sd >= 0.5

    @property
    def extends(self) -> bool:
        """They tell that they follow the other one, and that the two are those to choose from."""
        return (
            self.value is not None
            and self.sd < DISCRETISATION.followed_share_sd
            and 0.5 <= self.value <= DISCRETISATION.largest_followed_share
        )


def follows(
    runs: Sequence[Run],
    one: Sequence[Prediction],
    others: Sequence[Sequence[Prediction]],
    noise: dict[str, ChannelNoise],
    known_sd: np.ndarray,
) -> list[Share]:
    """The shares a of each of the ``others``, all together, jointly with the parameters of ``one``, which has
    derivatives by them; these are known to ``known_sd`` ``(p,)``.

    Parts of the time are clusters for the robust standard deviations (Liang & Zeger, Biometrika 73, 1986).
    """
    count = len(known_sd)
    rows, right, parts = [], [], []
    for k, (run, there) in enumerate(zip(runs, one, strict=True)):
        for m in run.measured:
            sigma, values = noise[m.channel].sigma, there.values[m.channel]
            changes = np.stack([(other[k].values[m.channel] - values) / sigma for other in others], axis=-1)
            table = np.concatenate([there.derivatives[m.channel] / sigma[:, None], changes], axis=-1)
            left = (m.values - values) / sigma
            seen = np.isfinite(left) & np.isfinite(table).all(axis=-1)
            rows.append(table[seen])
            right.append(left[seen])
            part = DISCRETISATION.follow_blocks * k + np.clip(
                (DISCRETISATION.follow_blocks * m.t / run.end).astype(int), 0, DISCRETISATION.follow_blocks - 1
            )
            parts.append(np.broadcast_to(part[:, None], left.shape)[seen])
    table, left, part = np.concatenate(rows), np.concatenate(right), np.concatenate(parts)
    alike = np.asarray(~table[:, count:].any(axis=0))
    prior = np.concatenate([1.0 / known_sd**2, np.zeros(len(others))])
    found, sd = _least_squares(table, left, prior)
    miss = np.abs(left - table @ found)
    near = (
        miss <= DISCRETISATION.follow_outlier_rms * max(1.0, float(np.sqrt(np.mean(miss**2))))
        if len(miss)
        else np.ones(0, dtype=bool)
    )
    found, sd = _least_squares(table[near], left[near], prior)
    robust = _robust_sd(table[near], left[near] - table[near] @ found, part[near], prior)
    return [
        Share(None, np.inf) if same else Share(float(a), float(s), float(r))
        for same, a, s, r in zip(alike, found[count:], sd[count:], robust[count:], strict=True)
    ]


def _least_squares(table: np.ndarray, left: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of ``left`` ``(n,)`` by the columns of ``table`` ``(n, p)``, with information ``prior`` ``(p,)``
    beforehand, and standard deviations ``(p,)``; what the rows do not tell is 0."""
    inverse = _covariance(table, prior)
    return np.asarray(inverse @ (table.T @ left)), np.asarray(np.sqrt(np.maximum(np.diag(inverse), 0.0)))


def _robust_sd(table: np.ndarray, miss: np.ndarray, part: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Standard deviations ``(p,)`` of least squares with what is missed ``(n,)``, of which only ``part`` ``(n,)`` from
    part is independent: with H^-1 their covariance by noise alone and g_b = A_b^T r_b, those of

    H^-1 (sum_b g_b g_b^T + P) H^-1."""
    inverse = _covariance(table, prior)
    sums = np.stack([table[part == b].T @ miss[part == b] for b in np.unique(part)]) if len(part) else table
    middle = sums.T @ sums + np.diag(prior)
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse @ middle @ inverse), 0.0)))


def _covariance(table: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Inverse ``(p, p)`` of the information that the rows of ``table`` ``(n, p)`` and prior information ``(p,)``
    give; 0 where they give none."""
    normal = table.T @ table + np.diag(prior)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    return np.asarray(inverse / np.outer(scale, scale))
