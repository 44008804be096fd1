"""Where something rubs or flows while it settles, the first equilibrium and its derivatives depend on the way to it."""

from __future__ import annotations

import json

import pytest

from sim_core.gradients import settling
from sim_core.rigs import parse_rig
from sim_core.rigs.motion import Experiment
from sysid.gradients import check_gradients

WAIT = Experiment.model_validate({"name": "wait", "motions": {"hand": [{"type": "wait", "duration_s": 0.02}]}})


def drooping(**effects):
    """A strip that is held at one end and droops on to a table, along which its other end has slid."""
    return parse_rig(
        {
            "name": "drooping",
            "solver": {"dt_s": 0.01},
            "bodies": {
                "strip": {
                    "type": "sheet",
                    "shape": {"type": "rectangle", "length_m": 0.1, "width_m": 0.02, "cells": [8, 2]},
                    "pose": {"position_m": [0.0, 0.0, 0.006]},
                    "material": {"E_pa": 1.0e9, "nu": 0.3, "thickness_m": 1.0e-4, "density_kg_m3": 800.0},
                },
                "table": {"type": "rigid", "shape": {"type": "plane"}},
            },
            "clamps": [{"name": "hold", "body": "strip", "region": {"x_m": [-0.05, -0.037]}, "mount": "hand"}],
            "contacts": [{"between": ["strip", "table"], "friction": 0.3}],
            "end_effectors": {"hand": {"start": {"position_m": [-0.05, 0.0, 0.006]}}},
            "sensors": {
                "wrench": {
                    "type": "wrench", "on": "hold", "frame_id": "wrench", "rate_hz": 100.0, "topic": "wrench",
                    "pose": {"position_m": [-0.05, 0.0, 0.006]}, "noise": {"force_n": 1e-4, "torque_nm": 1e-6},
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
    _, rows = compared(drooping(**effects), names)
    forces = [r for r in rows if r["channel"] == "wrench force"]
    assert [r["verdict"] for r in forces] == ["agrees"] * len(names), [(r["parameter"], r["errors"]) for r in forces]


def test_so_do_those_by_offsets_of_the_hand_that_it_starts_from():
    """Points that have slid rest at the verge of slip, where differences are taken across it: within 1 %. The adjoint
    is that of the same branch."""
    _, rows = compared(drooping(), ["hand.offset_z", "hand.offset_ry"])
    assert len(rows) == 4
    assert max(r["best"] for r in rows) < 0.01
    assert max(r["adjoint"] for r in rows) < 1e-8


def test_without_the_way_they_are_wrong(monkeypatch):
    monkeypatch.setattr(settling.LinearStep, "remembers", False)
    passed, rows = compared(drooping(), ["strip.E", "strip-table.friction"])
    assert not passed
    assert max(r["best"] for r in rows) > 0.01
