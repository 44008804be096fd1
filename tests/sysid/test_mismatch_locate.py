"""The simulator's own error in units of the noise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from sysid.fit.directions import Direction, Sizes
from sysid.fit.engine import Engine
from sysid.fit.noise import ChannelNoise
from sysid.fit.problem import Fitted, Problem
from sysid.fit.runs import Measured, Run
from sysid.mismatch.locate import BLOCKS, structure


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
    basis = problem.basis(0, gauge)
    none = Sizes(np.zeros(basis.common.shape[2]), np.zeros((6, basis.own.shape[2])))
    prediction = SimpleNamespace(values={"gauge": np.zeros((n, 6))})
    fitted = SimpleNamespace(scaled=np.zeros(0), sizes={(0, "gauge"): none}, predictions=[prediction])
    forces, torques = structure(problem, cast(Fitted, fitted)).parts
    assert forces.own == pytest.approx(0.25 * n, rel=0.01)
    assert forces.count == BLOCKS
    assert (torques.own, torques.count) == (0.0, 0)
