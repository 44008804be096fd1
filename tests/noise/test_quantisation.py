"""The steps in which sensors read, and the noise that they stand for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sim_core.rigs.trajectory import PoseTrajectory
from sysid.noise.estimate import estimate_noise
from sysid.noise.quantisation import common_step, step_of
from sysid.observations.observations import Measured, Run

RATE, STEP = 100.0, 0.1
T = np.arange(301) / RATE


def rounded(values: np.ndarray, step: float = STEP) -> np.ndarray:
    return np.asarray(step * np.round(values / step))


def press(range_n: float, rest_s: float = 1.0) -> np.ndarray:
    """Three forces [N] of a press after a rest ``(301, 3)``."""
    depth = np.clip(T - rest_s, 0.0, None) / (T[-1] - rest_s)
    return range_n * depth[:, None] ** 2 * np.array([0.3, -0.6, 1.0])


def run_of(force: np.ndarray) -> Run:
    """At rest for 1 s; torques are not measured."""
    x = 0.02 * np.clip(T - 1.0, 0.0, None)
    poses = PoseTrajectory(T, np.column_stack([x, 0 * x, 0 * x]), np.tile([0.0, 0.0, 0.0, 1.0], (len(T), 1)))
    values = np.column_stack([force, np.full(force.shape, np.nan)])
    return Run("run", "", (), {"hand": poses}, (Measured("gauge", "wrench", T, values, tuple("abcdef")),), float(T[-1]))


@pytest.mark.parametrize("tare", [(0.0, 0.0, 0.0), (0.0, 0.037, 0.061), (0.0, 0.1, 0.3)])
@pytest.mark.parametrize("range_n", [2.0, 20.0])
def test_a_sensor_that_is_constant_at_rest_has_the_noise_of_its_rounding(
    tare: tuple[float, ...], range_n: float
) -> None:
    """Whatever it was tared by, a tenth of a newton that is not stored exactly included."""
    noise = estimate_noise([run_of(rounded(press(range_n)) + tare)], "gauge")
    np.testing.assert_allclose(noise.sigma[:3], STEP / np.sqrt(12.0), rtol=1e-6)


def test_a_wide_range_does_not_hide_the_step() -> None:
    """In 3 s without a rest more than a fifth of the readings are distinct."""
    force = rounded(press(20.0, rest_s=0.0))
    assert len(np.unique(force)) > 0.2 * force.size
    noise = estimate_noise([run_of(force)], "gauge")
    assert np.all(noise.sigma[:3] >= STEP / np.sqrt(12.0) - 1e-9)


@pytest.mark.parametrize("stored", [np.float32, np.float64])
@pytest.mark.parametrize("range_n", [1.0, 2.0, 20.0])
def test_a_step_is_found_however_it_is_stored(stored: type, range_n: float) -> None:
    for tare in (0.0, 0.037, 1.0, 17.3):
        for column in (rounded(press(range_n)) + tare).T:
            assert step_of(column.astype(stored).astype(float)) == pytest.approx(STEP, rel=1e-4)


def test_round_off_does_not_add_up_over_a_thousand_steps() -> None:
    """In single precision two neighbours of 200 N, 0.1 N apart, are that to 2e-4 only."""
    t = np.linspace(0.0, 1.0, 3000)
    force = (rounded(150.0 * t**2) + 73.037).astype(np.float32).astype(float)
    assert step_of(force) == pytest.approx(STEP, rel=1e-5)


@pytest.mark.parametrize("stored", [np.float32, np.float64])
@pytest.mark.parametrize("level", [0.0, 5.0, 640.0])
def test_a_sensor_without_steps_has_none(stored: type, level: float) -> None:
    rng = np.random.default_rng(1)
    for n in (5, 20, 300, 3000):
        values = level + rng.standard_normal((n, 20))
        assert common_step(values.astype(stored).astype(float).T) == 0.0


def test_noise_of_a_sensor_without_steps_is_not_inflated() -> None:
    rng = np.random.default_rng(2)
    found = [
        estimate_noise([run_of((press(2.0) + 0.01 * rng.standard_normal((301, 3))).astype(np.float32))], "gauge")
        for _ in range(20)
    ]
    assert np.mean([n.sigma[0] for n in found]) == pytest.approx(0.01, rel=0.03)


@pytest.mark.parametrize("px", [0.02, 0.1, 1.0])
def test_markers_that_are_read_to_a_sixteenth_of_a_pixel(px: float) -> None:
    """With noise of a third of the step to sixteen times as much."""
    rng = np.random.default_rng(3)
    moved = 640.0 + 100.0 * np.sin(2.0 * T)[:, None] + px * rng.standard_normal((301, 8))
    assert common_step(rounded(moved, 1.0 / 16.0).T) == pytest.approx(1.0 / 16.0, rel=1e-9)
    assert common_step(moved.T) == 0.0


def test_single_values_off_the_steps_do_not_hide_them() -> None:
    """Every thirtieth reading is interpolated."""
    values = rounded(press(3.0))[:, 2]
    values[5::30] += np.random.default_rng(5).uniform(0.0, STEP, len(values[5::30]))
    values[100] = np.nan
    assert step_of(values) == pytest.approx(STEP, rel=1e-9)


@pytest.mark.parametrize(
    "values", [np.full(300, 0.3), np.full(300, np.nan), np.zeros(0), np.repeat([0.0, 5.0, 0.0], [150, 1, 150])],
    ids=["constant", "not measured", "no readings", "a spike"],
)  # fmt: skip
def test_what_does_not_change_tells_nothing(values: np.ndarray) -> None:
    assert step_of(values) is None
    assert common_step([values]) == 0.0
    assert common_step([values, rounded(press(2.0))[:, 2]]) == pytest.approx(STEP, rel=1e-9)


@pytest.mark.parametrize(
    "curve",
    [
        lambda t: np.clip(t - 1.0, 0.0, 1.0),
        lambda t: 0.2 - np.abs(0.2 - 0.2 * np.clip(t - 1.0, 0.0, 2.0)),
        lambda t: np.sin(2.0 * np.pi * t),
        lambda t: np.clip(np.sin(3.0 * t), 0.0, 1.0),
    ],
    ids=["to a hold", "to and fro", "sine", "touching"],
)
def test_motions_without_noise_are_no_steps(curve: Callable[[np.ndarray], np.ndarray]) -> None:
    """Not even where every reading is a multiple of what is done in one sample, and is read twice."""
    assert step_of(curve(T)) == 0.0


@pytest.mark.parametrize(
    ("others", "expected"), [(0, STEP), (1, STEP), (2, 0.0)], ids=["no recording", "one in three", "two in three"]
)
def test_most_recordings_decide(others: int, expected: float) -> None:
    """Smoothed ones have no steps; one that stands still says nothing."""
    rng = np.random.default_rng(4)
    runs = [run_of(rounded(press(2.0))) for _ in range(3 - others)]
    runs += [run_of(press(2.0) + 1e-4 * rng.standard_normal((301, 3))) for _ in range(others)]
    runs.append(run_of(0.0 * press(2.0)))
    floor = estimate_noise(runs, "gauge").sigma[0]
    assert (floor == pytest.approx(STEP / np.sqrt(12.0))) == (expected > 0.0)
