"""Every effect is found again from its own recording: from other values its parameters come back to the true ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from effect_examples import TYPICAL
from scipy.optimize import least_squares

from sim_core.effects import all_effects
from sim_core.rigs import Rig
from sysid.model.load import Measured, Run
from sysid.model.parameters import fit_parameters, rig_at, start_of
from sysid.model.predictor import SerialPredictor
from sysid.noise.estimate import declared_noise

TIMES = [0.0, 0.06, 0.12, 0.2, 0.3, 0.36, 0.5]
WAY = [
    [0, 0, 1e-3], [0, 0, -0.006], [0.004, 0.001, -0.007], [0.004, 0.001, -0.007], [0.001, 0, -0.006], [0, 0, 0],
    [0, 0, 1e-3],
]  # fmt: skip
"""Begun so high that a tool that is askew does not touch."""

ONTO_THE_POST = [[0.05, 0, z] for z in (0, -1e-3, -1.2e-3, -1.2e-3, 0, 0, 0)]
WAYS = {"contact_bonding": ONTO_THE_POST}
"""It acts on contacts with rigid bodies."""

STAMPS = np.linspace(0.013, 0.487, 41)

TRUE = {
    **TYPICAL,
    "air_drag": {"drag_coefficient": 15.0},  # the card is slow in this motion
    "contact_adhesion": {"work_j_m2": 0.02, "range_m": 4e-4},  # weak, so that nothing snaps into contact
    "contact_bonding": {"work_j_m2": 0.02, "range_m": 4e-4},  # nor out of it
}


def recorded(rig: Rig, poses: Any) -> Run:
    """A run with readings of all channels, as the rig itself predicts them."""
    kinds = {"wrench": ("wrench", 6), "markers": ("markers", 27), "side": ("tracks", 20)}
    blank = tuple(
        Measured(channel, kind, STAMPS, np.zeros((len(STAMPS), m)), tuple(str(k) for k in range(m)))
        for channel, (kind, m) in kinds.items()
    )
    run = Run("own", "own", (), poses, blank, float(TIMES[-1]))
    values = SerialPredictor().predict(rig, run).values
    full = tuple(Measured(m.channel, m.kind, m.t, values[m.channel], m.labels) for m in blank)
    return Run("own", "own", (), poses, full, run.end)


@pytest.mark.slow
@pytest.mark.parametrize("name", all_effects())
def test_comes_back_from_its_own_recording(name: str, small_rig: Callable[..., Rig], visit: Callable[..., Any]) -> None:
    """By least squares with the derivatives that fits use, from values a fifth off, of parameters that the noise that
    the rig declares would not hide."""
    true = small_rig(effects={name: TRUE[name]})
    parameters = fit_parameters(true, [f"effects.{name}.{p}" for p in TRUE[name]])
    poses = visit(TIMES, WAYS.get(name, WAY))
    run, engine, truth = recorded(true, poses), SerialPredictor(), start_of(true, parameters)
    sigma = {m.channel: np.ravel(declared_noise(true, m.channel)) for m in run.measured}

    def weighed(scaled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = engine.predict_with_derivatives(rig_at(true, parameters, scaled), run, parameters, scaled)
        rows, slopes = [], []
        for m in run.measured:
            width = np.resize(sigma[m.channel], m.values.shape[1])
            rows.append(np.nan_to_num((found.values[m.channel] - m.values) / width).ravel())
            slopes.append(np.nan_to_num(found.derivatives[m.channel] / width[None, :, None]).reshape(-1, len(scaled)))
        return np.concatenate(rows), np.vstack(slopes)

    _, at_truth = weighed(truth)
    informed = np.linalg.norm(at_truth, axis=0) * np.maximum(np.abs(truth), 0.1) > 1.0
    assert informed.any(), "the recording says nothing of the effect"
    parameters = [p for p, known in zip(parameters, informed, strict=True) if known]
    low, high = np.array([p.scaled_bounds for p in parameters]).T
    start = np.clip(
        truth[informed] + 0.2 * np.where(np.abs(truth[informed]) < 1.0, truth[informed], 1.0), low + 1e-9, high - 1e-9
    )
    found = least_squares(
        lambda s: weighed(s)[0], start, lambda s: weighed(s)[1], bounds=(low, high), x_scale="jac", xtol=1e-10
    )
    assert found.cost < 1e-3 * len(found.fun), found
    assert found.x == pytest.approx(truth[informed], rel=2e-3, abs=2e-3 * float(np.abs(truth[informed]).max()))
