"""Refining a rig until halving anything is small against the noise."""

from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.rigs import parse_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sysid.discretisation.error_budget import MESH, STEP, converge, with_half_cells, with_half_range
from sysid.noise.estimate import as_declared
from sysid.observations.observations import Measured, Run
from sysid.settings.discretisation import DISCRETISATION
from sysid.workflow.converge import converge_rig

FORCE_N = 2e-2


def cantilever(force_n=FORCE_N, dt=0.1, cells=(6, 1)):
    """A soft strip whose clamp is turned up and down; what the clamp feels is all that is measured."""
    material = {"E_pa": 2e7, "nu": 0.3, "thickness_m": 1e-3, "density_kg_m3": 1000.0}
    shape = {"type": "rectangle", "length_m": 0.06, "width_m": 0.02, "cells": list(cells)}
    return parse_rig(
        {
            "name": "cantilever",
            "solver": {"dt_s": dt, "inertia": False},
            "bodies": {"strip": {"type": "sheet", "shape": shape, "material": material}},
            "clamps": [{"name": "grip", "body": "strip", "region": {"x_m": [-0.03, -0.02]}, "mount": "hand"},
                       {"name": "end", "body": "strip", "region": {"x_m": [0.02, 0.03]}}],
            "end_effectors": {"hand": {}},
            "sensors": {"wrench": {"type": "wrench", "on": "grip", "topic": "wrench", "rate_hz": 20.0,
                                   "noise": {"force_n": force_n, "torque_nm": 1.0}}},
        },
        "cantilever",
    )  # fmt: skip


def lifted(rig):
    """A run in which the hand is lifted by 5 mm, quickly at first; its readings do not matter."""
    times = np.array([0.0, 0.1, 0.4, 0.5])
    path = np.outer([0.0, 4e-3, 5e-3, 0.0], [0.0, 0.0, 1.0])
    poses = {"hand": PoseTrajectory(times, path, np.tile([0.0, 0.0, 0.0, 1.0], (4, 1)))}
    t = np.arange(0.0, 0.5, 0.05)
    labels = ("fx", "fy", "fz", "tx", "ty", "tz")
    measured = (Measured("wrench", "wrench", t, np.zeros((len(t), 6)), labels),)
    return run_of(poses, measured, 0.5)


def run_of(poses, measured, end):
    return Run("lifted", "lifted", (), poses=poses, measured=measured, end=end)


def at_stamps(rig, run, refine, dt):
    trace = simulate(build_scene(rig, refine), run.poses, step_times(0.0, run.end, dt))
    return trace.at("wrench", run.measured[0].t)


def test_a_rig_that_converged_is_close_to_a_far_finer_one():
    """Cells and steps a quarter as large change the force by less than the sum of the two errors that are allowed."""
    rig = cantilever()
    run = lifted(rig)
    noise = {"wrench": as_declared(rig, run.measured[0])}
    found = converge(rig, [run], noise)
    assert found.converged
    assert found.rounds[0].worst(MESH) > DISCRETISATION.budget_over_noise
    assert found.rounds[0].worst(STEP) > DISCRETISATION.budget_over_noise
    assert found.rig.bodies["strip"].shape.cells[0] > 6
    assert found.rig.solver.dt_s < 0.1
    dt = found.rig.solver.dt_s
    change = at_stamps(found.rig, run, 2, dt / 4) - at_stamps(found.rig, run, 1, dt)
    rms = float(np.sqrt(np.mean(change[:, :3] ** 2)))
    assert rms < 2.0 * DISCRETISATION.budget_over_noise * FORCE_N
    before = at_stamps(rig, run, 4, dt / 4) - at_stamps(rig, run, 1, 0.1)
    assert float(np.sqrt(np.mean(before[:, :3] ** 2))) > DISCRETISATION.budget_over_noise * FORCE_N


def test_where_the_noise_is_large_nothing_is_changed():
    rig = cantilever(force_n=10.0)
    run = lifted(rig)
    found = converge(rig, [run], {"wrench": as_declared(rig, run.measured[0])})
    assert found.rig == rig
    assert len(found.rounds) == 1
    assert found.converged


def test_what_takes_too_long_is_reported_with_its_cost():
    rig = cantilever(force_n=1e-7)
    run = lifted(rig)
    found = converge(rig, [run], {"wrench": as_declared(rig, run.measured[0])}, most_s=1e-3)
    assert not found.converged
    assert found.rig == rig
    assert len(found.left) == 2
    assert "s of wall time a simulation would make it small enough, where 0 s are allowed" in found.left[0]
    assert MESH in found.left[0]
    assert "Time step" not in found.table()


def pad():
    return parse_rig(
        {
            "name": "pad",
            "bodies": {
                "pad": {
                    "type": "gel",
                    "shape": {"type": "block", "size_m": [0.02, 0.02, 0.01], "cells": [2, 2, 1],
                              "refine": [{"x_m": [-0.002, 0.002], "edge_m": 0.004}]},
                    "material": {"E_pa": 1e5, "nu": 0.4, "density_kg_m3": 1000.0}, "bonded": "bottom", "mount": "world",
                },
                "ball": {"type": "rigid", "shape": {"type": "sphere", "radius_m": 0.01},
                         "pose": {"position_m": [0.0, 0.0, 0.03]}},
            },
            "contacts": [{"between": ["pad", "ball"], "friction": 0.5}],
        },
        "pad",
    )  # fmt: skip


def test_half_the_range_keeps_the_scale_of_pressure():
    rig = pad()
    once, twice = with_half_range(rig), with_half_range(with_half_range(rig))
    a, b = once.contacts[0], twice.contacts[0]
    assert b.range_m == pytest.approx(0.5 * a.range_m)
    assert b.range_m * b.stiffness_pa_per_m == pytest.approx(a.range_m * a.stiffness_pa_per_m)
    assert a.range_m * a.stiffness_pa_per_m == pytest.approx(0.25 * 1e5)  # a quarter of Young's modulus
    assert a.friction == 0.5


def test_half_the_cells_are_those_of_a_refined_scene():
    rig = pad()
    counts = [len(build_scene(r, refine).rest) for r, refine in ((with_half_cells(rig), 1), (rig, 2))]
    assert counts[0] == counts[1]
    assert with_half_cells(rig).bodies["pad"].shape.refine[0].edge_m == 0.002


def test_a_rig_without_noise_is_refused(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"declares no noise of wrench \(force_n\)"):
        converge_rig(cantilever(force_n=0.0), "pull_taut", tmp_path / "rig.yaml")
