"""Where something rubs or flows while it settles, the first equilibrium and its derivatives depend on the way to it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from against_differences import compare_derivatives

from sim_core.gradients import Backward, Tape, directions, simulate_tangent
from sim_core.rigs import parse_rig, with_parameters
from sim_core.rigs.motion import Experiment, compile_experiment
from sim_core.scene import build_scene
from sim_core.simulate import simulate
from sim_core.solve.report import NewtonSettings
from sysid.gradients import check_gradients

WAIT = Experiment.model_validate({"name": "wait", "motions": {"hand": [{"type": "wait", "duration_s": 0.02}]}})


def drooping(height_m=0.006, **effects):
    """A strip that is held at one end and droops on to a table, along which its other end has slid."""
    return parse_rig(
        {
            "name": "drooping",
            "solver": {"dt_s": 0.01},
            "bodies": {
                "strip": {
                    "type": "sheet",
                    "shape": {"type": "rectangle", "length_m": 0.1, "width_m": 0.02, "cells": [8, 2]},
                    "pose": {"position_m": [0.0, 0.0, height_m]},
                    "material": {"E_pa": 1.0e9, "nu": 0.3, "thickness_m": 1.0e-4, "density_kg_m3": 800.0},
                },
                "table": {"type": "rigid", "shape": {"type": "plane"}},
            },
            "clamps": [{"name": "hold", "body": "strip", "region": {"x_m": [-0.05, -0.037]}, "mount": "hand"}],
            "contacts": [{"between": ["strip", "table"], "friction": 0.3}],
            "end_effectors": {"hand": {"start": {"position_m": [-0.05, 0.0, height_m]}}},
            "sensors": {
                "wrench": {
                    "type": "wrench", "on": "hold", "frame_id": "wrench", "rate_hz": 100.0, "topic": "wrench",
                    "pose": {"position_m": [-0.05, 0.0, height_m]}, "noise": {"force_n": 1e-4, "torque_nm": 1e-6},
                }
            },
            "effects": effects,
        },
        "test",
    )  # fmt: skip


NAMES = ["strip.E", "strip.density", "strip-table.friction", "gravity.x"]


def compared(rig, names):
    passed, text = check_gradients(rig, WAIT, names, steps=(1e-3, 1e-4, 1e-5), as_json=True)
    return passed, json.loads(text)["rows"]


@pytest.mark.parametrize(
    "effects", [{}, {"bending_plasticity": {"yield_curvature_per_m": 5.0, "hardening_ratio": 0.1}}]
)
def test_derivatives_follow_the_way_to_equilibrium(effects):
    names = [*NAMES, "effects.bending_plasticity.yield_curvature_per_m"] if effects else NAMES
    _, rows = compared(drooping(0.0055, **effects), names)
    forces = [r for r in rows if r["channel"] == "wrench force"]
    assert [r["verdict"] for r in forces] == ["agrees"] * len(names), [(r["parameter"], r["errors"]) for r in forces]


def test_so_do_those_by_offsets_of_the_hand_that_it_starts_from():
    """Points that have slid rest at the verge of slip, where differences are taken across it: within 1 %."""
    _, rows = compared(drooping(), ["hand.offset_z", "hand.offset_ry"])
    assert len(rows) == 4
    assert max(r["best"] for r in rows) < 0.01
    assert max(r["adjoint"] for r in rows) < 1e-8


def test_a_rig_without_inertia_settles_with_it():
    """Its density acts on the way by inertia, too: forwards and backwards are the same."""
    data = drooping().model_dump()
    data["solver"]["inertia"] = False
    _, rows = compared(parse_rig(data, "slow"), ["strip.density"])
    assert rows
    assert max(r["adjoint"] for r in rows) < 1e-8


@pytest.mark.parametrize("name", ["hand.offset_z_m", "hand.offset_ry_deg"])
def test_points_that_rest_near_the_verge_of_slip(name):
    """They hold with a small part of the spring of friction, once by where they are and once by where they were: a slip
    of 1e-9 m that is rounded twice in two ways makes 1e-3 of that."""
    tight = NewtonSettings(step_tolerance_m=1e-13, force_tolerance=1e-11)
    rig, times, wide = drooping(), np.array([0.0, 0.01, 0.02]), 1e-7 if name.endswith("_m") else 1e-4
    poses = compile_experiment(WAIT, rig)
    low, high = (
        simulate(build_scene(with_parameters(rig, {name: s * wide})), poses, times, settings=tight) for s in (-1, 1)
    )
    central = (high.outputs["wrench"] - low.outputs["wrench"]) / (2.0 * wide)
    found = simulate_tangent(build_scene(rig), poses, times, directions(rig, [name]), settings=tight)[1]["wrench"]
    assert np.abs(found[..., 0] - central).max() < 1e-4 * np.abs(central).max()


def test_derivatives_where_surfaces_touch_at_rest():
    """A strip that droops on to a gel and rubs on it."""
    data = drooping().model_dump()
    data["bodies"]["table"] = {
        "type": "gel", "shape": {"type": "block", "size_m": [0.12, 0.03, 0.004], "cells": [8, 2, 1]},
        "pose": {"position_m": [0.0, 0.0, -0.002]}, "mount": "world", "bonded": "bottom",
        "material": {"E_pa": 5.0e4, "nu": 0.3, "density_kg_m3": 1000.0},
    }  # fmt: skip
    rig, times = parse_rig(data, "on a gel"), np.array([0.0, 0.01, 0.02])
    names = ["strip.E_pa", "strip.density_kg_m3", "contacts.strip-table.friction", "table.E_pa", "hand.offset_z_m"]
    settings = NewtonSettings(step_tolerance_m=1e-13, force_tolerance=1e-11)
    trace = compare_derivatives(rig, compile_experiment(WAIT, rig), times, names, settings, share=1e-4, smooth=1.0)
    assert min(report.contacts for report in trace.reports) > 0


def resting_pad():
    """A gel in a hand that rests on a table, hangs by its own weight from there, and rubs on it."""
    data = drooping(2.0e-5).model_dump()
    data["bodies"]["strip"] = {
        "type": "gel", "shape": {"type": "block", "size_m": [0.012, 0.012, 0.004], "cells": [2, 2, 1]},
        "pose": {"position_m": [0.0, 0.0, 0.002 - 1.0e-5], "rpy_deg": [180.0, 0.0, 0.0]}, "mount": "hand",
        "material": {"E_pa": 5.0e2, "nu": 0.3, "density_kg_m3": 1000.0}, "bonded": "bottom",
    }  # fmt: skip
    data["clamps"] = []
    data["sensors"]["wrench"]["on"] = "strip"
    del data["sensors"]["wrench"]["pose"]
    return parse_rig(data, "pad")


def test_weights_of_where_a_pad_starts_reach_the_hand():
    """Which carries it there: forwards and backwards are the same, and a shift along the table strains nothing."""
    rig, times = resting_pad(), np.array([0.0, 0.01, 0.02])
    poses, along = compile_experiment(WAIT, rig), directions(rig, ["hand.offset_x", "hand.offset_ry"])
    trace, forward = simulate_tangent(build_scene(rig), poses, times, along)
    assert all(report.contacts > 0 for report in trace.reports)
    weights = np.random.default_rng(0).standard_normal(trace.outputs["wrench"].shape)
    backward = Backward(Tape(build_scene(rig), poses, times), along).gradient(0.0, {"wrench": weights}).parameters
    for k, name in enumerate(("hand.offset_x_m", "hand.offset_ry_deg")):
        expected = float((forward["wrench"][..., k] * weights).sum())
        assert backward[name] == pytest.approx(expected, rel=1e-6, abs=1e-7)
    assert abs(backward["hand.offset_x_m"]) < 1e-7
