"""Streams that lead the poses: simulated as far as they show, compared as far as poses tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from sim_core.gradients import Direction
from sim_core.rigs import Rig, with_parameters
from sim_core.rigs.motion import Experiment
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.simulate import Trace
from sysid.fit import FitOptions, fit_runs
from sysid.model.load import load_runs
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import Prediction, SerialPredictor
from sysid.model.sensor_streams import stream_derivatives
from sysid.model.time_span import after_known_motion, known_until, rollout_times
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.simulate import simulate_to_bag
from sysid.solve.residuals import Problem

LEAD_S = 0.06
CHANNELS = ("wrench", "markers", "side")
LATE = {f"{channel}.latency_s": -LEAD_S for channel in CHANNELS}
TRUTH = {"card.E_pa": 2.6e9, **LATE}
IN_MOTION_S = 0.55
"""The finger leaves the card then, at 0.1 m/s."""


@pytest.fixture(scope="module")
def session(small_rig: Callable[..., Rig], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A press, with all streams 60 ms ahead of the poses."""
    bag = tmp_path_factory.mktemp("lead") / "session"
    poses = [{"position_m": [0.0, 0.0, -0.014]}, {"position_m": [0.0, 0.0, 0.0]}]
    motion = [
        {"type": "wait", "duration_s": 0.1},
        {"type": "waypoints", "speed_m_s": 0.1, "hold_s": 0.1, "poses": poses},
        {"type": "wait", "duration_s": 0.8},
    ]
    experiment = Experiment.model_validate({"name": "lead", "motions": {"finger": motion}})
    simulate_to_bag(with_parameters(small_rig(), TRUTH), experiment, bag, seed=4)
    return bag


@pytest.mark.slow
def test_a_window_that_ends_in_motion_tells_what_the_whole_recording_does(
    small_rig: Callable[..., Rig], session: Path
) -> None:
    """Fits from latencies of 0 find modulus and latencies of either, within what each says it knows."""
    rig = small_rig()
    options = FitOptions(nuisance=("none",), intervals="quadratic", robust=False)
    found = []
    for name in (session, Path(f"{session}@0:{IN_MOTION_S}")):
        (run,), _ = load_runs(rig, [name])
        result = fit_runs(rig, [run], list(TRUTH), options, engine=SerialPredictor())[0]
        assert result.converged, result.message
        assert result.reduced_chi2 < 1.3
        found.append({e.name: e for e in result.estimates})
    assert any(end > IN_MOTION_S for end in run.poses["finger"].times)
    for name, truth in TRUTH.items():
        whole, part = (f[name] for f in found)
        exact = np.log(truth) if whole.log else truth
        values = [np.log(e.value) if e.log else e.value for e in (whole, part)]
        for value, e in zip(values, (whole, part), strict=True):
            assert value == pytest.approx(exact, abs=3.0 * e.sd), name
    for channel in CHANNELS:
        assert found[1][f"{channel}.latency_s"].value == pytest.approx(-LEAD_S, abs=2e-3)


def test_readings_of_a_window_are_those_of_the_whole_recording(small_rig: Callable[..., Rig], session: Path) -> None:
    """With their derivatives, to its end, where the hand moves; and the steps until then stay where they are."""
    rig = with_parameters(small_rig(), TRUTH)
    (whole, part), _ = load_runs(rig, [session, Path(f"{session}@0:{IN_MOTION_S}")])
    parameters = fit_parameters(rig, list(TRUTH))
    at = start_of(rig, parameters)
    there, here = (SerialPredictor().predict_with_derivatives(rig, run, parameters, at) for run in (whole, part))
    for m in part.measured:
        n = len(m.t)
        scale = np.abs(there.values[m.channel]).max(axis=0)
        np.testing.assert_allclose(here.values[m.channel], there.values[m.channel][:n], atol=1e-3 * scale.max())
        slopes = [p.derivatives[m.channel][n - 3 : n] for p in (there, here)]
        assert np.abs(slopes[1][:, :, 1:]).max() > 0.0
        np.testing.assert_allclose(slopes[1], slopes[0], atol=0.02 * np.abs(slopes[0]).max())


