"""What can be known of a gel under a sphere and of a strip that rings, where mechanics gives the answer.

A sphere on a deep half-space tells E* = E / (1 - nu^2) and nothing else (Hertz), so the force changes with Poisson's
ratio as with 2 nu / (1 - nu^2) of the logarithm of the modulus. On a thin bonded layer the force depends on both (the
Lebedev-Ufliand equation: 3.27 instead of 2.69 times that of Hertz at nu = 0.49 and 0.4), and markers tell them apart on
either. A strip without weight rests in the same shape whatever its density, and rings at omega^2 ~ B / (rho A).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from sim_core.rigs import Rig, parse_rig
from sim_core.rigs.motion import Experiment
from sysid.model.load import load_run
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import Prediction, SerialPredictor
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Run
from sysid.simulate import simulate_to_bag
from sysid.solve.covariance import uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

NU, BALL, SIDE, GAP = 0.45, 0.04, 0.048, 1e-4
FORCE_SD = 0.02
"""About 1.5 % of the largest force."""

DEEP = (0.024, [10, 10, 5])
LAYER = (0.005, [10, 10, 2])
"""Thickness [m] and cells of a gel; the sphere touches it over a radius of 5 mm."""


def indented(thickness: float, cells: list[int]) -> Rig:
    return parse_rig(
        {
            "name": "indented",
            "gravity_m_s2": [0.0, 0.0, 0.0],
            "solver": {"dt_s": 0.1, "inertia": False},
            "bodies": {
                "gel": {
                    "type": "gel",
                    "shape": {"type": "block", "size_m": [SIDE, SIDE, thickness], "cells": cells},
                    "pose": {"position_m": [0.0, 0.0, -thickness / 2], "rpy_deg": [180.0, 0.0, 0.0]},
                    "material": {"E_pa": 2e5, "nu": NU, "density_kg_m3": 1000.0},
                    "bonded": "bottom",
                    "mount": "finger",
                },
                "ball": {
                    "type": "rigid",
                    "shape": {"type": "sphere", "radius_m": BALL},
                    "pose": {"position_m": [0.0, 0.0, -thickness - BALL - GAP]},
                },
            },
            "end_effectors": {"finger": {"start": {"position_m": [0.0, 0.0, 0.0]}}},
            "contacts": [{"between": ["gel", "ball"], "friction": 0.0}],
            "sensors": {
                "wrench": {"type": "wrench", "on": "gel", "rate_hz": 10.0, "noise": {"force_n": FORCE_SD}},
                "markers": {
                    "type": "markers", "body": "gel", "points": {"face": "top", "grid": [7, 7]}, "rate_hz": 10.0,
                    "noise": {"position_m": 1e-5},
                },
            },
        },
        "test",
    )  # fmt: skip


def pressed(thickness: float, cells: list[int], folder: Path) -> tuple[Rig, Run]:
    rig = indented(thickness, cells)
    depth = 0.005**2 / BALL * (0.9 if thickness > 0.01 else 0.56)
    motion = {"type": "slide", "by_m": [0.0, 0.0, -depth - GAP], "speed_m_s": depth / 1.5}
    press = Experiment.model_validate({"name": "press", "motions": {"finger": [motion]}})
    simulate_to_bag(rig, press, folder / "bag")
    return rig, load_run(rig, folder / "bag")


def known(rig: Rig, run: Run, names: list[str], sd: dict[str, float], predicted: list[Prediction] | None) -> Fitted:
    """A fit at the truth, with the channels of ``sd`` alone."""
    parameters = fit_parameters(rig, names)
    at = start_of(rig, parameters)
    there = replace(run, measured=tuple(m for m in run.measured if m.channel in sd))
    noise = {m.channel: ChannelNoise(np.full(m.values.shape[1], sd[m.channel]), 0.0, "test") for m in there.measured}
    problem = Problem([there], noise, cast(ParallelPredictor, SerialPredictor()))
    found = (
        problem.evaluate(rig, parameters, at) if predicted is None else problem.compare(predicted, rig, parameters, at)
    )
    found.residual[:] = 0.0
    return found


@pytest.mark.slow
def test_a_sphere_on_a_deep_gel_tells_the_plane_strain_modulus_only(tmp_path: Path) -> None:
    rig, run = pressed(*DEEP, tmp_path)
    names = ["gel.E_pa", "gel.nu"]
    both = known(rig, run, names, {"wrench": FORCE_SD, "markers": 1e-5}, None)
    force = known(rig, run, names, {"wrench": FORCE_SD}, both.predictions)
    by_modulus, by_nu = force.predictions[0].derivatives["wrench"][-1, 2]
    assert by_nu / by_modulus == pytest.approx(2.0 * NU / (1.0 - NU**2), rel=0.15)
    found = uncertainty(force)
    assert found.correlation[0, 1] < -0.999 and np.all(found.sd > 0.2)
    assert any("do not determine gel.nu" in s or "only in combination" in s for s in found.sentences)
    assert np.all(uncertainty(both).sd < 0.02)
    thin, other = pressed(*LAYER, tmp_path / "thin")
    layer = uncertainty(known(thin, other, names, {"wrench": FORCE_SD}, None))
    assert np.all(layer.sd < 0.25 * found.sd) and not any("do not determine" in s for s in layer.sentences)


def strip(inertia: bool) -> Rig:
    return parse_rig(
        {
            "name": "ringing",
            "gravity_m_s2": [0.0, 0.0, 0.0],
            "solver": {"dt_s": 0.004, "inertia": inertia},
            "bodies": {
                "strip": {
                    "type": "sheet",
                    "shape": {"type": "rectangle", "length_m": 0.12, "width_m": 0.02, "cells": [8, 1]},
                    "material": {"E_pa": 2.0e9, "nu": 0.0, "thickness_m": 2.0e-4, "density_kg_m3": 800.0},
                }
            },
            "clamps": [{"name": "hold", "body": "strip", "region": {"x_m": [-0.06, -0.045]}, "mount": "finger"}],
            "end_effectors": {"finger": {"start": {"position_m": [-0.06, 0.0, 0.0]}}},
            "cameras": {
                "side": {
                    "model": "pinhole", "width_px": 1280, "height_px": 960, "fx_px": 1400.0, "fy_px": 1400.0,
                    "cx_px": 640.0, "cy_px": 480.0,
                    "pose": {"position_m": [0.0, -0.3, 0.0], "rpy_deg": [-90.0, 0.0, 0.0]},
                    "sees": [{"body": "strip", "points": {"grid": [7, 2]}}], "rate_hz": 100.0,
                    "noise": {"position_px": 0.1},
                }
            },
        },
        "test",
    )  # fmt: skip


@pytest.mark.parametrize("inertia", [False, True])
def test_density_shows_in_ringing_and_not_by_the_shape_at_rest(inertia: bool, tmp_path: Path) -> None:
    rig = strip(inertia)
    jerk = {"type": "waypoints", "speed_m_s": 0.3, "hold_s": 0.25, "poses": [{"position_m": [0.0, 0.0, 0.01]}]}
    simulate_to_bag(rig, Experiment.model_validate({"name": "jerk", "motions": {"finger": [jerk]}}), tmp_path / "bag")
    run = load_run(rig, tmp_path / "bag")
    density = known(rig, run, ["strip.density_kg_m3"], {"side": 0.1}, None)
    alone = uncertainty(density)
    both = known(rig, run, ["strip.E_pa", "strip.density_kg_m3"], {"side": 0.1}, None)
    found = uncertainty(both)
    if not inertia:
        assert np.max(np.abs(density.jacobian)) < 1e-6
        assert any("do not determine strip.density" in s for s in alone.sentences)
        return
    assert alone.sd[0] < 0.01
    assert found.sd.min() > 50.0 * alone.sd[0]
    (said,) = found.sentences
    assert "strip.E_pa and strip.density_kg_m3 separately, only in combination" in said
    by_modulus, by_density = both.jacobian.T
    assert np.linalg.norm(by_modulus + by_density) < 1e-3 * np.linalg.norm(by_density), "omega^2 ~ E / rho"
