"""Nothing passes through anything, at moves of 2 mm a step and sheets of 0.2 mm; an oracle of its own looks on."""

import itertools
import re

import numpy as np
import pytest
from crossing import crossings_of
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError, ConvergenceError
from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.scene.assembly import contact_triangles
from sim_core.scene.contact_constants import REST_ON_GEL, WIDEST_M
from sim_core.simulate import Simulation
from sim_core.solve.report import NewtonSettings

STEP = 2e-3
DT = 0.01


def sheet(length, width, cells, position=(0, 0, 0), rpy=(0, 0, 0), E_pa=1e8):
    return {
        "type": "sheet",
        "shape": {"type": "rectangle", "length_m": length, "width_m": width, "cells": cells, "pattern": "crossed"},
        "pose": {"position_m": [float(p) for p in position], "rpy_deg": [float(a) for a in rpy]},
        "material": {"E_pa": E_pa, "nu": 0.3, "thickness_m": 2e-4, "density_kg_m3": 800.0},
    }


def clamp(name, body, x_m, mount="world"):
    return {"name": name, "body": body, "region": {"x_m": x_m}, "mount": mount}


def rigid(shape, position=(0, 0, 0), rpy=(0, 0, 0), mount="world", **size):
    pose = {"position_m": list(position), "rpy_deg": list(rpy)}
    return {"type": "rigid", "shape": {"type": shape, **size}, "pose": pose, "mount": mount}


def scene_of(bodies, contacts, clamps=(), hand=None, friction=0.3):
    return build_scene(
        parse_rig(
            {
                "name": "crowd",
                "solver": {"dt_s": DT},
                "bodies": bodies,
                "clamps": list(clamps),
                "end_effectors": {} if hand is None else {"hand": {"start": {"position_m": list(hand)}}},
                "contacts": [{"between": list(pair), "friction": friction} for pair in contacts],
            },
            "test",
        )
    )


class Watch:
    """Steps a scene; every step must leave gaps and cross nothing."""

    def __init__(self, scene, settle=True):
        self.simulation = Simulation(scene, settle=settle)
        self.scene = scene
        self.triangles = [contact_triangles(b) for b in scene.bodies.values() if b.mesh is not None]
        self.most = 0

    def step(self, position=None, turn=None):
        frames = {} if position is None else {"hand": (np.asarray(position), turn or Rotation.identity())}
        report = self.simulation.step(frames, DT)
        assert report.min_gap_m > 0.0
        assert crossings_of(self.simulation.state.x, *self.triangles) == 0
        self.most = max(self.most, report.contacts)
        return report


def test_the_oracle_sees_a_crossing():
    triangles = np.array([[0, 1, 2], [3, 4, 5]])
    x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.3, 1], [5, 5, 0.5]], dtype=float)
    assert crossings_of(x, triangles) == 2
    assert crossings_of(x + np.outer([0, 0, 0, 1, 1, 1], [0, 0, 2.0]), triangles) == 0


def folded(bodies=(), contacts=()):
    """A sheet whose lip has gone over in a half circle and then to above the middle of the lower layer."""
    scene = scene_of(
        {"sheet": sheet(0.08, 0.02, [16, 4]), **dict(bodies)},
        [("sheet", "sheet"), *contacts],
        [clamp("base", "sheet", [-0.04, -0.03]), clamp("lip", "sheet", [0.034, 0.04], "hand")],
        (0.04, 0.0, 0.0),
    )
    watch = Watch(scene)
    count = int(np.ceil(np.pi * 0.04 / STEP))
    for a in np.pi * np.arange(1, count + 1) / count:
        watch.step([0.04 * np.cos(a), 0.0, 0.04 * np.sin(a) + 0.002 * a / np.pi], Rotation.from_rotvec([0, -a, 0]))
    for k in range(1, 7):
        watch.step([-0.04 + STEP * k, 0.0, 0.002], OVER)
    return watch


OVER = Rotation.from_rotvec([0, -np.pi, 0])


def test_a_sheet_folded_on_itself_is_pressed_flat_and_dragged():
    watch = folded({"table": rigid("plane", (0.0, 0.0, -1.5e-4))}, [("sheet", "table")])
    watch.step([-0.028, 0.0, 2.2e-4], OVER)
    assert watch.most > 10
    for k in range(1, 5):
        watch.step([-0.028 + STEP * k, 0.0, 2.2e-4], OVER)