def run_until(end: float, last_pose: float, moving: bool) -> Run:
    """A gauge read each 0.01 s until ``end``, and a hand that moves along x, or has stopped 0.5 s before."""
    t = np.linspace(0.0, last_pose, round(100 * last_pose) + 1)
    x = 0.1 * (t if moving else np.minimum(t, last_pose - 0.5))
    poses = PoseTrajectory(t, np.column_stack([x, 0.0 * x, 0.0 * x]), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    times = np.linspace(0.0, end, round(100 * end) + 1)
    measured = (Measured("wrench", "wrench", times, np.zeros((len(times), 6)), ()),)
    return Run("run", "", (), {"finger": poses}, measured, end)


@pytest.mark.parametrize(
    ("end", "last_pose", "moving", "known", "dropped"),
    [
        (2.0, 3.0, True, 3.0, 0),  # a window: poses go on
        (2.0, 2.0, True, 2.0, 6),  # the end of a recording, in motion: 1.95 s shows 2.01 s
        (2.0, 2.0, False, 3.0, 0),  # and at rest, which lasts for max_gap_s = 1 s
        (2.0, 1.99, True, 2.0, 6),  # what is read after the last pose was compared before
    ],
)
def test_until_when_the_motion_is_known(
    small_rig: Callable[..., Rig], end: float, last_pose: float, moving: bool, known: float, dropped: int
) -> None:
    rig = with_parameters(small_rig(), {"wrench.latency_s": -LEAD_S})
    run = run_until(end, last_pose, moving)
    assert known_until(rig, run) == pytest.approx(known)
    assert after_known_motion(rig, run, run.measured[0]).sum() == dropped
    times = rollout_times([rig], run, 0.02)
    assert times[100] == end and np.diff(times) == pytest.approx(0.02)
    assert min(known, end + LEAD_S) <= times[-1] + 1e-9 < min(known, end + LEAD_S) + 0.02
    np.testing.assert_array_equal(rollout_times([small_rig()], run, 0.02), times[:101])


def test_what_is_too_late_has_no_say_in_a_bias(small_rig: Callable[..., Rig]) -> None:
    """A bias of 3 N in readings of noise 1 mN is found to that noise, although 6 of 201 are not compared."""
    rig = with_parameters(small_rig(), {"wrench.latency_s": -LEAD_S})
    run = run_until(2.0, 2.0, True)
    off = replace(run.measured[0], values=np.full_like(run.measured[0].values, np.nan))
    off.values[:, 2] = 3.0
    run = replace(run, measured=(off,))

    values = np.where(after_known_motion(rig, run, off)[:, None], np.nan, np.zeros((201, 6)))
    prediction = Prediction({"wrench": values}, {}, cast(Trace, None))
    problem = Problem([run], {"wrench": ChannelNoise(np.full(6, 1e-3), 0.0, "test")}, SerialPredictor(), bias=True)
    fitted = problem.compare([prediction], rig, [], np.zeros(0))
    assert problem.bias_of(fitted, 0, off)[2] == pytest.approx(3.0, abs=1e-6)
    assert np.abs(fitted.residual).max() < 1.0


def test_latency_at_the_edge_of_sight_is_differentiated_on_the_side_in_sight(small_rig: Callable[..., Rig]) -> None:
    """A point comes into sight at 1 s and moves at 4 px/s: its reading then falls by 4 px for each second of delay."""
    rig = small_rig()
    u = np.array([np.nan, 0.0, 4.0, 8.0])
    trace = Trace(np.arange(4.0), {"side": u[:, None, None]}, {"side": "tracks"}, {}, ())
    low, high = (with_parameters(rig, {"side.latency_s": late}) for late in (-1e-5, 1e-5))
    stamps = np.array([1.0, 1.5])
    here = np.array([[[0.0]], [[2.0]]])
    slope = stream_derivatives(trace, [Direction("late", low, high, 2e-5)], "side", stamps, here=here)
    np.testing.assert_allclose(slope.ravel(), [-4.0, -4.0], rtol=1e-9)


def test_a_simulated_stream_that_leads_shows_what_follows(small_rig: Callable[..., Rig], tmp_path: Path) -> None:
    """Readings of a motion that ends in the air, 60 ms ahead: as those that are read 60 ms later, hands held."""
    rig = small_rig()
    lift = {"type": "slide", "by_m": [0.0, 0.0, 0.02], "speed_m_s": 0.4}
    runs = []
    for name, late, hold in (("ahead", -LEAD_S, 0.0), ("later", 0.0, LEAD_S)):
        motion = [lift, *([{"type": "wait", "duration_s": hold}] if hold else [])]
        experiment = Experiment.model_validate({"name": name, "motions": {"finger": motion}})
        source = with_parameters(rig, {"wrench.latency_s": late})
        simulate_to_bag(source, experiment, tmp_path / name, noise=lambda c, k, t, clean: np.zeros(clean.shape))
        (run,), _ = load_runs(rig, [tmp_path / name])
        runs.append(next(m for m in run.measured if m.channel == "wrench"))
    shift = round(LEAD_S * rig.sensors["wrench"].rate_hz)
    ahead, later = runs
    assert len(later.t) == len(ahead.t) + shift
    np.testing.assert_allclose(ahead.values, later.values[shift:], atol=1e-9)
    assert np.ptp(later.values[-shift:, 2]) > 1e-4, "the gel still swings"
