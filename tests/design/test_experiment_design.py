"""What experiments can determine, computed before they are made."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.rigs import load_rig, parse_rig
from sim_core.rigs.motion import Experiment
from sysid.design.experiment_design import PREDICTED, plan_experiments
from sysid.discretisation.refinement import discretisation
from sysid.model.load import load_run
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import fit_parameters, start_of
from sysid.noise.estimate import channel_noise, undeclared
from sysid.simulate import simulate_to_bag
from sysid.solve.covariance import uncertainty
from sysid.solve.residuals import Problem

NAMES = ["card.E_pa", "gel.E_pa", "contacts.gel-post.friction"]


def experiment(poses, name="visit", hold=0.1, speed=0.05):
    motion = {"type": "waypoints", "speed_m_s": speed, "hold_s": hold, "poses": poses}
    return Experiment.model_validate(
        {"name": name, "motions": {"finger": [{"type": "wait", "duration_s": 0.4}, motion]}}
    )


PRESS = [{"position_m": [0.0, 0.0, -0.012]}, {"position_m": [0.0, 0.0, 0.0]}]
TOUCH = [{"position_m": [0.055, 0.0, 0.0]}, {"position_m": [0.055, 0.0, -0.0008]}]
RUB = [*TOUCH, {"position_m": [0.059, 0.0, -0.0008]}]


@pytest.fixture(scope="module")
def reported():
    """What the plan reports of its progress."""
    return []


@pytest.fixture(scope="module")
def plan(small_rig, reported):
    parts = [experiment(PRESS, "press"), experiment(TOUCH, "touch"), experiment(RUB, "rub")]
    return plan_experiments(small_rig(), parts, NAMES, lambda share, text: reported.append((share, text)))


def known(outlook):
    return {p.name: p for p in outlook.parameters}


@pytest.mark.slow
def test_the_expected_interval_is_that_of_a_recording(small_rig, plan, tmp_path):
    """A recording with the declared noise, its noise estimated from itself, linearised at the truth."""
    rig = small_rig()
    runs = []
    for name, poses in (("press", PRESS), ("touch", TOUCH), ("rub", RUB)):
        simulate_to_bag(rig, experiment(poses, name), tmp_path / name, seed=3)
        runs.append(load_run(rig, tmp_path / name))
    parameters = fit_parameters(rig, NAMES)
    with ParallelPredictor() as engine:
        problem = Problem(runs, channel_noise(rig, runs), engine, discretisation(engine, rig, runs))
        fitted = problem.evaluate(rig, parameters, start_of(rig, parameters))
    fitted.residual[:] = 0.0
    together = plan.outlooks[-1]
    assert together.experiments == ("press", "touch", "rub")
    np.testing.assert_allclose([p.sd for p in together.parameters], uncertainty(fitted).sd, rtol=0.25)


def test_progress_goes_on_all_the_time(plan, reported):
    """From step to step, from one of the twelve predictions to the next, and from one answer to the next."""
    shares = [share for share, _ in reported]
    steps = np.diff([0.0, *shares])
    assert -1e-12 < min(steps) and max(steps) < 0.1 and shares[-1] == 1.0
    assert [text for _, text in reported if "predictions" in text] == [
        f"{k} of 12 predictions: derivatives, error of mesh and time step" for k in range(13)
    ]
    assert "what press and touch and rub would tell" in reported[-2][1]
    shares_of_answers = [share for share, text in reported if text.endswith("would tell")]
    assert shares_of_answers[0] == pytest.approx(PREDICTED) and shares_of_answers[-1] == pytest.approx(1.0)
    assert max(np.diff(shares_of_answers)) < 0.05, (
        "putting the readings into equations is counted, not only the predictions"
    )


def test_each_experiment_tells_of_what_it_touches(plan):
    press, touch, rub, together = (known(outlook) for outlook in plan.outlooks)
    assert press["card.E_pa"].determined and not press["contacts.gel-post.friction"].determined
    assert all(press["card.E_pa"].from_channels[c] > 0.3 for c in ("wrench", "side")), "what it takes, and how it bends"
    assert touch["card.E_pa"].from_channels["side"] > 0.99  # how far it droops, seen from outside
    assert rub["contacts.gel-post.friction"].sd < 0.1 * touch["contacts.gel-post.friction"].sd
    assert all(p.determined for p in together.values())
    assert all(together[n].sd <= 1.001 * min(press[n].sd, touch[n].sd, rub[n].sd) for n in NAMES)


def test_friction_where_nothing_slides_is_said_to_be_bounded_only(plan):
    press, rub = plan.outlooks[0], plan.outlooks[2]
    assert any("contacts.gel-post.friction" in s and "at least" in s for s in press.sentences)
    assert not any("at least" in s for s in rub.sentences)


def test_a_strip_at_rest_tells_one_number():
    """Its shape depends on weight over bending stiffness, density / (E thickness^2), and nothing else."""
    rig = parse_rig(
        {
            "name": "droop",
            "solver": {"dt_s": 0.1, "inertia": False},
            "bodies": {
                "strip": {
                    "type": "sheet",
                    "shape": {"type": "rectangle", "length_m": 0.2, "width_m": 0.02, "cells": [16, 2]},
                    "material": {"E_pa": 2.0e9, "nu": 0.0, "thickness_m": 2.0e-4, "density_kg_m3": 800.0},
                }
            },
            "clamps": [{"name": "hold", "body": "strip", "region": {"x_m": [-0.1, -0.085]}, "mount": "finger"}],
            "end_effectors": {"finger": {"start": {"position_m": [-0.1, 0.0, 0.0]}}},
            "cameras": {
                "side": {
                    "model": "pinhole", "width_px": 1280, "height_px": 960, "fx_px": 1400.0, "fy_px": 1400.0,
                    "cx_px": 640.0, "cy_px": 480.0,
                    "pose": {"position_m": [0.0, -0.4, -0.05], "rpy_deg": [-90.0, 0.0, 0.0]},
                    "sees": [{"body": "strip", "points": {"grid": [9, 2]}}], "rate_hz": 10.0,
                    "noise": {"position_px": 0.1},
                }
            },
        },
        "test",
    )  # fmt: skip
    tilt = experiment([{"position_m": [0.0, 0.0, 0.0], "rpy_deg": [0.0, 30.0, 0.0]}], "tilt", hold=0.5)
    names = ["strip.E_pa", "strip.density_kg_m3", "strip.thickness_m"]
    found = plan_experiments(rig, [tilt], names).outlooks[0]
    assert not any(p.determined for p in found.parameters)
    assert {p.name for p in found.parameters} == {n for n in names if any(n in s for s in found.sentences)}
    combined = [s for s in found.sentences if "only in combination" in s]
    assert len(combined) == 2  # three numbers, one of which is known
    once, _, both = plan_experiments(rig, [tilt, tilt], names[:1]).outlooks
    assert once.parameters[0].determined and once.parameters[0].sd < 0.02
    assert both.experiments == ("tilt", "tilt (2)")


@pytest.mark.parametrize(
    ("zero", "named"),
    [
        ({"side": ["position_px"]}, "side (position_px)"),
        ({"wrench": ["torque_nm"]}, "wrench (torque_nm)"),
        ({"wrench": ["force_n", "torque_nm"], "side": ["position_px"]},
         "wrench (force_n), wrench (torque_nm), side (position_px)"),
    ],
)  # fmt: skip
def test_a_sensor_without_declared_noise_is_refused_by_name(small_rig, zero, named):
    """Before anything is simulated: this experiment cannot be."""
    data = small_rig().model_dump()
    for channel, keys in zero.items():
        (data["cameras"] if channel in data["cameras"] else data["sensors"])[channel]["noise"].update(
            dict.fromkeys(keys, 0.0)
        )
    with pytest.raises(ConfigError) as refused:
        plan_experiments(parse_rig(data, "silent"), [], NAMES)
    assert f"declares no noise for {named}," in refused.value.problem
    assert "Declare" in refused.value.remedy


def test_a_component_that_is_not_measured_needs_no_noise():
    assert load_rig("knit_acrylic_garter_x").sensors["gauge"].noise.torque_nm == 0.0
    assert undeclared(load_rig("knit_acrylic_garter_x")) == []


def run(*arguments):
    command = [sys.executable, "-m", "sysid", "plan", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def test_the_command_prints_figures():
    done = run("strip_coarse", "pull_taut", "--params", "strip.E_pa", "--json")
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert data["outlooks"][0]["parameters"][0]["determined"]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("strip_pull", "pull_strip", "--params", "strip.Y"), "strip.Y"),
        (("strip_pull", "no_such_thing", "--params", "strip.E"), "no_such_thing"),
        (("strip_pull", "press_post", "--params", "strip.E"), "finger"),
    ],
)
def test_what_cannot_be_planned_is_named(arguments, word):
    done = run(*arguments)
    assert done.returncode == 2
    assert word in done.stderr and "Traceback" not in done.stderr
