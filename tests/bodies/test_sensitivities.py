"""Forward sensitivities of rollouts with affine bodies, against central differences of whole rollouts."""

import numpy as np
import pytest
from body_scenes import G, affine, gel, plane, rig_of

from sim_core.gradients import simulate_tangent
from sim_core.rigs import list_parameters, resolve_name, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times


def marked(body):
    points = {"positions_m": [[0.004, 0.0, 0.0], [0.0, 0.004, 0.002]]}
    return {"type": "markers", "body": body, "points": points, "rate_hz": 50.0, "topic": f"points/{body}"}


def load(on):
    return {"type": "wrench", "on": on, "rate_hz": 50.0, "topic": f"load/{on}"}


def pushed():
    """A block on a gel, which slides under it."""
    return rig_of(
        {
            "pad": gel((0.03, 0.02, 0.006), (3, 2, 1), (0.0, 0.0, -0.003), bonded="bottom", mount="hand"),
            "block": affine((0.012, 0.01, 0.008), (0.0, 0.0, 0.004 + 1.5e-5), density=7800.0),
        },
        0.01,
        contacts=[{"between": ["block", "pad"], "friction": 0.4}],
        end_effectors={"hand": {}},
        sensors={"points": marked("block"), "load": load("hand")},
    )


def swung():
    """A rod on a hinge that is shaken, with a bob on a ball joint."""
    end = [0.0, 0.0, 0.02]
    return rig_of(
        {"rod": affine((0.01, 0.01, 0.04), (0.0, 0.0, -0.02)), "bob": affine((0.01, 0.02, 0.04), (0.0, 0.0, -0.06))},
        0.01,
        "bdf2",
        joints=[
            {"type": "hinge", "body": "rod", "to": "hand", "at_m": end, "axis": [0.0, 1.0, 0.0]},
            {"type": "ball", "body": "bob", "to": "rod", "at_m": end},
        ],
        end_effectors={"hand": {}},
        sensors={"points": marked("bob"), "load": load("hand")},
    )


def path(distance):
    times = np.array([0.0, 0.1, 0.3, 0.4])
    positions = np.outer([0.0, 0.0, 1.0, 1.0], [distance, 0.0, 0.0])
    return {"hand": PoseTrajectory(times, positions, np.tile([0.0, 0.0, 0.0, 1.0], (4, 1)))}


def thrown():
    """A block that slides on a table and slows down, for 0.12 s."""
    block = affine((0.012, 0.01, 0.008), (0.0, 0.0, 0.004 + 2.9e-5), velocity_m_s=[0.5, 0.0, 0.0])
    return rig_of(
        {"table": plane(), "block": block},
        0.002,
        contacts=[{"between": ["block", "table"], "friction": 0.4}],
        end_effectors={"hand": {}},
        sensors={"points": marked("block"), "load": load("block")},
    )


CASES = [
    (pushed, 0.03, "block.density_kg_m3", 2e-3),
    (thrown, 0.0, "contacts.block-table.friction", 2e-3),
    (pushed, 0.03, "pad.E_pa", 5e-3),
    (swung, 0.01, "bob.density_kg_m3", 1e-3),  # loads less well, see docs/design/free_bodies.md
]


@pytest.mark.parametrize("make, distance, name, tolerance", CASES, ids=[f"{c[0].__name__}-{c[2]}" for c in CASES])
def test_derivatives_of_markers_and_loads(make, distance, name, tolerance):
    rig, poses, step, wide = make(), path(distance), 1e-6, 1e-2
    times = step_times(0.0, 0.12 if make is thrown else 0.4, rig.solver.dt_s)
    value = next(p.value for p in list_parameters(rig) if p.name == name)
    neighbour = with_parameters(rig, {name: value * (1.0 + step)})
    _, derivatives = simulate_tangent(build_scene(rig), poses, times, [neighbour], [step])
    low, high = (
        simulate(build_scene(with_parameters(rig, {name: value * (1.0 + s * wide)})), poses, times) for s in (-1, 1)
    )
    if make is thrown:
        # The way is v t - mu g t^2 / 2.
        np.testing.assert_allclose(derivatives["points"][-1, :, 0, 0], -0.5 * 0.4 * G * 0.12**2, rtol=0.02)
    for channel in ("points", "load"):
        central = (high.outputs[channel] - low.outputs[channel]) / (2.0 * wide)
        ours = derivatives[channel][..., 0]
        if channel == "load":
            if make is thrown:
                continue
            central, ours = central[:, :3], ours[:, :3]
            tolerance = 0.06 if make is swung else tolerance
        scale = np.abs(central).max()
        assert scale > 1e-6
        assert np.abs(ours - central).max() < tolerance * scale, channel


def test_density_is_a_parameter_with_the_type_as_a_short_name():
    rig = pushed()
    assert resolve_name(rig, "affine.density") == "block.density_kg_m3"
    scene, heavy = build_scene(rig), with_parameters(rig, {"block.density": 15600.0})
    mass = scene.system.mass[scene.bodies["block"].control].sum()
    scene.use(heavy)
    assert scene.system.mass[scene.bodies["block"].control].sum() == pytest.approx(2.0 * mass, rel=1e-12)
