"""A deep strip that is loaded in its plane and gives way sideways (Prandtl 1899, Michell 1899).

A cantilever of the length L whose end bears a force through its middle line buckles, bending and twisting at once, at

    P = 4.0126 sqrt(B C) / L^2,    B = E b h^3 / 12,    C = G b h^3 / 3

with the depth b and the thickness h: the first zero of J_-1/4 at half the square root of P L^2 / sqrt(B C)
(Timoshenko & Gere, Theory of Elastic Stability, 2nd ed., sec. 6.3). A strip is a beam up to its depth over its length,
and the clamp that keeps its end from warping is stiffer than the beam's by about b / (2 L) at nu = 0.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.rigs import Rig, parse_rig, with_parameters
from sim_core.scene import build_scene
from sim_core.stepping import Simulation
from sysid.validation.buckling import zero
from sysid.validation.case import THRESHOLDS, Case
from sysid.validation.small_motions import natural_vibrations

PRANDTL = 4.0126
LENGTH, DEPTH, THICKNESS, MODULUS = 0.4, 0.01, 2e-4, 3e9
SHARES = (0.5, 0.8, 0.95)
"""Of the critical load, at which the square of the slowest frequency is measured to find its zero."""


def strip_rig(cells: tuple[int, int], force: float) -> Rig:
    """The strip along x, its depth along y; the force on its end is against y."""
    grip = LENGTH / cells[0]
    half = 0.5 * (LENGTH + grip)
    shape = {
        "type": "rectangle",
        "length_m": 2.0 * half,
        "width_m": DEPTH,
        "cells": [cells[0] + 1, cells[1]],
        "pattern": "crossed",
    }
    material = {"E_pa": MODULUS, "nu": 0.0, "thickness_m": THICKNESS, "density_kg_m3": 1000.0}
    return parse_rig(
        {
            "name": "deep_strip",
            "gravity_m_s2": [0.0, 0.0, 0.0],
            "solver": {"dt_s": 1.0, "inertia": False},
            "bodies": {"strip": {"type": "sheet", "shape": shape, "material": material}},
            "clamps": [{"body": "strip", "region": {"x_m": [-half, grip - half]}}],
            "loads": [
                {"name": "end", "type": "force", "body": "strip", "region": {"x_m": [half, half]},
                 "force_n": [0.0, -force, 0.0]},
            ],
        },
        "deep_strip",
    )  # fmt: skip


def critical_force(cells: tuple[int, int]) -> float:
    """P L^2 / sqrt(B C) at which the slowest vibration comes to rest."""
    inertia = DEPTH * THICKNESS**3
    unit = MODULUS * inertia * np.sqrt(1.0 / 12.0 * 0.5 / 3.0) / LENGTH**2
    rig = strip_rig(cells, 0.0)
    scene = build_scene(rig)
    loads, squares = [], []
    for share in SHARES:
        load = share * PRANDTL * unit
        scene.use(with_parameters(rig, {"end.force_y": -load}))
        there = Simulation(scene).state.x
        squares.append(float(natural_vibrations(scene.system, 1, there)[0][0] ** 2))
        loads.append(load)
    return float(zero(loads, squares) / unit)


def lateral_buckling_cases() -> Iterator[Case]:
    """The comparison of a deep strip."""
    yield Case(
        "deep cantilever under an end force", "lateral buckling load", "sqrt(BC)/L^2", PRANDTL, critical_force((80, 4)),
        THRESHOLDS, "crossed 80 x 4", "Prandtl 1899, Michell 1899",
        remark="of a beam; a strip is one up to its depth over its length, here 1/40",
    )  # fmt: skip
