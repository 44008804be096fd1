"""The simulator's own error in units of the noise."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from sysid.fit.directions import Direction
from sysid.fit.engine import Engine
from sysid.fit.noise import ChannelNoise
from sysid.fit.problem import Problem
from sysid.fit.runs import Measured, Run
from sysid.mismatch.locate import BLOCKS, discretisation_energy


def test_what_is_not_measured_does_not_count() -> None:
    n = 10 * BLOCKS
    t = np.linspace(0.0, 1.0, n)
    values = np.full((n, 6), np.nan)
    values[:, 1] = 0.0  # a gauge along y
    gauge = Measured("gauge", "wrench", t, values, tuple("abcdef"))
    run = Run("pull", "", (), {}, (gauge,), 1.0)
    # Nothing is known of the noise of the other components, and the simulator moves there too.
    noise = ChannelNoise(np.array([0.1, 0.1, 0.1, 1e-12, 1e-12, 1e-12]), 0.0, "test")
    direction = Direction("mesh", ({"gauge": np.full((n, 6), 0.05)},), mean=1.0)
    problem = Problem([run], {"gauge": noise}, cast(Engine, None), [direction])
    # Every block of about ten samples, each half a standard deviation off: (10 * 0.5)^2 / 10.
    assert discretisation_energy(problem) == pytest.approx(0.25 * n, rel=0.01)