def test_one_layer_of_a_folded_sheet_takes_the_other_along():
    """The lip goes down through where the lower layer was, 2 mm a step."""
    watch = folded()
    for k in range(1, 6):
        watch.step([-0.028, 0.0, 0.002 - STEP * k], OVER)
    x, lip = watch.simulation.state.x, watch.scene.holders["lip"]
    under = np.abs(x[:, 0] - x[lip, 0].mean()) < 2e-3
    under[lip] = False
    assert watch.most > 3
    assert under.any()
    assert (x[under, 2] < x[lip, 2].min() - 1.9e-4).all()


@pytest.mark.parametrize("rpy", [((0, 0, 0), (0, 0, 90)), ((90, 0, 0), (90, 0, 90))], ids=["flat", "edge on edge"])
def test_crossing_strips_hold_each_other(rpy):
    """One is driven down on the other; standing on edge only their borders meet, far from any node."""
    strips = {
        "a": sheet(0.04, 0.008, [8, 2], rpy=rpy[0]),
        "b": sheet(0.04, 0.008, [8, 2], (7e-4, 3e-4, 0.02), rpy[1]),
    }
    ends = {"left": [-0.02, -0.015], "right": [0.015, 0.02]}
    clamps = [clamp(f"{b}_{e}", b, x, m) for b, m in (("a", "world"), ("b", "hand")) for e, x in ends.items()]
    scene = scene_of(strips, [("a", "b")], clamps, (0.0, 0.0, 0.02))
    watch = Watch(scene)
    for k in range(1, 8 if rpy[0][0] else 12):
        watch.step([0.0, 0.0, 0.02 - STEP * k])
    x = watch.simulation.state.x
    a, b = scene.bodies["a"].nodes, scene.bodies["b"].nodes
    assert watch.most >= 1
    assert watch.simulation.contact_forces()["a-b"][b, 2].sum() > 0.01  # the lower one carries the upper one
    middle = [x[n][np.linalg.norm(x[n][:, :2], axis=1) < 4e-3, 2].mean() for n in (a, b)]
    assert middle[1] > middle[0]


def test_a_sheet_is_pulled_over_the_edge_of_a_box():
    """The edges of the box run between the nodes of the sheet; none of them comes through."""
    scene = scene_of(
        {
            "sheet": sheet(0.08, 0.02, [8, 2], (0, 0, 0.0105)),
            "box": rigid("box", size_m=[0.02, 0.03, 0.02], rpy=(0, 0, 7)),
        },
        [("sheet", "box")],
        [clamp("left", "sheet", [-0.04, -0.032]), clamp("right", "sheet", [0.032, 0.04], "hand")],
        (0.04, 0.0, 0.0105),
    )
    watch = Watch(scene)
    for k in range(1, 11):
        watch.step([0.04 - 0.0012 * k, 0.0, 0.0105 - 0.0016 * k])
    triangles = watch.triangles[0]
    corners = watch.simulation.state.x[triangles]
    share = np.random.default_rng(3).dirichlet([1.0, 1.0, 1.0], 400)
    points = np.einsum("pk,tkj->tpj", share, corners).reshape(-1, 3)
    local = Rotation.from_euler("z", 7, degrees=True).inv().apply(points)
    inside = np.all(np.abs(local) < np.array([0.01, 0.015, 0.01]) - 2e-4, axis=1)  # but for the rounding
    assert not inside.any()
    assert watch.most >= 2


