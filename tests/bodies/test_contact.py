"""Affine bodies that touch: friction on slopes, rolling, toppling, stacks, gels and sheets."""

import numpy as np
import pytest
from body_scenes import DENSITY, G, affine, centre, gel, kinetic, plane, run, simulation, velocity
from scipy.spatial.transform import Rotation

MU = 0.4
BLOCK = (0.02, 0.02, 0.01)
TURNS = [Rotation.identity(), *Rotation.random(2, random_state=11)]


def on_slope(shape, turn, dt=0.005, friction=MU, integrator="implicit_euler", height=None, rpy=(0, 0, 0), **more):
    """A body just above a plane, the whole scene turned."""
    height = 0.5 * shape[2] if height is None else height
    place = turn.apply([0.0, 0.0, height + 2.9e-5])
    pose = (turn * Rotation.from_euler("xyz", rpy, degrees=True)).as_euler("xyz", degrees=True)
    bodies = {"plane": plane(turn.as_euler("xyz", degrees=True)), "b": affine(shape, place, pose, **more)}
    contact = {"between": ["b", "plane"], "friction": friction}
    return simulation(bodies, dt, integrator, turn.apply([0.0, 0.0, -G]), contacts=[contact])


def tilt(sim, turn, slope, heading=0.0):
    """Tilt gravity; the direction down the slope in the world."""
    down = np.array([np.cos(heading), np.sin(heading), 0.0])
    sim.scene.system.gravity = turn.apply(G * (np.sin(slope) * down - np.cos(slope) * np.array([0.0, 0.0, 1.0])))
    sim.refresh()
    return turn.apply(down)


@pytest.mark.parametrize("turn", TURNS, ids=["upright", "turned", "turned again"])
@pytest.mark.parametrize("heading", [0.3, 2.5])
def test_a_block_slips_if_and_only_if_the_slope_exceeds_the_friction_by_one_percent(turn, heading):
    for ratio in (0.99, 1.01, 1.5):
        sim = on_slope(BLOCK, turn)
        run(sim, 30)
        slope = np.arctan(ratio * MU)
        down = tilt(sim, turn, slope, heading)
        path = run(sim, 60, lambda s: centre(s, "b")) @ down
        if ratio < 1.0:
            assert np.abs(np.diff(path[10:])).max() < 1e-10
        else:
            acceleration = np.diff(path[20:], 2) / 0.005**2
            np.testing.assert_allclose(acceleration, G * (np.sin(slope) - MU * np.cos(slope)), rtol=1e-3)


def test_stopping_distance():
    """v^2 / (2 mu g), less v dt / 2 of implicit Euler, and v dt for the first step, before which no load is known."""
    dt, v = 0.002, 0.5
    along = TURNS[1].apply([np.cos(1.0), np.sin(1.0), 0.0])
    sim = on_slope(BLOCK, TURNS[1], dt, velocity_m_s=list(v * along))
    start = centre(sim, "b")
    run(sim, 130)
    moved = (centre(sim, "b") - start) @ along
    assert moved == pytest.approx(v**2 / (2.0 * MU * G) + 0.5 * v * dt, rel=2e-3)
    assert np.abs(velocity(sim, "b")).max() < 1e-9


@pytest.mark.parametrize(
    "shape, share, edge, rpy",
    [(0.01, 5.0 / 7.0, 0.001, (0, 0, 0)), ((0.01, 0.01), 2.0 / 3.0, 0.0005, (90, 0, 0))],
    ids=["ball", "cylinder"],
)
def test_rolling_down_a_slope(shape, share, edge, rpy):
    """5/7 (a ball) and 2/3 (a cylinder) of g sin(slope), by bdf2 of 1 ms, within 1.5 %: the facets, of a tenth and a
    twentieth of the radius, take the rest. It does not slide."""
    slope, dt = np.deg2rad(20.0), 0.001
    sim = on_slope(shape, TURNS[0], dt, 1.0, "bdf2", 0.01, rpy, edge_m=edge)
    down = tilt(sim, TURNS[0], slope)
    speeds = run(sim, 120, lambda s: velocity(s, "b")) @ down
    acceleration = np.polyfit(dt * np.arange(24, 120), speeds[24:], 1)[0]
    assert acceleration == pytest.approx(share * G * np.sin(slope), rel=0.015)


@pytest.mark.parametrize("width, falls", [(0.0115, True), (0.0125, False)])
def test_a_block_topples_where_its_weight_passes_its_edge(width, falls):
    """tan(slope) = width / height at 0.012 m for this slope, high friction: 4 % to both sides."""
    height = 0.03
    slope = np.arctan(0.012 / height)
    sim = on_slope((width, 0.02, height), TURNS[1], 0.005, 2.0)
    run(sim, 20)
    tilt(sim, TURNS[1], slope)
    run(sim, 60)
    turned = (TURNS[1].inv() * sim.scene.pose_of("b", sim.state.x)[1]).magnitude()
    assert (turned > 0.3) if falls else (turned < 0.01)


def wrench(on):
    return {"type": "wrench", "on": on, "rate_hz": 100.0, "topic": f"load/{on}"}


