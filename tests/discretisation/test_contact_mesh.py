"""Cells of a gel are made finer where a ball touches it, and the error of the mesh follows from the coarser one."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from sim_core.rigs import Gel, load_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.discretisation.contact_mesh import refined_where_touched
from sysid.discretisation.followed_model import follows
from sysid.discretisation.refinement import error_of_coarser_cells
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.discretisation import DISCRETISATION

RIG = Path(__file__).parents[1] / "ros" / "data" / "press_gel.yaml"


def press(depth_m: float) -> Run:
    """The ball of the rig goes down until it is so deep in the undeformed pad."""
    rig = load_rig(RIG)
    start = rig.end_effectors["probe"].start.position()
    clearance = 5e-4
    times = np.linspace(0.0, 1.0, 11)
    positions = start - np.outer(times, [0.0, 0.0, clearance + depth_m])
    poses = {"probe": PoseTrajectory(times, positions, np.tile([0.0, 0.0, 0.0, 1.0], (11, 1)))}
    return Run("press", "press", (), poses, (), 1.0)


def pad(rig: Any) -> Gel:
    return cast(Gel, next(body for body in rig.bodies.values() if isinstance(body, Gel)))


def ball_radius(rig: Any) -> float:
    return float(next(b.shape.radius_m for b in rig.bodies.values() if getattr(b.shape, "type", "") == "sphere"))


def test_the_box_is_about_the_contact_of_hertz() -> None:
    """sqrt(R delta) to each side, but for (delta / 2 R) of it and the distance of sampled points."""
    rig, depth = load_rig(RIG), 1.2e-3
    found = refined_where_touched(rig, [press(depth)])
    assert found is not None
    (box,) = pad(found.rig).shape.refine
    radius = np.sqrt(ball_radius(rig) * depth)
    spacing = float(np.ptp(pad(rig).shape.whole_bounds(), axis=0).max()) / 60.0
    for low, high in (box.x_m, box.y_m):
        assert 0.5 * (high - low) == pytest.approx((1.0 + DISCRETISATION.contact_margin) * radius, abs=2.0 * spacing)
        assert abs(low + high) < 2.0 * spacing
    assert box.edge_m <= DISCRETISATION.edge_over_contact_radius * radius * 1.01
    assert found.finer > 1.0 and "mm long where it is touched" in found.notes[0]


def test_what_is_fine_enough_or_not_touched_or_refined_by_the_rig_stays() -> None:
    rig, run = load_rig(RIG), press(1.2e-3)
    assert refined_where_touched(rig, [press(-4e-4)]) is None, "the ball stays above the pad"
    found = refined_where_touched(rig, [run])
    assert found is not None
    assert refined_where_touched(found.rig, [run]) is None
    shape = pad(rig).shape
    finer = pad(rig).model_copy(update={"shape": shape.model_copy(update={"cells": tuple(4 * n for n in shape.cells)})})
    name = next(n for n, b in rig.bodies.items() if isinstance(b, Gel))
    fine = rig.model_copy(update={"bodies": {**rig.bodies, name: finer}})
    assert refined_where_touched(fine, [run]) is None


def test_the_error_follows_from_the_coarser_mesh_where_it_goes_with_the_square_of_its_cells() -> None:
    """y = y* + C h^2 on both: what is found is y* less the prediction."""
    truth, of_cells, finer = np.linspace(1.0, 2.0, 5)[:, None], 0.3, 1.7
    fine, coarse = (Prediction({"gauge": truth + of_cells * h**2}, {}, cast(Any, None)) for h in (1.0, finer))
    shape = error_of_coarser_cells([fine], [coarse], finer)
    np.testing.assert_allclose(shape.shapes[0]["gauge"], -of_cells, rtol=1e-12)


@pytest.mark.parametrize("with_fine_cells", [True, False])
def test_a_recording_that_was_simulated_with_the_cells_of_the_rig_keeps_them(with_fine_cells: bool) -> None:
    """Whatever the modulus is off by: here 20 %, ten times what the mesh changes."""
    t = np.linspace(0.0, 1.0, 200)[:, None]
    force = -(np.sin(np.pi * t) ** 1.5)
    coarse, fine = 1.03 * force, 1.01 * force - 0.02 * force**2
    sigma = 3e-3
    noise = {"gauge": ChannelNoise(np.array([sigma]), np.zeros(1), "given")}
    truth = 1.2 * (fine if with_fine_cells else coarse)
    readings = truth + sigma * np.random.default_rng(2).standard_normal(t.shape)
    run = Run("r", "r", (), {}, (Measured("gauge", "markers", t[:, 0], readings, ("x",)),), 1.0)
    there = Prediction({"gauge": coarse}, {"gauge": coarse[..., None]}, cast(Any, None))
    here = Prediction({"gauge": fine}, {}, cast(Any, None))
    assert follows([run], [there], [[here]], noise, np.array([0.35]))[0].refines == with_fine_cells
