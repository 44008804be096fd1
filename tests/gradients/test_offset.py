"""Offsets of end effectors against their poses: what they do to a rollout, and its derivatives by them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_adjoint import CASES, TIGHT, ball, small, swung, weights
from test_tangent import RUB

from sim_core.gradients import Backward, Tape, directions, simulate_tangent
from sim_core.rigs import with_parameters
from sim_core.rigs.pose_offset import OFFSETS
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.scene.offset import offset_motion, with_offsets
from sim_core.simulate import simulate

OFF = dict(zip(OFFSETS, (4e-4, -3e-4, 2e-4, 0.4, -0.3, 0.5), strict=True))

LITTLE = {key: 0.01 * value for key, value in OFF.items()}


def off(rig, values=OFF):
    (mount,) = rig.end_effectors
    return with_parameters(rig, {f"{mount}.{key}": v for key, v in values.items()})


def test_an_offset_is_the_same_as_poses_that_have_it(small_rig, visit):
    """T_nominal * T_offset, with 4 x 4 matrices."""
    rig, poses, times = small(RUB, 0.4)(small_rig, visit)
    (mount,) = poses
    nominal = poses[mount]
    shift = np.eye(4)
    shift[:3, :3] = Rotation.from_rotvec([0.4, -0.3, 0.5], degrees=True).as_matrix()
    shift[:3, 3] = [4e-4, -3e-4, 2e-4]
    true = np.tile(np.eye(4), (len(times), 1, 1))
    true[:, :3, 3], quaternions = nominal.sample(times)
    true[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    true = true @ shift
    moved = PoseTrajectory.from_samples(times, true[:, :3, 3], Rotation.from_matrix(true[:, :3, :3]).as_quat())
    expected = simulate(build_scene(rig), {mount: moved}, times, settings=TIGHT)
    found = simulate(build_scene(off(rig)), poses, times, settings=TIGHT)
    for channel, values in expected.outputs.items():
        np.testing.assert_allclose(found.outputs[channel], values, atol=1e-9 * np.nanmax(np.abs(values)))


def test_without_an_offset_frames_are_those_that_are_stated(small_rig):
    rig = small_rig()
    frames = build_scene(rig).start
    assert all(with_offsets(rig, frames)[name] is frame for name, frame in frames.items())


@pytest.mark.parametrize("size", [0.0, 1e-3, 0.02, 0.7])
def test_motion_by_an_offset_against_differences(small_rig, size):
    """On both sides of the angle where a series takes over."""
    rig = small_rig()
    turn = np.rad2deg(size * np.array([0.6, -0.64, 0.48]))

    def effector(change):
        values = np.concatenate([[0.01, -0.02, 0.03], turn]) + change
        return off(rig, dict(zip(OFFSETS, values, strict=True))).end_effectors["finger"]

    nominal = np.array([0.3, -0.2, 0.1]), Rotation.from_rotvec([0.5, 1.2, -0.8])
    here = effector(np.zeros(6))

    def true(change):
        return with_offsets(rig.model_copy(update={"end_effectors": {"finger": effector(change)}}), {"finger": nominal})

    rotation = true(np.zeros(6))["finger"][1]
    for k, h in enumerate([1e-6] * 3 + [np.rad2deg(1e-6)] * 3):
        (a, turned_a), (b, turned_b) = (true(s * h * np.eye(6)[k])["finger"] for s in (1.0, -1.0))
        step = 2e-6
        moved = rotation.inv().apply(a - b) / step
        turned = ((rotation.inv() * turned_a).as_rotvec() - (rotation.inv() * turned_b).as_rotvec()) / step
        np.testing.assert_allclose(offset_motion(here)[:, k], [*moved, *turned], atol=2e-9)


UNITS = np.array([1e-3] * 3 + [1.0] * 3)
"""A millimetre and a degree, which move what is some centimetres away alike."""


def compare(rig, poses, times, h, bound=1e-6):
    """Forward sensitivities by the six components, in two directions, against central differences of rollouts of
    fourth order, ``h`` wide in mm and deg."""
    (mount,) = poses
    names = [f"{mount}.{key}" for key in OFFSETS]
    trace, derivatives = simulate_tangent(build_scene(rig), poses, times, directions(rig, names), settings=TIGHT)
    here = rig.end_effectors[mount].offset()
    here[3:] = np.rad2deg(here[3:])
    compared = 0
    for direction in ([0.5, -0.6, 0.7, 0.5, -0.6, 0.7] * UNITS, [0.5, 0.6, 0.7, -0.5, -0.6, 0.7] * UNITS):
        ends = []
        for s in (h, -h, 2.0 * h, -2.0 * h):
            there = with_parameters(rig, dict(zip(names, here + s * direction, strict=True)))
            ends.append(simulate(build_scene(there), poses, times, settings=TIGHT).outputs)
        for channel, ours in derivatives.items():
            a, b, c, d = (e[channel] for e in ends)
            central = (8.0 * (a - b) - (c - d)) / (12.0 * h)
            parts = (slice(0, 3), slice(3, 6)) if trace.kinds[channel] == "wrench" else (slice(None),)
            for part in parts:
                scale = np.nanmax(np.abs(central[:, part]))
                if scale > 1e-12 * np.nanmax(np.abs(a)) / h:
                    compared += 1
                    assert np.nanmax(np.abs(ours @ direction - central)[:, part]) < bound * scale, (channel, part)
    assert compared >= 2


def test_forward_against_differences_through_contact(small_rig, visit):
    rig, poses, times = small(RUB, 0.4)(small_rig, visit)
    compare(off(rig), poses, times, 1e-5)


def test_forward_against_differences_of_a_rigid_body():
    """While the card rubs on the ball, as it does near the nominal poses: its torque tells of turns."""
    rig, poses, times = ball()
    scene = build_scene(off(rig, LITTLE))
    assert np.abs(simulate(scene, poses, times).outputs["wrench"][:, 3:]).max() > 1e-5
    compare(scene.rig, poses, times[:-1], 1e-4)


def test_forward_against_differences_of_a_mount_that_carries_joints():
    """The body swings far and its forces are stiff, so that steps are wide."""
    rig, poses, times = swung()
    compare(off(rig), poses, times[:8], 0.5)


@pytest.mark.parametrize("case", ["rub with every effect", "looking back", "static", "ball on an arm", "swung"])
def test_forward_is_the_sum_of_the_pose_gradients(case, small_rig, visit):
    """By the gradients of the poses that the way back gives, summed over the times, which it does itself too."""
    build, changes = CASES[case]
    rig, poses, times = build(small_rig, visit, **changes)
    rig = off(rig, LITTLE if case == "ball on an arm" else OFF)
    (mount,) = poses
    scene = build_scene(rig)
    along = directions(rig, [f"{mount}.{key}" for key in OFFSETS])
    trace, derivatives = simulate_tangent(scene, poses, times, along, settings=TIGHT)
    tape = Tape(scene, poses, times, TIGHT)
    turned = np.diag([1.0] * 3 + [np.pi / 180.0] * 3)
    given, compared = weights(trace), 0
    for channel, w in given.items():
        back = Backward(tape, along).gradient(0.0, {channel: w})
        expected = back.poses[mount].sum(axis=0) @ offset_motion(rig.end_effectors[mount]) @ turned * UNITS
        products = np.nan_to_num(derivatives[channel]) * w[..., None] * UNITS
        size = np.abs(products).reshape(-1, 6).sum(axis=0).max()
        compared += size > 0.0
        for other in (expected, np.array(list(back.parameters.values())) * UNITS):
            assert np.all(np.abs(products.reshape(-1, 6).sum(axis=0) - other) <= 1e-8 * size), channel
    assert compared
