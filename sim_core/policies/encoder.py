"""What a policy sees of an observation: the few combinations of its readings that stand out of the sensors' noise.

Most of the readings of a rig's sensors tell little apart from noise, and a network that sees each of them scaled to
unit variance sees mostly noise. So readings are divided by the standard deviation of their noise, the mean of the
decision's number is taken off, and what is left is projected on its principal components over the family of materials
(PCA; Jolliffe 2002), each of unit variance. Components whose standard deviation is not :data:`CLEAR` times that of the
noise are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim_core.errors import ConfigError

CLEAR = 2.0
"""Standard deviation of a component, by that of the noise, from which on it is seen."""

MOST_COMPONENTS = 24
"""Components that are seen at most, those of the largest variance."""

EXACT = 0.01
"""Standard deviation that entries without noise count with, by their scale of one."""

MOST = 5.0
"""Bound of what is seen, in standard deviations."""


@dataclass(frozen=True)
class Encoder:
    """``centre`` ``(d + 1, m)``: the mean observation before each of ``d`` decisions and at the end; ``matrix``
    ``(m, k)``: the combinations that are seen."""

    centre: np.ndarray
    matrix: np.ndarray

    @property
    def size(self) -> int:
        """Numbers that the policy sees: the components, and how far the episode is."""
        return int(self.matrix.shape[1]) + 1

    def encode(self, observations: np.ndarray) -> np.ndarray:
        """What is seen of observations ``(n, m)``, whose last entry is the share of the decisions that are made:
        ``(n, k + 1)``."""
        done = observations[:, -1].astype(float)
        made = np.rint(done * (len(self.centre) - 1)).astype(int)
        seen = np.clip((observations - self.centre[made]) @ self.matrix, -MOST, MOST)
        return np.column_stack([seen, 2.0 * done - 1.0]).astype(np.float32)

    def write(self, path: Path) -> None:
        """Write it to a file."""
        np.savez(path, centre=self.centre, matrix=self.matrix)


def fitted(observations: np.ndarray, noise: np.ndarray) -> Encoder:
    """The encoder of observations ``(episodes, d + 1, m)`` over a family of materials, of which ``noise`` ``(m,)`` is
    the standard deviation of the noise in each entry, 0 where there is none."""
    centre = observations.mean(axis=0)
    scale = np.where(noise > 0.0, noise, EXACT)
    apart = ((observations - centre) / scale).reshape(-1, len(scale))
    _, lengths, rows = np.linalg.svd(apart, full_matrices=False)
    spread = lengths / np.sqrt(len(apart))
    count = max(1, min(MOST_COMPONENTS, int(np.count_nonzero(spread > CLEAR))))
    rows = rows[:count] * np.sign(rows[np.arange(count), np.abs(rows[:count]).argmax(axis=1)])[:, None]
    return Encoder(centre, (rows / np.maximum(spread[:count, None], 1e-12) / scale).T)


def read_encoder(path: Path) -> Encoder:
    """Of a file. Raises ``ConfigError`` where it has none."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            return Encoder(stored["centre"], stored["matrix"])
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise ConfigError(f"{path} cannot be read: {error}.", "Train anew in a new folder.") from None
