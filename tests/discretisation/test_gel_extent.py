"""A wide pad is as good as a bonded layer without end, a narrow one is not, and recordings tell which they are of."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from scipy.linalg import expm

from sim_core.geometry.lattice import graded_lines
from sim_core.rigs import Gel, Rig
from sim_core.rigs.gel_shapes import Block
from sim_core.rigs.load import parse_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import simulate
from sysid.discretisation.followed_model import follows
from sysid.discretisation.gel_extent import widened
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.discretisation import DISCRETISATION

E, NU, THICK, RADIUS = 2.0e5, 0.47, 8.0e-3, 20e-3
MARKERS = np.linspace(-8e-3, 8e-3, 9)


def pad(size: float, cells: int, points: dict[str, Any] | None = None) -> Rig:
    """A ball held over a pad that is bonded to the world."""
    grid = [[float(x), float(y), 0.5 * THICK] for y in MARKERS for x in MARKERS]
    return parse_rig(
        {
            "name": "pad",
            "gravity_m_s2": [0.0, 0.0, 0.0],
            "solver": {"dt_s": 0.1, "inertia": False},
            "bodies": {
                "gel": {
                    "type": "gel",
                    "shape": {"type": "block", "size_m": [size, size, THICK], "cells": [cells, cells, 2]},
                    "pose": {"position_m": [0.0, 0.0, -0.5 * THICK]},
                    "material": {"E_pa": E, "nu": NU, "density_kg_m3": 1000.0},
                    "bonded": "bottom",
                    "mount": "world",
                },
                "ball": {
                    "type": "rigid",
                    "shape": {"type": "sphere", "radius_m": RADIUS},
                    "pose": {"position_m": [0.0, 0.0, RADIUS]},
                    "mount": "hand",
                },
            },
            "end_effectors": {
                "hand": {
                    "base_frame": "base_link",
                    "start": {"position_m": [0.0, 0.0, 1e-4]},
                    "topics": {"target_pose": "target_pose", "current_pose": "current_pose"},
                }
            },
            "contacts": [{"between": ["gel", "ball"], "friction": 0.8}],
            "sensors": {
                "wrench": {"type": "wrench", "on": "gel", "frame_id": "gel", "topic": "wrench"},
                "markers": {"type": "markers", "body": "gel", "points": points or {"positions_m": grid}},
            },
        },
        "pad.yaml",
    )


def dragged(rig: Rig) -> tuple[float, float]:
    """Tangential force [N] and mean motion [m] of the markers along it, of a ball pressed 0.3 mm deep and moved by
    0.05 mm, while it sticks."""
    times = np.array([0.0, 0.5, 1.0])
    places = np.array([[0.0, 0.0, 1e-4], [0.0, 0.0, -3e-4], [5e-5, 0.0, -3e-4]])
    poses = {"hand": PoseTrajectory(times, places, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)))}
    trace = simulate(build_scene(rig), poses, np.linspace(0.0, 1.0, 11))
    force = trace.outputs["wrench"].reshape(11, -1)
    moved = trace.outputs["markers"].reshape(11, -1, 3)
    return float(force[-1, 0] - force[5, 0]), float((moved[-1] - moved[5])[:, 0].mean())


def compliance(k: float) -> float:
    """Amplitude of the motion [m/Pa] of the surface of a bonded layer along the wave vector ``k`` [1/m] of a tangential
    traction along it: plane strain, with displacements (U(z) cos kx, W(z) sin kx)."""
    mu = E / (2.0 * (1.0 + NU))
    lame = 2.0 * mu * NU / (1.0 - 2.0 * NU)
    stiff = lame + 2.0 * mu
    along = np.zeros((4, 4))
    along[0, 2] = along[1, 3] = 1.0
    along[2, 0], along[2, 3] = stiff * k * k / mu, -(lame + mu) * k / mu
    along[3, 1], along[3, 2] = mu * k * k / stiff, (lame + mu) * k / stiff
    from_base = expm(along * THICK)[:, 2:]
    tractions = np.array([mu * (from_base[2] + k * from_base[1]), stiff * from_base[3] - lame * k * from_base[0]])
    return float(from_base[0] @ np.linalg.solve(tractions, [1.0, 0.0]))


def layer(contact: float) -> float:
    """Mean motion [m/N] of the markers by a tangential load on a disc of radius ``contact`` [m] of an endless bonded
    layer, its traction q ~ sqrt(1 - r^2 / a^2): Fourier integral over the plane."""
    mu = E / (2.0 * (1.0 + NU))
    count, length = 320, 0.16
    waves = 2.0 * np.pi * np.fft.fftfreq(count, d=length / count)
    kx, ky = np.meshgrid(waves, waves, indexing="ij")
    size = np.asarray(np.hypot(kx, ky))
    size[0, 0] = 1e-3
    table = np.linspace(1.0, 2000.0, 400)
    plane = np.interp(size, table, [compliance(k) for k in table])
    plane[size > 2000.0] = (1.0 - NU) / (mu * size[size > 2000.0])
    shear = np.tanh(size * THICK) / (mu * size)
    whole = (plane * kx**2 + shear * ky**2) / size**2
    whole[0, 0] = THICK / mu
    x = (np.arange(count) - count // 2) * length / count
    along, across = np.meshgrid(x, x, indexing="ij")
    load = np.sqrt(np.maximum(1.0 - (along**2 + across**2) / contact**2, 0.0))
    load /= load.sum() * (length / count) ** 2
    window = np.sum(np.cos(np.multiply.outer(waves, MARKERS)), axis=-1) / len(MARKERS)
    spread = np.real(np.fft.fft2(np.fft.ifftshift(load)) * (length / count) ** 2)
    return float(np.sum(whole * spread * np.multiply.outer(window, window)) / length**2)


def test_a_wide_pad_is_a_layer_without_end_and_a_narrow_one_is_not() -> None:
    narrow = pad(3.2 * THICK, 6)
    wide = widened(narrow)
    assert wide is not None and "wider pad than gel" in wide.notes[0]
    expected = layer(np.sqrt(RADIUS * 3e-4) * 0.9)
    force, moved = dragged(wide.rig)
    assert moved / force == pytest.approx(expected, rel=0.04)
    force, moved = dragged(narrow)
    assert moved / force > 1.2 * expected


def test_cells_in_the_middle_stay_as_wide_as_they_were() -> None:
    wide = widened(pad(3.2 * THICK, 6))
    assert wide is not None
    block = cast(Gel, wide.rig.bodies["gel"]).shape
    assert isinstance(block, Block)
    lines = graded_lines(block.size_m, block.cells, block.ratios)[0]
    assert np.diff(lines).min() == pytest.approx(3.2 * THICK / 6, rel=1e-6)
    assert np.ptp(lines) == pytest.approx(DISCRETISATION.wide_pad_ratio * THICK)


def test_pads_whose_size_is_known_or_that_are_wide_stay() -> None:
    assert widened(pad(3.2 * THICK, 6, {"face": "top", "grid": [5, 5]})) is None
    assert widened(pad(5.0 * THICK, 8)) is None


@pytest.mark.parametrize("of_wide", [True, False])
def test_recordings_tell_which_they_are_of(of_wide: bool) -> None:
    """Whatever the modulus is off by, and where nothing tells, the rig's stays."""
    t = np.linspace(0.0, 1.0, 200)[:, None]
    narrow = np.column_stack([np.sin(np.pi * t), np.sin(np.pi * t) ** 2])
    wide = narrow * [1.02, 0.75]
    sigma = 3e-3
    noise = {"gauge": ChannelNoise(np.full(2, sigma), np.zeros(2), "given")}
    truth = (wide if of_wide else narrow) * [1.1, 1.1]
    readings = truth + sigma * np.random.default_rng(1).standard_normal(truth.shape)
    run = Run("r", "r", (), {}, (Measured("gauge", "markers", t[:, 0], readings, ("x", "y")),), 1.0)
    one = Prediction({"gauge": narrow}, {"gauge": narrow[..., None]}, cast(Any, None))
    there = [Prediction({"gauge": wide}, {}, cast(Any, None))]
    (found,) = follows([run], [one], [there], noise, np.array([0.35]))
    assert found.extends == of_wide
    (alike,) = follows([run], [one], [[one]], noise, np.array([0.35]))
    assert alike.refines and not alike.extends
