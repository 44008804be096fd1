"""Moduli and Poisson's ratios of each element of a gel and a sheet: differences, and a soft spot that is found."""

from __future__ import annotations

import numpy as np
import pytest
from potentials import Look
from scipy.optimize import minimize
from test_adjoint import TIGHT, weights

from sim_core.errors import ConfigError
from sim_core.gradients import Backward, Tape, simulate_adjoint
from sim_core.rigs import parse_rig, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import simulate


def pad():
    """A gel on a finger, pressed on a plate with friction and drawn, with markers on its face."""
    rig = parse_rig(
        {
            "name": "pad",
            "solver": {"dt_s": 0.02, "inertia": False},
            "bodies": {
                "gel": {
                    "type": "gel",
                    "shape": {"type": "block", "size_m": [0.03, 0.02, 0.006], "cells": [3, 2, 1]},
                    "pose": {"rpy_deg": [180.0, 0.0, 0.0]},
                    "material": {"E_pa": 1.0e5, "nu": 0.4, "density_kg_m3": 1000.0},
                    "bonded": "bottom",
                    "mount": "finger",
                },
                "plate": {
                    "type": "rigid",
                    "shape": {"type": "box", "size_m": [0.02, 0.05, 0.02]},
                    "pose": {"position_m": [0.0, 0.0, -0.01]},
                },
            },
            "end_effectors": {"finger": {"start": {"position_m": [0.0, 0.0, 0.0031]}}},
            "contacts": [{"between": ["gel", "plate"], "friction": 0.5}],
            "sensors": {
                "face": {"type": "markers", "body": "gel", "points": {"face": "top", "grid": [9, 6]}},
                "load": {"type": "wrench", "on": "finger"},
            },
        },
        "pad",
    )
    path = [0.0, 0.0, 0.0031] + np.array([[0, 0, 0], [0, 0, -6e-4], [4e-4, 2e-4, -8e-4]])
    poses = {"finger": PoseTrajectory(np.array([0.0, 0.1, 0.2]), path, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)))}
    return rig, poses, np.linspace(0.0, 0.2, 11)


def test_a_soft_spot_is_found_from_markers():
    """One third of a pad has half the modulus; each of 30 tetrahedra has its own, from a uniform pad on."""
    rig, poses, times = pad()
    scene = build_scene(rig)
    fields, name = scene.fields, "gel.E_pa"
    soft = fields.places(name)[:, 0] > 0.005
    fields[name] = np.where(soft, 5e4, 1e5)
    seen = simulate(scene, poses, times).outputs
    noise = {"face": 1e-6, "load": np.array([1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])}

    def loss(trace):
        misses = {c: (trace.outputs[c] - seen[c]) / noise[c] for c in noise}
        return sum(0.5 * float(np.sum(m**2)) for m in misses.values()), {c: m / noise[c] for c, m in misses.items()}

    def evaluate(logarithm):
        fields[name] = 1e5 * np.exp(logarithm)
        found = simulate_adjoint(scene, poses, times, loss, [], fields=[name])
        return found.value, found.fields[name] * fields[name]

    result = minimize(evaluate, np.zeros(len(soft)), jac=True, method="L-BFGS-B", options={"maxiter": 40})
    found = 1e5 * np.exp(result.x)
    assert 0 < soft.sum() < len(soft) and result.fun < 1e-3 * evaluate(np.zeros(len(soft)))[0]
    assert np.abs(found[soft] - 5e4).max() < 0.15 * 5e4
    assert np.abs(found[~soft] - 1e5).max() < 0.15 * 1e5


