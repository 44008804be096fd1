"""Where and when a model misses recordings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.rigs.trajectory import PoseTrajectory
from sysid.diagnosis.residual_analysis import _phase, excess, locate
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


@pytest.mark.parametrize(
    ("speed_m_s", "turn_rad_s", "touching", "words"),
    [
        (0.0, 0.0, True, "holding in contact"),
        (5e-5, 5e-4, True, "holding in contact"),
        (2e-4, 0.0, True, "moving in contact"),  # 40 um in the window
        (0.0, 5e-3, True, "moving in contact"),
        (0.0, 5e-3, False, "moving freely"),
        (0.0, 0.0, False, "at rest without contact"),
    ],
)
def test_slow_motion_and_rotation_are_motion(speed_m_s: float, turn_rad_s: float, touching: bool, words: str) -> None:
    t = np.linspace(0.0, 1.0, 11)
    positions = np.outer(t * speed_m_s, [1.0, 0.0, 0.0])
    turns = Rotation.from_rotvec(np.outer(t * turn_rad_s, [0.0, 0.0, 1.0])).as_quat()
    run = Run("slow", "", (), {"hand": PoseTrajectory.from_samples(t, positions, turns)}, (), 1.0)
    reports = [SimpleNamespace(contacts=int(touching))] * 10
    fitted = SimpleNamespace(predictions=[SimpleNamespace(trace=SimpleNamespace(times=t, reports=reports))])
    assert _phase(run, cast(Any, fitted), 0, 0.4, 0.6) == words


def test_the_end_of_a_motion_in_a_hold_is_a_hold() -> None:
    t = np.array([0.0, 0.42, 0.6])
    positions = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.01, 0.0, 0.0]])
    run = Run("press", "", (), {"hand": PoseTrajectory.from_samples(t, positions, np.eye(4)[[3, 3, 3]])}, (), 1.0)
    reports = [SimpleNamespace(contacts=1)] * 2
    fitted = SimpleNamespace(predictions=[SimpleNamespace(trace=SimpleNamespace(times=t, reports=reports))])
    assert _phase(run, cast(Any, fitted), 0, 0.4, 0.6) == "holding in contact"


def test_the_excess_of_a_recording_is_that_of_its_blocks() -> None:
    """Noise has none, and an error of a third of the noise adds up over the samples of a block."""
    t = np.linspace(0.0, 24.0, 24 * 400, endpoint=False)
    noise = np.random.default_rng(0).normal(0.0, 3.0, len(t))
    prediction = Prediction({"gauge": np.zeros((len(t), 1))}, {}, cast(Any, None))
    fitted = cast(Fitted, SimpleNamespace(scaled=np.zeros(0), sizes={}, predictions=[prediction]))
    found = []
    for off in (0.0, 1.0):
        values = noise + off * np.sign(np.sin(np.pi * t / 6.0))
        run = Run("run", "", (), {}, (Measured("gauge", "markers", t, values[:, None], ("x",)),), 24.0)
        problem = Problem([run], {"gauge": ChannelNoise(np.array([3.0]), np.zeros(1), "given")}, cast(Any, None))
        found.append(excess(problem, fitted, 0))
    blocks = DIAGNOSIS.time_blocks
    assert abs(found[0]) < 4.0 * np.sqrt(2.0 * blocks)
    assert found[1] == pytest.approx(blocks * 400.0 / 9.0, rel=0.2)


def test_windows_leave_out_what_a_shifted_offset_leaves_before_a_press() -> None:
    """A press that misses by a half sine; the fit has shifted the offset so that the mean of the misfit is zero."""
    t = np.linspace(0.0, 24.0, 24 * 50, endpoint=False)
    gauge = Measured("gauge", "markers", t, np.zeros((len(t), 1)), ("x",))
    run = Run("run", "", (), {}, (gauge,), 24.0)
    problem = Problem([run], {"gauge": ChannelNoise(np.array([1.0]), np.zeros(1), "given")}, cast(Any, None), [])
    trace = SimpleNamespace(times=t, reports=[SimpleNamespace(contacts=int(8.0 < x < 16.0)) for x in t[1:]])

    def model(values: np.ndarray) -> Any:
        return SimpleNamespace(predictions=[Prediction({"gauge": values[:, None]}, {}, cast(Any, trace))])

    press = 50.0 * np.sin(np.clip((t - 8.0) / 8.0, 0.0, 1.0) * np.pi)
    found = locate(problem, model(0.0 * t), model(press - press.mean()))
    (window,) = found.windows["run"]
    assert 9.0 <= window[0] <= 10.0 and 14.0 <= window[1] <= 15.0
    assert found.phase == "holding in contact"
    # A second press of half the size is shown as well.
    found = locate(problem, model(0.0 * t), model(press + 0.5 * np.roll(press, 9 * 50)))
    assert len(found.windows["run"]) == 2
