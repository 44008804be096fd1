"""Gradients on the way back against derivatives that are carried forwards."""

from __future__ import annotations

import numpy as np

from sim_core.gradients import Backward, Tape, directions, simulate_tangent
from sim_core.scene import build_scene
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-13, force_tolerance=1e-11)


def weights(trace, seed=0):
    """Of a random sum of the readings."""
    rng = np.random.default_rng(seed)
    return {c: np.where(np.isnan(o), 0.0, rng.standard_normal(o.shape)) for c, o in trace.outputs.items()}


def compare_with_columns(rig, poses, times, names, loose=1e-9):
    """The adjoint is the transpose of the columns to a share ``loose`` of the size of the sums, channel by channel."""
    scene, along = build_scene(rig), directions(rig, names)
    tape = Tape(scene, poses, times, TIGHT)
    trace, columns = simulate_tangent(scene, poses, times, along, settings=TIGHT)
    given, compared = weights(trace), 0
    for channel, w in given.items():
        found = Backward(tape, along).gradient(0.0, {channel: w}).parameters
        products = np.nan_to_num(columns[channel]) * w[..., None]
        for k, direction in enumerate(along):
            size = float(np.abs(products[..., k]).sum())
            compared += size > 0.0
            # A shift of everything strains nothing: what is left of 6e5 N/m times 1 m is round-off.
            shift = ".offset_" in direction.name and direction.name.endswith("_m")
            lost = 2e-8 * float(np.abs(w).sum()) if shift else 0.0
            assert abs(found[direction.name] - products[..., k].sum()) <= loose * size + lost, (channel, direction.name)
    assert compared >= len(names)