def test_the_corner_of_a_box_does_not_come_through_a_large_triangle():
    turned, aside = (45.0, 35.26, 0.0), np.array([4e-3, 2.5e-3])
    scene = scene_of(
        {
            "sheet": sheet(0.06, 0.06, [4, 4], (0, 0, 0.02)),
            "box": rigid("box", size_m=[0.01] * 3, rpy=turned, mount="hand"),
        },
        [("sheet", "box")],
        [clamp("left", "sheet", [-0.03, -0.018]), clamp("right", "sheet", [0.018, 0.03])],
        (*aside, 0.0),
    )
    watch = Watch(scene)
    for k in range(1, 9):
        watch.step([*aside, STEP * k])
    cube = np.array(list(itertools.product((-0.0048, 0.0048), repeat=3)))  # but for the rounding
    corners = Rotation.from_euler("xyz", turned, degrees=True).apply(cube)
    tip = corners[np.argmax(corners[:, 2])] + [*aside, 0.016]
    heights = []
    for a, b, c in watch.simulation.state.x[watch.triangles[0]]:
        try:
            u, v = np.linalg.solve(np.column_stack([b - a, c - a])[:2], tip[:2] - a[:2])
        except np.linalg.LinAlgError:
            continue
        if min(u, v, 1.0 - u - v) >= 0.0:
            heights.append((a + u * (b - a) + v * (c - a))[2])
    assert watch.most >= 1
    assert min(heights) > tip[2]


@pytest.mark.parametrize(
    ("shape", "size", "rpy", "round_m"),
    [
        ("sphere", {"radius_m": 1.5e-3}, (0, 0, 0), 1.5e-3),
        ("cylinder", {"radius_m": 1e-3, "length_m": 0.02}, (90, 0, 30), 1e-3),
    ],
)
def test_a_peg_smaller_than_a_cell_does_not_come_through(shape, size, rpy, round_m):
    """It meets the sheet between its nodes; no point of the sheet ends within it."""
    scene = scene_of(
        {"sheet": sheet(0.06, 0.06, [4, 4], (0, 0, 0.004)), "peg": rigid(shape, rpy=rpy, mount="hand", **size)},
        [("sheet", "peg")],
        [clamp("left", "sheet", [-0.03, -0.018]), clamp("right", "sheet", [0.018, 0.03])],
        (4e-3, 2.5e-3, 0.0),
    )
    watch = Watch(scene)
    for k in range(1, 5):
        watch.step([4e-3, 2.5e-3, STEP * k])
    share = np.random.default_rng(3).dirichlet([1.0, 1.0, 1.0], 4000)
    points = np.einsum("pk,tkj->tpj", share, watch.simulation.state.x[watch.triangles[0]]).reshape(-1, 3)
    local = Rotation.from_euler("xyz", rpy, degrees=True).inv().apply(points - [4e-3, 2.5e-3, STEP * 4])
    if shape == "cylinder":
        local[:, 2] -= np.clip(local[:, 2], -0.009, 0.009)
    assert np.linalg.norm(local, axis=1).min() > round_m + 1e-4
    assert watch.most >= 1


@pytest.mark.parametrize("seed", [0, 1])
def test_sheets_dropped_at_random_never_cross(seed):
    rng = np.random.default_rng(seed)
    names = ["low", "high"]
    bodies = {}
    for k, name in enumerate(names):
        at = [*rng.uniform(-4e-3, 4e-3, 2), 0.012 + 0.012 * k]
        bodies[name] = sheet(0.03, 0.02, [6, 4], at, [14, 14, 90] * rng.uniform(-1, 1, 3), E_pa=2e7)
    bodies |= {"table": rigid("plane"), "box": rigid("box", size_m=[0.01] * 3, rpy=(0, 0, 20))}
    contacts = [*itertools.product(names, ("table", "box")), *itertools.combinations_with_replacement(names, 2)]
    watch = Watch(scene_of(bodies, contacts), settle=False)
    for _ in range(25):
        watch.step()
    assert watch.most > 10


@pytest.mark.parametrize("move", [STEP, 0.03], ids=["2 mm a step", "30 mm at once"])
def test_a_push_through_a_pad_ends_in_words(move):
    pad = {
        "type": "gel",
        "shape": {"type": "block", "size_m": [0.012, 0.012, 0.004], "cells": [1, 1, 1]},
        "pose": {"position_m": [0.0, 0.0, 0.002]},
        "material": {"E_pa": 2e5, "nu": 0.45, "density_kg_m3": 1000.0},
        "bonded": "bottom",
        "mount": "world",
    }
    plate = rigid("plane", rpy=(180, 0, 0), mount="hand")
    simulation = Simulation(scene_of({"pad": pad, "plate": plate}, [("pad", "plate")], hand=(0.0, 0.0, 0.005)))
    with pytest.raises(ConvergenceError) as caught:
        for k in range(1, 16):
            simulation.step({"hand": (np.array([0.0, 0.0, 0.005 - move * k]), Rotation.identity())}, DT)
    for word in ("pad would turn inside out near", "hand has made", "mm of this step"):
        assert word in str(caught.value)
    displaced = REST_ON_GEL * WIDEST_M  # what contact takes out of the geometry
    made, whole = map(float, re.search(r"has made ([\d.]+) of the ([\d.]+) mm", str(caught.value)).groups())
    assert whole == pytest.approx(1e3 * move)
    before = simulation.frames["hand"][0][2]  # the step that failed was taken back
    assert before == pytest.approx(0.005 - move * (k - 1))
    assert -displaced < before - 1e-3 * made < 0.0035
    assert simulation.state.x[scene_nodes(simulation, "pad"), 2].max() < before + displaced


