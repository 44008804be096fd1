"""Steps of the solver are short where readings bend, by the closed form of the error of linear interpolation."""

from __future__ import annotations

from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sysid.discretisation.time_steps import followed, with_steps
from sysid.model.predictor import Prediction
from sysid.model.time_span import rollout_times
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.discretisation import DISCRETISATION

DT_S, END_S, BENDS_S = 0.1, 2.0, 0.8
SIGMA_M = 1e-4
NOISE = {"gauge": ChannelNoise(np.full(3, SIGMA_M), np.zeros(3), "given")}


def course(t: np.ndarray, strength: float) -> np.ndarray:
    """A reading ``(n, 1, 3)`` that is linear until :data:`BENDS_S`, then bends with a second derivative."""
    late = np.maximum(0.0, t - BENDS_S)
    return np.repeat((t + 0.5 * strength * late**2)[:, None, None], 3, axis=2)


class Bending:
    """Simulates a rig whose gauge takes that course; in between, readings are interpolated."""

    def __init__(self, strength: float) -> None:
        self.strength, self.made = strength, 0

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        self.made += 1
        times = rollout_times([rig], run, dt or rig.solver.dt_s)
        values = course(times, self.strength)
        t = run.measured[0].t
        seen = np.stack([np.interp(t, times, values[:, 0, k]) for k in range(3)], axis=1)
        trace = cast(Any, SimpleNamespace(times=times, outputs={"gauge": values}))
        future: Future[Prediction] = Future()
        future.set_result(Prediction({"gauge": seen}, {}, trace))
        return future


def recording(values: np.ndarray | None = None) -> Run:
    t = np.linspace(0.0, END_S, 401)
    rows = np.zeros((len(t), 3)) if values is None else values
    return Run("run", "run", (), {}, (Measured("gauge", "markers", t, rows, ("x", "y", "z")),), END_S)


def rig(inertia: bool = False) -> Any:
    return SimpleNamespace(
        solver=SimpleNamespace(dt_s=DT_S, inertia=inertia), end_effectors={}, sensors={}, cameras={}, effects={}
    )


@pytest.fixture(autouse=True)
def no_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid.model.time_span.total_delay", lambda *given: 0.0)


@pytest.mark.parametrize("strength", [0.0, 0.2, 2.0])
def test_steps_are_halved_until_interpolation_errs_by_less_than_a_third_of_the_noise(strength: float) -> None:
    """The error in the middle of a step h is h^2 |y''| / 8."""
    (run,) = with_steps(cast(Any, Bending(strength)), [rig()], [recording()], NOISE)
    assert run.steps is not None
    lengths = np.diff(run.steps)
    assert np.allclose(lengths[run.steps[1:] <= BENDS_S + 1e-9], DT_S)
    count = next(
        n for n in range(5) if (DT_S / 2**n) ** 2 * strength / 8.0 <= DISCRETISATION.interpolation_over_noise * SIGMA_M
    )
    assert np.allclose(lengths[run.steps[:-1] >= BENDS_S - 1e-9], DT_S / 2**count)


class Vibrating(Bending):
    """Simulates a rig whose gauge vibrates, slower by (omega h)^2 / 3 of the frequency as BDF2 has it, over a share of
    the time of the recording."""

    OMEGA_PER_S = 5.0

    def __init__(self, strength: float, share: float) -> None:
        super().__init__(strength)
        self.share = share

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        self.made += 1
        h = float(np.diff(rollout_times([rig], run, dt or rig.solver.dt_s)).max())
        omega = self.OMEGA_PER_S * (1.0 - (self.OMEGA_PER_S * h) ** 2 / 3.0)
        t = run.measured[0].t
        values = np.where(t <= self.share * END_S, self.strength * np.sin(omega * t), 0.0)
        future: Future[Prediction] = Future()
        future.set_result(Prediction({"gauge": np.repeat(values[:, None], 3, axis=1)}, {}, cast(Any, None)))
        return future


@pytest.mark.parametrize(
    ("strength", "share", "halvings"),
    [(0.4 * SIGMA_M, 1.0, 0), (4.0 * SIGMA_M, 1.0, 1), (1000.0 * SIGMA_M, 0.2, 0)],
    ids=["within the noise", "near a resonance", "an impact"],
)
def test_with_inertia_all_steps_are_halved_where_that_changes_much_for_long(
    strength: float, share: float, halvings: int
) -> None:
    """Over two seconds the phase errs by 10 (0.5)^2 / 3 = 0.83 with the steps of the rig, by a quarter of that with
    half of them: at four times the noise, halving changes readings by up to 2.5 times the noise."""
    given = recording()
    (run,) = with_steps(cast(Any, Vibrating(strength, share)), [rig(inertia=True)], [given], NOISE)
    if halvings == 0:
        assert run is given
    else:
        assert run.steps is not None
        assert np.allclose(np.diff(run.steps), DT_S / 2**halvings)


def test_half_the_step_halves_steps_of_a_run_too() -> None:
    (run,) = with_steps(cast(Any, Bending(2.0)), [rig()], [recording()], NOISE)
    assert run.steps is not None
    halves = rollout_times([rig()], run, 0.5 * DT_S)
    assert np.allclose(halves[::2], run.steps)
    assert np.allclose(halves[1::2], 0.5 * (run.steps[1:] + run.steps[:-1]))


@pytest.mark.parametrize("with_long_steps", [True, False])
def test_a_recording_that_was_simulated_with_the_steps_of_the_rig_keeps_them(with_long_steps: bool) -> None:
    engine = cast(Any, Bending(20.0))
    noise = SIGMA_M * np.random.default_rng(0).standard_normal((401, 3))
    plain = engine.submit(rig(), recording()).result()
    exact = course(recording().measured[0].t, 20.0)[:, 0]
    given = recording((plain.values["gauge"] if with_long_steps else exact) + noise)
    shorter = with_steps(engine, [rig()], [given], NOISE)
    there = engine.submit(rig(), shorter[0]).result()
    (run,), (prediction,) = followed([given], [plain], shorter, [there], NOISE)
    assert (run.steps is None) == with_long_steps
    assert prediction is (plain if with_long_steps else there)
