"""Coloured noise for the streams of a case."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from sim_core.rigs import Rig
from sysid.proof.generator.bench import Noise


@dataclass(frozen=True)
class ColouredNoise:
    """First-order autoregressive noise of each column, n_k = rho n_(k-1) + sd sqrt(1 - rho^2) e_k.

    ``levels``: by the key of the rig's noise models (``force_n``, ``torque_nm``, ``position_m``,
    ``position_px``). ``seed``: own stream for each channel.
    """

    rig: Rig
    levels: dict[str, Noise]
    seed: np.random.SeedSequence

    def __call__(self, channel: str, kind: str, stamps: np.ndarray, clean: np.ndarray) -> np.ndarray:
        names = [*self.rig.sensors, *self.rig.cameras]
        entropy = [int(v) for v in self.seed.generate_state(4)]
        rng = np.random.default_rng([*entropy, names.index(channel)])
        n = len(stamps)
        columns = clean.reshape(n, -1).shape[1]
        return self._draw(rng, n, kinds(kind, columns)).reshape(clean.shape)

    def _draw(self, rng: np.random.Generator, n: int, keys: list[str]) -> np.ndarray:
        out = np.empty((n, len(keys)))
        white = rng.standard_normal((n, len(keys)))
        for k, key in enumerate(keys):
            level = self.levels[key]
            drive = white[:, k] * np.sqrt(1.0 - level.rho**2)
            drive[0] = white[0, k]
            out[:, k] = level.sd * lfilter([1.0], [1.0, -level.rho], drive)
        return out


def kinds(kind: str, columns: int) -> list[str]:
    """Noise key of each column of a channel."""
    if kind == "wrench":
        return ["force_n"] * 3 + ["torque_nm"] * 3
    return ["position_m" if kind == "markers" else "position_px"] * columns
