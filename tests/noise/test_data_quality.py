"""Faults of recordings, and too few readings, are said before the values of a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_core.rigs import load_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.noise.data_quality import data_quality_warnings
from sysid.observations.observations import Measured, Run
from sysid.settings.noise import NOISE

RIG = load_rig("strip_coarse")
(GAUGE,) = RIG.sensors
DECLARED = 6.0
"""Noise of its forces [N]."""


def noise(samples: int, level: float = DECLARED, seed: int = 0) -> np.ndarray:
    """Forces and torques ``(n, 6)``."""
    return level * np.random.default_rng(seed).standard_normal((samples, 6)) * np.repeat([1.0, 0.005], 3)


def recording(values: np.ndarray, *faults: str, moves_m: float = 0.01, name: str = "press") -> Run:
    """Readings of the gauge while the gripper goes so far."""
    t = 0.02 * np.arange(len(values))
    x = moves_m * np.clip((t - t[len(t) // 3]) / max(t[-1], 1e-9), 0.0, 1.0)
    poses = PoseTrajectory(t, np.column_stack([x, 0 * x, 0 * x]), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    gauge = Measured(GAUGE, "wrench", t, values, tuple("abcdef"))
    return Run(name, name, (), {"gripper": poses}, (gauge,), float(t[-1]), doubts=faults)


def run_of(instants: int, *faults: str) -> Run:
    """A recording with so many instants with readings, and one more without any."""
    return recording(np.vstack([noise(instants), np.full((1, 6), np.nan)]), *faults)


def warnings_in(runs: list[Run]) -> list[str]:
    return data_quality_warnings(RIG, runs)


def test_a_recording_without_faults_gives_no_doubt() -> None:
    assert warnings_in([run_of(NOISE.few_instants)]) == []
    assert warnings_in([recording(noise(300))]) == [] == warnings_in([recording(noise(300), moves_m=0.0)])


@pytest.mark.parametrize("moves_m", [0.01, 0.0])
def test_readings_that_change_while_nothing_moves_are_said(moves_m: float) -> None:
    """As where the topic of the poses was not alive. Torques stay those of noise."""
    wave = 10.0 * np.sin(np.arange(300) / 30.0)[:, None] * [1.0, 0.5, 0.5, 0.0, 0.0, 0.0]
    said = warnings_in([recording(noise(300) + wave, moves_m=moves_m)])
    if moves_m:
        assert said == []
    else:
        (sentence,) = said
        assert sentence.startswith("No end effector moves in press, and yet the force of load_cell changes by more")


def test_a_sensor_that_was_not_on_is_said() -> None:
    single = np.full((300, 6), np.nan)
    single[7] = 1.0
    assert "are the same" not in " ".join(warnings_in([recording(single)]))
    (said,) = warnings_in([recording(np.zeros((300, 6)))])
    assert said == "All 300 readings of load_cell in press are the same: look whether it was on."


@pytest.mark.parametrize(("times", "apart"), [(1.5, False), (10.0, True)])
def test_recordings_with_another_noise_are_said(times: float, apart: bool) -> None:
    other = recording(noise(300, times * DECLARED, seed=1), name="rough")
    said = warnings_in([recording(noise(300)), other])
    assert bool(said) == apart
    if apart:
        assert said[0].startswith("The force of load_cell has a noise of") and "in rough and of" in said[0]
        assert len(said) == 2, "forces and torques"


@pytest.mark.parametrize(("faults", "said"), [(1, "1 fault that"), (5, "5 faults that")])
def test_faults_are_said_and_counted(faults: int, said: str) -> None:
    (sentence,) = warnings_in([run_of(NOISE.few_instants, *(f"/wrench: fault {k}" for k in range(faults)))])
    assert sentence.startswith(f"press was read with {said} may change the result: /wrench: fault 0")
    assert ("and 2 more, in the notes" in sentence) == (faults == 5)


def test_few_instants_of_all_recordings_together_are_said() -> None:
    assert "readings of 4 instants only" in warnings_in([run_of(2), replace(run_of(2), name="other")])[0]
    assert warnings_in([run_of(NOISE.few_instants // 2), run_of(NOISE.few_instants // 2)]) == []
