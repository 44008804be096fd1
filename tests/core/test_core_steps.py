"""Steps from Python on the compiled core, against rollouts in one call."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.core.covers import covers
from sim_core.errors import ConvergenceError
from sim_core.rigs import parse_rig, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, run, simulate
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-12)


def pad(friction=0.5):
    """A gel under a plate that a hand drives down from 1 mm above it."""
    block = {"type": "block", "size_m": [0.012, 0.012, 0.004], "cells": [2, 2, 1]}
    material = {"E_pa": 2e5, "nu": 0.45, "density_kg_m3": 1000.0}
    bodies = {
        "pad": {"type": "gel", "shape": block, "pose": {"position_m": [0.0, 0.0, 0.002]}, "material": material,
                "bonded": "bottom", "mount": "world"},
        "plate": {"type": "rigid", "shape": {"type": "plane"}, "pose": {"rpy_deg": [180, 0, 0]}, "mount": "hand"},
    }  # fmt: skip
    return parse_rig(
        {
            "name": "pressed", "solver": {"dt_s": 0.01}, "bodies": bodies,
            "contacts": [{"between": ["pad", "plate"], "friction": friction}],
            "end_effectors": {"hand": {"start": {"position_m": [0.0, 0.0, 0.005]}}},
        },
        "pressed",
    )  # fmt: skip


def at(*place):
    return {"hand": (np.array(place), Rotation.identity())}


WAY = [(0.0, 0.0, 0.0041), (0.0, 0.0, 0.0036), (4e-4, 0.0, 0.0036), (8e-4, 2e-4, 0.0036)]


def test_steps_are_those_of_a_rollout_in_one_call():
    rig, times = pad(), 0.01 * np.arange(len(WAY) + 1)
    places = np.array([(0.0, 0.0, 0.005), *WAY])
    poses = {"hand": PoseTrajectory(times, places, np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1)))}
    assert covers(build_scene(rig)) is None
    whole = simulate(build_scene(rig), poses, times, settings=TIGHT, keep_path=True)
    stepped = run(Simulation(build_scene(rig), TIGHT), poses, times, keep_path=True)
    assert np.array_equal(stepped.path.positions, whole.path.positions)
    for channel, values in stepped.outputs.items():
        np.testing.assert_allclose(values, whole.outputs[channel], rtol=1e-9)


def test_forces_of_contacts_and_of_what_holds_a_body_change_its_momentum():
    """F + m g - R = d(m v)/dt in every step, and what the plate feels is the opposite."""
    scene = build_scene(pad())
    simulation, nodes = Simulation(scene, TIGHT), scene.bodies["pad"].nodes
    mass = scene.system.mass[nodes]
    weight = mass.sum() * scene.system.gravity
    before, most = mass @ simulation.state.v, 0.0
    for place in WAY:
        simulation.step(at(*place), 0.01)
        now = mass @ simulation.state.v
        change, before = (now - before).sum(axis=0) / 0.01, now
        forces = simulation.contact_forces()["pad-plate"]
        most = max(most, np.abs(forces).max())
        left = forces[nodes].sum(axis=0) + weight - simulation.reactions()[nodes].sum(axis=0)
        np.testing.assert_allclose(left, change, rtol=0.0, atol=1e-9 * most + 1e-12)
        np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=1e-12 * most)
    assert most > 0.1


def test_a_step_that_fails_is_taken_back_whole():
    """What comes after it is what would have come without it, memory of friction and the past included; the search
    begins anew, which makes round-off."""
    ends = []
    for fails in (False, True):
        simulation = Simulation(build_scene(pad()))
        for place in WAY[:3]:
            simulation.step(at(*place), 0.01)
        before = simulation.state.x
        if fails:
            with pytest.raises(ConvergenceError, match="inside out"):
                simulation.step(at(0.0, 0.0, -0.03), 0.01)
            assert np.array_equal(simulation.state.x, before)
            assert simulation.frames["hand"][0][2] == pytest.approx(0.0036)
        simulation.step(at(*WAY[3]), 0.01)
        ends.append((simulation.state.x, simulation.contact_forces()["pad-plate"]))
    for one, other in zip(*ends, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-9)


def test_numbers_that_change_count_from_the_next_refresh_on():
    rig = pad()
    scene = build_scene(rig)
    simulation = Simulation(scene)
    for place in WAY[:2]:
        simulation.step(at(*place), 0.01)
    soft = -simulation.contact_forces()["pad-plate"][scene.bodies["pad"].nodes, 2].sum()
    state = simulation.state
    scene.use(with_parameters(rig, {"pad.E_pa": 4e5}))
    simulation.refresh()
    assert np.array_equal(simulation.state.x, state.x) and simulation.state.t == state.t
    for _ in range(100):
        simulation.step({}, 0.01)
    hard = -simulation.contact_forces()["pad-plate"][scene.bodies["pad"].nodes, 2].sum()
    other = Simulation(build_scene(with_parameters(rig, {"pad.E_pa": 4e5})))
    for place in [*WAY[:2], *[WAY[1]] * 100]:
        other.step(at(*place), 0.01)
    expected = -other.contact_forces()["pad-plate"][scene.bodies["pad"].nodes, 2].sum()
    assert hard == pytest.approx(expected, rel=1e-3)
    assert hard > 1.5 * soft


def test_a_reset_forgets_what_was_before():
    simulation = Simulation(build_scene(pad()))

    def pressed():
        simulation.reset()
        for place in WAY:
            simulation.step(at(*place), 0.01)
        return simulation.state.x

    first = pressed()
    assert np.array_equal(pressed(), first)
    fresh = Simulation(build_scene(pad()))
    for place in WAY:
        fresh.step(at(*place), 0.01)
    assert np.array_equal(fresh.state.x, first)


def test_a_simulation_goes_on_from_a_state_that_is_put():
    """All of it: positions, velocities, and what friction holds."""
    ends = []
    for put in (False, True):
        simulation = Simulation(build_scene(pad()), TIGHT)
        for place in WAY[:3]:
            simulation.step(at(*place), 0.01)
        state = simulation.state
        if put:
            for place in (WAY[3], WAY[2]):
                simulation.step(at(*place), 0.01)
            assert np.abs(simulation.state.x - state.x).max() > 1e-7
            simulation.state = state
        found = simulation.state
        assert np.array_equal(found.x, state.x) and np.array_equal(found.v, state.v)
        for term, own in state.internals.items():
            assert all(np.array_equal(found.internals[term][name], value) for name, value in own.items())
        ends.append(found)
    assert np.array_equal(ends[0].x, ends[1].x)