def test_a_stack_of_two_blocks_rests_and_bears_their_weights():
    """In the frames of the bodies; the upper one turned and off the middle."""
    weight = DENSITY * np.prod(BLOCK) * G
    sim = simulation(
        {
            "plane": plane(),
            "low": affine(BLOCK, (0.0, 0.0, 0.005 + 2e-5)),
            "high": affine(BLOCK, (0.003, 0.002, 0.015 + 4e-5), (0.0, 0.0, 20.0)),
        },
        contacts=[{"between": ["low", "plane"], "friction": 0.5}, {"between": ["high", "low"], "friction": 0.5}],
        sensors={f"on_{n}": wrench(n) for n in ("plane", "low", "high")},
    )
    run(sim, 60)
    read = sim.read()
    assert read["on_plane"][2] == pytest.approx(-2.0 * weight, rel=1e-6)
    assert read["on_low"][2] == pytest.approx(weight, rel=1e-5)
    assert read["on_high"][2] == pytest.approx(weight, rel=1e-5)
    np.testing.assert_allclose(read["on_high"][3:], 0.0, atol=1e-6 * weight)
    # The plane's origin is below the lower block's middle: the upper weight turns about it.
    np.testing.assert_allclose(read["on_plane"][3:5], weight * np.array([-0.002, 0.003]), rtol=0.01)
    assert kinetic(sim) < 1e-20


def test_a_ball_dropped_on_a_gel_comes_to_rest_on_it():
    radius = 0.006
    sim = simulation(
        {
            "pad": gel((0.03, 0.03, 0.01), (4, 4, 2), (0.0, 0.0, -0.005), bonded="bottom", mount="world"),
            "ball": affine(radius, (0.001, 0.0, radius + 0.005)),
        },
        contacts=[{"between": ["ball", "pad"], "friction": 0.5}],
        sensors={"on_ball": wrench("ball"), "on_pad": wrench("pad")},
    )
    rest, glued = sim.read()["on_pad"][2], sim.scene.holders["pad.bond"]
    run(sim, 100)
    weight = DENSITY * 4.0 / 3.0 * np.pi * radius**3 * G
    force = sim.scene.pose_of("ball", sim.state.x)[1].apply(sim.read()["on_ball"][:3])
    np.testing.assert_allclose(force, [0.0, 0.0, weight], atol=0.03 * weight)
    assert abs(centre(sim, "ball")[2] - radius) < 2e-4
    own = G * sim.scene.system.mass[glued].sum()  # nothing is strained at the start: the plate bears what it holds
    assert rest == pytest.approx(-own, rel=1e-9)


def grip(card, friction):
    end = {n: {"topics": {"target_pose": f"{n}/target", "current_pose": f"{n}/current"}} for n in ("left", "right")}
    pads = {
        name: gel((0.004, 0.012, 0.012), (1, 2, 2), (side * 0.006, 0.0, 0.0), bonded=face, mount=name)
        for name, side, face in (("left", -1.0, "x_min"), ("right", 1.0, "x_max"))
    }
    bodies = {"pad_left": pads["left"], "pad_right": pads["right"], "card": card}
    contacts = [{"between": ["card", f"pad_{n}"], "friction": friction} for n in end]
    return simulation(bodies, 0.01, gravity=(0.0, 0.0, 0.0), end_effectors=end, contacts=contacts)


@pytest.mark.parametrize("friction, holds", [(0.6, True), (0.0, False)])
def test_a_stiff_card_is_held_between_two_gels_and_lifted(friction, holds):
    """The pads close; then gravity is switched on, and they go up by 10 mm."""
    sim = grip(affine((0.0003, 0.02, 0.03)), friction)
    turn = Rotation.identity()
    for k in range(80):
        near, lift = min(0.001 * k, 0.0041), min(max(k - 20, 0) * 0.0005, 0.01)
        if k == 16:
            sim.scene.system.gravity = np.array([0.0, 0.0, -G])
            sim.refresh()
        report = sim.step({n: (np.array([s * near, 0.0, lift]), turn) for n, s in (("left", 1), ("right", -1))}, 0.005)
        assert report.min_gap_m > 0.0
    height = centre(sim, "card")[2]
    assert (height == pytest.approx(0.01, abs=5e-5)) if holds else height < -0.05


def test_markers_on_a_body_follow_it():
    """In the frame where the body started, and as seen by a camera of the world."""
    points = {"positions_m": [[0.01, 0.0, 0.0], [0.0, 0.01, 0.005]]}
    pose = {"position_m": [0.0, 0.0, -1.0]}
    camera = {
        "model": "pinhole", "width_px": 640, "height_px": 480, "fx_px": 500.0, "fy_px": 500.0, "cx_px": 320.0,
        "cy_px": 240.0, "pose": pose, "sees": [{"body": "b", "points": points}], "rate_hz": 30.0,
    }  # fmt: skip
    sim = simulation(
        {"b": affine(BLOCK, (0.1, 0.0, 0.0), (0.0, 0.0, 90.0), angular_velocity_deg_s=[0.0, 0.0, 90.0])},
        0.001, "bdf2", (0.0, 0.0, 0.0),
        sensors={"m": {"type": "markers", "body": "b", "points": points, "rate_hz": 30.0, "topic": "m"}},
        cameras={"eye": camera},
    )  # fmt: skip
    run(sim, 200)
    turn = Rotation.from_euler("z", 18.0, degrees=True)
    local = turn.apply(points["positions_m"])
    read = sim.read()
    np.testing.assert_allclose(read["m"], local, atol=2e-6)
    world = Rotation.from_euler("z", 90.0, degrees=True).apply(local) + [0.1, 0.0, 1.0]
    np.testing.assert_allclose(read["eye"], 500.0 * world[:, :2] / world[:, 2:] + [320.0, 240.0], atol=2e-3)
    assert sim.scene.pose_of("b", sim.state.x)[1].as_euler("xyz", degrees=True)[2] == pytest.approx(108.0, abs=0.02)
