"""How well readings are explained by a prediction, whatever the material: a likelihood of a few instants.

Readings y ``(k, m)`` at k instants are compared with a prediction mu, of which nothing is known but its shape: its size
s is that of any plausible material, each column has a constant bias, and a model errs by shares e and f of what was
measured, smoothly and from instant to instant,

    y = s mu + b + d + n,    log s ~ N(0, w^2),    b ~ N(0, beta^2),
    d ~ GP(0, e^2 A^2 exp(-(i - j)^2 / 2 l^2)),    n ~ N(0, sigma^2 + f^2 A^2)

with A the root mean square of the readings about their means. s, e and f are the likeliest of a grid (empirical Bayes:
each hypothesis has the error that it leaves). Errors of a model are alike at neighbouring instants, so that many
readings are no more evidence than a few; the markers of one body count as their independent modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid.settings.setup_check import SETUP_CHECK

SIZES = np.exp(np.arange(-SETUP_CHECK.size_log_reach, SETUP_CHECK.size_log_reach, SETUP_CHECK.size_log_step))
"""Sizes of a prediction that are tried."""


@dataclass(frozen=True)
class Quantity:
    """Readings of one unit at a few instants.

    ``values`` ``(k, m)``: NaN where missing; ``sigma``: standard deviation of their noise; ``bias``: that of a constant
    in each column; ``log_sd``: width of the logarithm of the size of what is predicted; ``modes``: independent columns;
    ``places``: it is the change from the first instant that has a size, as of markers. ``columns``: of the channel
    ``(m,)``."""

    channel: str
    name: str
    columns: np.ndarray
    values: np.ndarray
    sigma: float
    bias: float
    log_sd: float
    modes: float
    places: bool

    @cached_property
    def signal(self) -> float:
        """Root mean square of the readings about the mean of each column, the same unit."""
        seen = self.values - np.nanmean(self.values, axis=0)
        return float(np.sqrt(np.nanmean(seen**2)))

    @property
    def weight(self) -> float:
        """Share of the columns that are independent."""
        return float(min(1.0, self.modes / self.values.shape[1]))

    @cached_property
    def _precision(self) -> tuple[np.ndarray, np.ndarray]:
        """Inverse covariances of one column ``(e, f, k, k)`` and logarithms of their determinants ``(e, f)``."""
        k = len(self.values)
        index = np.arange(k)
        length = max(SETUP_CHECK.error_length * k, 1.0)
        smooth = np.exp(-0.5 * ((index[:, None] - index) / length) ** 2)
        errors = np.square(np.array(SETUP_CHECK.model_errors) * self.signal)
        white = self.sigma**2 + errors
        covariance = (
            errors[:, None, None, None] * smooth
            + np.maximum(white, 1e-300)[None, :, None, None] * np.eye(k)
            + self.bias**2
        )
        return np.linalg.inv(covariance), np.linalg.slogdet(covariance)[1]

    def likelihood(self, predicted: np.ndarray) -> np.ndarray:
        """Log likelihoods ``(e, f, sizes)`` of predictions ``(k, m)``."""
        y, mu = self._compared(predicted)
        inverse, log_det = self._precision
        square = [np.tensordot(inverse, a @ b.T, axes=([2, 3], [0, 1])) for a, b in ((y, y), (y, mu), (mu, mu))]
        quad = square[0][..., None] - 2.0 * SIZES * square[1][..., None] + SIZES**2 * square[2][..., None]
        return np.asarray(-0.5 * self.weight * (quad + y.shape[1] * log_det[..., None]))

    def best_possible(self) -> float:
        """Log likelihood that a prediction which leaves only noise has at most, but for chance."""
        _, log_det = self._precision
        readings = self.weight * self.values.size
        return float(
            -0.5 * self.weight * self.values.shape[1] * log_det[0, 0]
            - 0.5 * readings
            + SETUP_CHECK.chance_sd * np.sqrt(0.5 * readings)
        )

    def left(self, predicted: np.ndarray, size: float) -> tuple[float, float]:
        """Sum of squares about the mean of each column, of what a prediction of a size leaves and of the readings, in
        units of the larger one of signal and noise."""
        y, mu = self._compared(predicted)
        y, mu = y - y.mean(axis=0), mu - mu.mean(axis=0)
        unit = max(self.signal, self.sigma, 1e-300) ** 2 * y.shape[1]
        return float(((y - size * mu) ** 2).sum() / unit), float((y**2).sum() / unit)

    def placed(self, predicted: np.ndarray, size: float) -> float:
        """Root mean square of the constants by which markers differ from a prediction of a size, over the size of their
        layout; 0 for what has no place."""
        if not self.places:
            return 0.0
        y, mu = self._compared(predicted)
        offset = (y - size * mu).mean(axis=0)
        return float(np.sqrt(np.mean(offset**2))) * SETUP_CHECK.layout_error / max(self.bias, 1e-300)

    def _compared(self, predicted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        y, mu = _filled(self.values), _filled(predicted)
        return (y - mu[0], mu - mu[0]) if self.places else (y, mu)


@dataclass(frozen=True)
class Evidence:
    """Log likelihood of the likeliest ``size`` of the prediction, and the relative ``error`` of the model there;
    ``left``: root mean square of what it leaves about the biases, over that of the readings; ``placed``: that of the
    constants by which markers differ from it, over the size of their layout."""

    log: float
    size: float
    error: float
    left: float
    placed: float

    def materially_better(self, other: Evidence, log_sd: float) -> bool:
        """Whether the error of the model is at most half of that of another one, or what is implausible in its size or
        in where it has the markers."""
        size, before = abs(np.log(self.size)), abs(np.log(other.size))
        return bool(
            self.error < 0.5 * other.error
            or (before > log_sd and size < 0.5 * before)
            or (other.placed > SETUP_CHECK.layout_error and self.placed < 0.5 * other.placed)
        )


def evidence(quantities: Sequence[Quantity], predicted: Sequence[np.ndarray]) -> Evidence:
    """Of quantities of one channel, which have one size in common; ``predicted`` ``(k, m)`` each, NaN where nothing is
    predicted."""
    total = -0.5 * (np.log(SIZES) / quantities[0].log_sd) ** 2
    logs = [q.likelihood(p) for q, p in zip(quantities, predicted, strict=True)]
    total = total + np.sum([log.max(axis=(0, 1)) for log in logs], axis=0)
    best = int(np.argmax(total))
    size = float(SIZES[best])
    error = max(_least_error(log[..., best]) for log in logs)
    squares = np.array([q.left(p, size) for q, p in zip(quantities, predicted, strict=True)]).sum(axis=0)
    whole = max(squares[1], 1e-300)
    left = float(np.sqrt(squares[0] / whole))
    placed = max(q.placed(p, size) for q, p in zip(quantities, predicted, strict=True))
    return Evidence(float(total[best]), size, error, left, placed)


def _least_error(log: np.ndarray) -> float:
    """The smallest error of the model that is about as likely as the likeliest; ``log`` ``(e, f)``."""
    errors = np.square(SETUP_CHECK.model_errors)
    whole = np.sqrt(errors[:, None] + errors)
    return float(whole[log >= log.max() - SETUP_CHECK.likely_nats].min())


def _filled(values: np.ndarray) -> np.ndarray:
    """Values ``(k, m)`` with those that are missing from their neighbours in time; 0 for a column without any."""
    if np.isfinite(values).all():
        return values
    out = np.array(values)
    rows = np.arange(len(values))
    for column in range(values.shape[1]):
        seen = np.isfinite(values[:, column])
        out[:, column] = np.interp(rows, rows[seen], values[seen, column]) if seen.any() else 0.0
    return out
