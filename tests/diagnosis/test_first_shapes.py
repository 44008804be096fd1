"""A body that keeps a set from one recording to the next is found by the first rest of the later ones."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.simulate import Trace
from sysid.diagnosis.first_shapes import FirstRest, first_rests, other_first_shapes
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 2.0, 101)
SIGMA = 0.1
MOVES_S = 0.5


def poses(moves_s: float) -> dict[str, PoseTrajectory]:
    """A hand that begins to move at a time [s]."""
    z = np.where(T > moves_s, 0.01 * (T - moves_s), 0.0)
    return {"hand": PoseTrajectory(T, np.column_stack([0 * T, 0 * T, z]), np.tile([0.0, 0.0, 0.0, 1.0], (len(T), 1)))}


def rests(bent_px: dict[str, float], moves_s: float = MOVES_S, error_px: float = 0.0) -> list[FirstRest]:
    """Of recordings whose markers begin so far off the model, and are anywhere once the hand moves."""
    rng = np.random.default_rng(0)
    runs, found = [], []
    for name, bent in bent_px.items():
        values = bent + SIGMA * rng.standard_normal((len(T), 8)) + np.where(T > MOVES_S, 50.0, 0.0)[:, None]
        seen = Measured("below", "tracks", T, values, tuple("abcdefgh"))
        runs.append(Run(name, "", (), poses(moves_s), (seen,), float(T[-1])))
        found.append(Prediction({"below": np.zeros((len(T), 8))}, {}, cast(Trace, None)))
    noise = {"below": ChannelNoise(np.full(8, SIGMA), np.zeros(8), "given")}
    shape = {"below": np.full((len(T), 8), error_px)}
    problem = Problem(
        runs, noise, cast(Any, None), [ErrorShape("mesh", tuple(shape for _ in runs))] if error_px else []
    )
    return first_rests(problem, problem.compare(found, cast(Any, SimpleNamespace()), [], np.zeros(0)))


def test_a_recording_that_begins_bent_is_told_beside_one_that_does_not() -> None:
    (said,) = other_first_shapes(rests({"flat": 0.0, "bent": 4.0, "more": -6.0, "by the fit": 0.9}))
    assert said.startswith("bent and more begin in another shape")
    assert "are off by 4 and 6 px, those of flat by 0.0" in said


@pytest.mark.parametrize("bent_px", [{"one": 0.0, "other": 0.3}, {"one": 4.0, "other": 4.5}, {"one": 4.0}])
def test_nothing_is_said_of_what_is_small_or_the_same_in_all(bent_px: dict[str, float]) -> None:
    found = rests(bent_px)
    assert [r.miss for r in found] == pytest.approx(list(bent_px.values()), abs=0.05)
    assert other_first_shapes(found) == ()


def test_what_mesh_and_time_step_may_be_off_is_no_other_shape() -> None:
    assert other_first_shapes(rests({"flat": 0.0, "bent": 4.0}, error_px=2.0)) == ()


def test_a_recording_that_begins_in_motion_tells_no_shape() -> None:
    assert rests({"bent": 4.0}, moves_s=-1.0) == []
