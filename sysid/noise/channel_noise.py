"""The noise of the columns of one channel: a coloured part, a white one added to it, and what markers have in
common."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sysid.noise.common_mode import CommonMode
from sysid.settings.noise import NOISE


@dataclass(frozen=True)
class ChannelNoise:
    """``sigma``: standard deviation of each column ``(m,)``; ``rho``: correlation of its coloured part over the usual
    interval of its samples, 0 to less than 1 ``(m,)``, or one for all; ``source``: how they were found, in words;
    ``estimated``: what recordings show, where a declared noise took its place ``(m,)``; ``common``: the part that all
    markers of a picture have in common, None where that is what chance makes of their own; ``white``: share of the
    variance that is white in addition to the coloured part, 0 to less than 1 ``(m,)``, or one for all."""

    sigma: np.ndarray
    rho: np.ndarray
    source: str
    estimated: np.ndarray | None = None
    common: CommonMode | None = None
    white: np.ndarray = field(default_factory=lambda: np.zeros(1))

    def __post_init__(self) -> None:
        for name in ("rho", "white"):
            given = np.asarray(getattr(self, name), dtype=float)
            object.__setattr__(self, name, np.broadcast_to(given, self.sigma.shape))

    @property
    def correlation(self) -> np.ndarray:
        """Of neighbouring samples ``(m,)``."""
        return np.asarray(self.rho * (1.0 - self.white))

    @property
    def long_run(self) -> np.ndarray:
        """Variance of the mean of many samples, over that of white noise of the same size ``(m,)``."""
        return np.asarray(self.white + (1.0 - self.white) * (1.0 + self.rho) / (1.0 - self.rho))

    @property
    def whitening_gain(self) -> np.ndarray:
        """Mean square of what whitening makes of values that are independent from sample to sample, in units of
        ``sigma`` ``(m,)``: the mean of 1 / S over all frequencies, for the spectrum S of the noise."""
        cosine = np.cos(np.pi * (np.arange(NOISE.spectrum_frequencies) + 0.5) / NOISE.spectrum_frequencies)[:, None]
        coloured = (1.0 - self.rho**2) / (1.0 - 2.0 * self.rho * cosine + self.rho**2)
        return np.asarray(np.mean(1.0 / (self.white + (1.0 - self.white) * coloured), axis=0))

    @property
    def own(self) -> ChannelNoise:
        """What each column has for itself."""
        if self.common is None:
            return self
        return ChannelNoise(self.common.sigma, self.common.rho, self.source)