def test_ratios_of_a_pad_that_slides_against_differences_of_rollouts():
    """Nearly incompressible and relaxing, pressed on a plate with friction and drawn: by all elements together and by
    the one that counts most."""
    rig, poses, times = pad()
    data = rig.model_dump()
    data["effects"] = {"gel_relaxation": {"share": 0.4, "tau_s": 0.1}}
    scene = build_scene(parse_rig(data, "relaxing"))
    fields, name = scene.fields, "gel.nu"
    rng = np.random.default_rng(0)
    here = 0.42 + 0.06 * rng.uniform(-1.0, 1.0, len(fields[name]))
    fields[name] = here
    tape = Tape(scene, poses, times, TIGHT)
    assert tape.trace.reports[-1].contacts > 0
    given = {c: w / np.nanmax(np.abs(tape.trace.outputs[c])) for c, w in weights(tape.trace).items()}
    gradient = Backward(tape, [], [name]).gradient(0.0, given).fields[name]
    for along in (rng.standard_normal(len(here)), np.eye(len(here))[np.abs(gradient).argmax()]):
        values = []
        for s in (1.0, -1.0, 2.0, -2.0):
            fields[name] = here + 1e-5 * s * along
            outputs = simulate(scene, poses, times, settings=TIGHT).outputs
            values.append(sum(np.nansum(outputs[c] * w) for c, w in given.items()))
        expected = (8.0 * (values[0] - values[1]) - values[2] + values[3]) / 12e-5
        assert abs(gradient @ along - expected) < 1e-6 * np.abs(gradient).max() * np.linalg.norm(along)


def test_ratios_of_a_gel_that_are_everywhere_the_same():
    """0.2 in place of the 0.4 of the rig is the number of another rig, and pushes the plate less."""
    rig, poses, times = pad()
    scene = build_scene(rig)
    stiff = simulate(scene, poses, times, settings=TIGHT).outputs
    scene.fields["gel.nu"] = 0.2
    found = simulate(scene, poses, times, settings=TIGHT).outputs
    other = build_scene(with_parameters(rig, {"gel.nu": 0.2}))
    for channel, expected in simulate(other, poses, times, settings=TIGHT).outputs.items():
        assert np.nanmax(np.abs(found[channel] - expected)) < 1e-8 * np.nanmax(np.abs(expected))
    assert np.abs(found["load"][-1, 2]) < 0.8 * np.abs(stiff["load"][-1, 2])


def exerted(scene, x):
    """Forces of all terms on the nodes at ``x`` [N] ``(n, 3)``."""
    look = Look(scene.system)
    look.x[:] = x
    return look.exerted()


def test_ratios_are_shifted_by_the_number_of_the_rig(small_rig):
    """Also those of a rig that has none, through another shape, and not beyond what a solid can have."""
    rig = with_parameters(small_rig(), {"gel.nu": 0.0, "card.nu": 0.0})
    scene, wave = build_scene(rig), np.random.default_rng(3).uniform(-0.4, 0.4, 24)
    fields = scene.fields
    fields["card.nu"], fields["gel.nu"] = wave, 0.2
    assert fields["card.nu"] == pytest.approx(wave) and fields["gel.nu"] == pytest.approx(0.2)
    scene.use(with_parameters(rig, {"card.nu": 0.05}))
    assert fields["card.nu"] == pytest.approx(wave + 0.05) and fields["gel.nu"] == pytest.approx(0.2)
    fields["card.rest_m"] = fields["card.rest_m"] - [0.0, 0.0, 1e-3]
    other = build_scene(scene.rig)
    other.fields["card.rest_m"], other.fields["card.nu"] = fields["card.rest_m"], wave + 0.05
    x = scene.rest + 1e-4 * np.random.default_rng(4).standard_normal(scene.rest.shape)
    found, expected, plain = (exerted(each, x)[scene.bodies["card"].nodes] for each in (scene, other, build_scene(rig)))
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max() < np.abs(plain - expected).max()
    with pytest.raises(ConfigError, match=r"card\.nu.* is not between -1 and 0\.5"):
        scene.use(with_parameters(rig, {"card.nu": 0.3}))
    assert scene.rig.bodies["card"].material.nu == 0.05 and fields["card.nu"] == pytest.approx(wave + 0.05)
    fields.reset()
    assert np.all(fields["card.nu"] == 0.05) and np.all(fields["gel.nu"] == 0.0)
    scene.use(with_parameters(rig, {"card.nu": 0.3}))
