"""Simulate with known values, record, fit from several starts: the truth comes back with its interval."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recordings_of_the_small_rig import MOTION, STARTS, TRUTH

from sim_core.errors import ConfigError, RecordingError
from sim_core.rigs import config_folder, load_rig, with_parameters
from sim_core.rigs.motion import Experiment
from sysid.fit import FitOptions, fit_runs
from sysid.model.load import load_run, load_runs
from sysid.model.parameters import fit_parameters
from sysid.model.predictor import SerialPredictor
from sysid.simulate import simulate_to_bag

PLACED = FitOptions(nuisance=("time", "bias", "camera"))
"""Poses are exact here; tests of offsets against them are in test_fit_pose_offset.py."""

DECLARED = {"wrench force": 1e-3, "wrench torque": 1e-5, "markers ": 5e-6, "side ": 0.1}
"""Noise that the small rig declares."""


def record(rig, folder, refine):
    experiment = Experiment.model_validate({"name": "visit", "seed": 4, "motions": {"finger": MOTION}})
    simulate_to_bag(with_parameters(rig, TRUTH), experiment, folder / "bag", seed=4, refine=refine)
    return rig, load_run(rig, folder / "bag"), folder / "bag"


@pytest.fixture(scope="module")
def recorded(small_rig, tmp_path_factory):
    """Made by the very simulator that is fitted."""
    return record(small_rig(), tmp_path_factory.mktemp("visit"), 1)


@pytest.fixture(scope="module")
def recorded_finer(small_rig, tmp_path_factory):
    """Made on a finer mesh with a shorter step, as reality is finer than any mesh."""
    return record(small_rig(), tmp_path_factory.mktemp("visit"), 2)


@pytest.mark.parametrize("start", [STARTS[2], *(pytest.param(s, marks=pytest.mark.slow) for s in STARTS[:2])])
def test_truth_comes_back_within_a_narrow_interval(recorded, start):
    rig, run, _ = recorded
    result, fitted = fit_runs(with_parameters(rig, start), [run], list(start), PLACED)
    assert result.converged
    assert {e.channel + " " + e.quantity: e.declared for e in result.errors} == pytest.approx(DECLARED)
    assert result.reduced_chi2 < 1.1
    for estimate in result.estimates:
        low, high = estimate.ci95
        assert low <= TRUTH[estimate.name] <= high, estimate
        assert high - low < 0.2 * TRUTH[estimate.name], estimate
    assert fitted.bodies["gel"].material.E_pa == pytest.approx(TRUTH["gel.E_pa"], rel=0.05)


@pytest.mark.slow
def test_truth_comes_back_from_a_finer_simulation(recorded_finer):
    """The coarse mesh is off by far more than the noise, and the intervals know it."""
    rig, run, _ = recorded_finer
    result, _ = fit_runs(with_parameters(rig, STARTS[0]), [run], list(TRUTH), PLACED)
    for estimate in result.estimates:
        low, high = estimate.ci95
        assert low <= TRUTH[estimate.name] <= high, estimate


@pytest.mark.slow
def test_what_the_data_cannot_tell_is_said(recorded):
    """The camera sees the card only, which the gel's stiffness does not reach."""
    rig, _, bag = recorded
    (run,), _ = load_runs(rig, [Path(f"{bag}@0:0.9")])
    seen_only = type(run)(**{**run.__dict__, "measured": tuple(m for m in run.measured if m.kind == "tracks")})
    result, _ = fit_runs(rig, [seen_only], ["gel.E", "gel.nu"], PLACED)
    assert any("do not determine" in s for s in result.identifiability)
    assert any("gel." in s for s in result.identifiability)
    assert max(np.log(e.ci95[1] / e.ci95[0]) for e in result.estimates if e.log) > 0.5


def test_parameters_are_checked(small_rig):
    with pytest.raises(ConfigError, match="twice"):
        fit_parameters(small_rig(), ["card.E", "card.E_pa"])
    with pytest.raises(ConfigError, match=r"no parameter 'card\.Epa'"):
        fit_parameters(small_rig(), ["card.Epa"])


def test_a_bag_without_poses_is_refused(recorded):
    rig, _, bag = recorded
    other = rig.model_copy(update={"end_effectors": {"hand": rig.end_effectors["finger"].model_copy(
        update={"topics": rig.end_effectors["finger"].topics.model_copy(
            update={"target_pose": "hand/target", "current_pose": "hand/current"})})}})  # fmt: skip
    with pytest.raises(RecordingError, match="pose"):
        load_run(other, bag)


def test_the_recording_that_comes_with_the_package_is_of_this_simulator():
    """What the rig predicts of it leaves the noise that it was made with."""
    rig = load_rig("card_press")
    run = load_run(rig, config_folder().parent / "bags" / "press_post")
    predicted = SerialPredictor().predict(rig, run).values
    left = {m.channel: m.values - predicted[m.channel] for m in run.measured}
    assert np.std(left["wrench_gel"][:, :3]) == pytest.approx(rig.sensors["wrench_gel"].noise.force_n, rel=0.1)
    assert np.std(left["gel_markers"]) == pytest.approx(rig.sensors["gel_markers"].noise.position_m, rel=0.1)
    assert np.nanstd(left["outside"]) == pytest.approx(rig.cameras["outside"].noise.position_px, rel=0.1)