@pytest.mark.parametrize("fast_iterations", [20, 0], ids=["fast first", "guarded only"])
def test_a_plate_that_tilts_takes_the_sheet_over_it_along(fast_iterations):
    """It turns about its own origin: at the end of the sheet that is 5 mm in one step."""
    bodies = {"sheet": sheet(0.08, 0.02, [8, 2], (0.02, 0.0, 4e-4)), "plate": rigid("plane", mount="hand")}
    scene = scene_of(bodies, [("sheet", "plate")], [clamp("vice", "sheet", [-0.04, -0.02])], hand=(0.0, 0.0, 0.0))
    simulation = Simulation(scene, NewtonSettings(fast_iterations=fast_iterations))
    for degrees in (-5.0, -10.0, -4.0):
        turn = Rotation.from_euler("y", degrees, degrees=True)
        report = simulation.step({"hand": (np.zeros(3), turn)}, DT)
        assert report.min_gap_m > 0.0
        above = turn.inv().apply(simulation.state.x[scene_nodes(simulation, "sheet")])[:, 2]
        assert above.min() > 1e-4
    assert simulation.state.x[scene_nodes(simulation, "sheet"), 2].max() > 5e-3


def scene_nodes(simulation, body):
    return simulation.scene.bodies[body].nodes


def test_the_same_bits_twice():
    def run():
        bodies = {"low": sheet(0.03, 0.02, [5, 3], (0, 0, 1.5e-3), (3, 2, 0)), "table": rigid("plane")}
        simulation = Simulation(scene_of(bodies, [("low", "table"), ("low", "low")]), settle=False)
        for _ in range(8):
            simulation.step({}, DT)
        return simulation.state.x.tobytes()

    assert run() == run()


def test_a_scene_that_is_used_again_forgets_what_was_before():
    bodies = {
        "low": sheet(0.03, 0.02, [5, 3], (0, 0, 1.5e-3), (3, 2, 0)),
        "box": rigid("box", size_m=[0.05, 0.05, 1e-3], mount="hand"),
    }
    scene = scene_of(bodies, [("low", "box")], hand=(0.0, 0.0, 0.0))
    simulation = Simulation(scene, settle=False)
    tilted = {"hand": (np.array([0.0, 0.0, 1e-4]), Rotation.from_euler("x", 1.5, degrees=True))}

    def run():
        simulation.reset(tilted)
        found = [simulation.reactions()]
        for _ in range(4):
            simulation.step(tilted, DT)
            found.append(simulation.state.x)
        return np.concatenate(found).tobytes()

    first = run()
    simulation.reset()
    simulation.step({"hand": (np.array([0.0, 0.0, 5e-4]), Rotation.from_euler("x", -3, degrees=True))}, DT)
    assert run() == first


def test_cells_smaller_than_the_thickness_are_refused_for_self_contact():
    with pytest.raises(ConfigError, match="Use fewer cells"):
        scene_of({"sheet": sheet(0.004, 0.004, [20, 20])}, [("sheet", "sheet")])


def test_bodies_that_go_through_each_other_at_the_start_are_refused():
    pair = {"a": sheet(0.02, 0.02, [3, 3]), "b": sheet(0.02, 0.02, [3, 3], (1e-3, 0, 5e-3), (60, 0, 0))}
    with pytest.raises(ConfigError, match="a and b go through each other"):
        scene_of(pair, [("a", "b")])
    pair["b"]["pose"]["position_m"][2] = 0.0205
    scene_of(pair, [("a", "b")])
