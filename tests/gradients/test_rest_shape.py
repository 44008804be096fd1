"""Shapes at rest that are set, and gradients by them: against scenes built from such meshes, and differences of
rollouts; what a rigid motion of a shape does; a shape that hangs straight."""

from __future__ import annotations

import numpy as np
import pytest
from explicit_contact import explicit_contact
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from test_adjoint import EFFECTS, TIGHT, weights
from test_fields import BALL, SCENES, uneven
from test_fields_of_materials import pad

from sim_core.errors import ConfigError
from sim_core.geometry.sheets import SheetMesh
from sim_core.geometry.solids import TetMesh
from sim_core.gradients import Backward, Tape, simulate_adjoint
from sim_core.rigs import load_rig, parse_rig
from sim_core.rigs.motion import compile_experiment, load_experiment
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import assembly, build_scene
from sim_core.simulate import Simulation, simulate


def sagging(inertia, **sheet):
    """A card in the base's grip at one end, and nothing else but its weight."""
    return parse_rig(
        {
            "name": "sagging",
            "solver": {"dt_s": 0.01, "inertia": inertia, "integrator": "bdf2" if inertia else "implicit_euler"},
            "bodies": {
                "card": {
                    "type": "sheet",
                    "shape": {"type": "rectangle", "length_m": 0.08, "width_m": 0.03, "cells": [8, 3], **sheet},
                    "material": {"E_pa": 2.0e9, "nu": 0.3, "thickness_m": 2.0e-4, "density_kg_m3": 700.0},
                }
            },
            "clamps": [{"name": "vice", "body": "card", "region": {"x_m": [-0.04, -0.03]}, "mount": "hand"}],
            "end_effectors": {"hand": {}},
            "sensors": {
                "load": {"type": "wrench", "on": "hand"},
                "shape": {"type": "markers", "body": "card", "points": {"grid": [5, 3]}},
            },
        },
        "sagging",
    )


def held_or_shaken(inertia, **sheet):
    shake = [[0, 0, 0], [0, 0, 0.003], [0, 0.001, -0.003]] if inertia else np.zeros((3, 3))
    turned = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    poses = {"hand": PoseTrajectory(np.array([0.0, 0.03, 0.06]), np.array(shake, dtype=float), turned)}
    return sagging(inertia, **sheet), poses, np.linspace(0.0, 0.06 if inertia else 0.02, 7 if inertia else 3)


def shapes_of(scene):
    return [name for name in scene.fields.names if name.endswith("rest_m")]


def shake(scene, size_m, seed=0):
    """Move all nodes of all shapes at random, mid-side nodes too."""
    rng = np.random.default_rng(seed)
    for name in shapes_of(scene):
        scene.fields[name] = scene.fields[name] + size_m * rng.standard_normal(scene.fields[name].shape)


def check(scene, poses, times, bound, singles=2, steps=(1e-7, 1e-8)):
    """Gradients by all shapes against differences of fourth order along a random direction, by the node that counts
    most and by others. ``bound``: of the error over the largest derivative along as long a direction."""
    tape = Tape(scene, poses, times, TIGHT)
    given = {}
    for c, w in weights(tape.trace).items():
        size = np.abs(tape.trace.outputs[c])
        wrench = tape.trace.kinds[c] == "wrench"
        given[c] = w / (np.repeat([size[:, :3].max(), size[:, 3:].max()], 3) if wrench else np.nanmax(size))
    names, rng = shapes_of(scene), np.random.default_rng(2)
    found = Backward(tape, [], names).gradient(0.0, given).fields
    assert list(found) == names

    def value(name, rest):
        scene.fields[name] = rest
        outputs = simulate(scene, poses, times, settings=TIGHT).outputs
        return sum(np.nansum(outputs[c] * w) for c, w in given.items())

    for name, gradient in found.items():
        here = scene.fields[name]
        assert gradient.shape == here.shape and np.abs(gradient).max() > 0.0
        nodes = [int(np.abs(gradient).max(axis=1).argmax()), *rng.integers(len(here), size=singles)]
        ways = [np.eye(len(here))[node][:, None] * rng.standard_normal(3) for node in nodes]
        for along in (rng.standard_normal(here.shape), *ways):
            errors, expected = [], np.vdot(gradient, along)
            for h in steps:
                ends = [value(name, here + s * h * along) for s in (1, -1, 2, -2)]
                errors.append(abs((8.0 * (ends[0] - ends[1]) - ends[2] + ends[3]) / (12.0 * h) - expected))
                if errors[-1] < bound * np.abs(gradient).max() * np.linalg.norm(along):
                    break
            scene.fields[name] = here
            assert min(errors) < bound * np.abs(gradient).max() * np.linalg.norm(along), (name, nodes, errors, expected)


@pytest.mark.parametrize("pattern", ["regular", "crossed", "irregular"])
@pytest.mark.parametrize("inertia", [False, True])
def test_sagging_card_against_differences_of_rollouts(inertia, pattern):
    rig, poses, times = held_or_shaken(inertia, pattern=pattern)
    scene = build_scene(rig)
    shake(scene, 2e-4)
    check(scene, poses, times, 3e-6, steps=(1e-6, 3e-6, 3e-7))


def test_card_that_is_shaken_in_thick_air_against_differences_of_rollouts():
    """Drag grows with the areas at rest."""
    rig, poses, times = held_or_shaken(True)
    data = rig.model_dump()
    data["effects"] = {"air_drag": {"drag_coefficient": 20.0}}
    scene = build_scene(parse_rig(data, "thick air"))
    shake(scene, 2e-4)
    check(scene, poses, times, 3e-6, singles=1, steps=(1e-6, 3e-6, 3e-7))


def test_the_name_of_a_term_is_of_no_account(monkeypatch):
    """Of the drag's term: the gradient by the shape at rest is the same, and not that without it."""
    from sim_core.energies import air_drag

    rig, poses, times = held_or_shaken(True)
    data, made, found = rig.model_dump(), air_drag.AirDragTerm.__init__, []

    def renamed(self, name, *given):
        made(self, "card.wind" if name.startswith("card.") else name, *given)

    drag = {"air_drag": {"drag_coefficient": 20.0}}
    for effects, rename in ((drag, False), (drag, True), ({}, False)):
        with monkeypatch.context() as patch:
            if rename:
                patch.setattr(air_drag.AirDragTerm, "__init__", renamed)
            scene = build_scene(parse_rig({**data, "effects": effects}, "thick air"))
        tape = Tape(scene, poses, times, TIGHT)
        given = {c: np.ones_like(r) for c, r in tape.trace.outputs.items()}
        found.append(Backward(tape, [], ["card.rest_m"]).gradient(0.0, given).fields["card.rest_m"])
    assert np.array_equal(found[0], found[1])
    assert not np.allclose(found[0], found[2], rtol=1e-6)


def test_folded_card_against_differences_of_rollouts():
    """Folded by more than a right angle: material axes turn with the triangles."""
    folds = [{"at_m": 0.01, "angle_deg": 110.0, "over_m": 0.03}]
    rig, poses, times = held_or_shaken(True, folds=folds)
    data = rig.model_dump()
    data["effects"] = {"sheet_orthotropy": {"modulus_ratio": 2.0, "grain_angle_rad": 0.3}}
    check(build_scene(parse_rig(data, "folded")), poses, times, 1e-5, singles=1, steps=(1e-6, 3e-7, 3e-6))


@pytest.mark.parametrize("case", SCENES)
def test_shapes_through_contact_against_differences_of_rollouts(case, small_rig, visit):
    """With friction, relaxation, plastic flow, dampings, drag, an orthotropic sheet, and all other fields uneven."""
    rig, poses, times = SCENES[case](small_rig, visit, effects=EFFECTS)
    scene = build_scene(rig)
    shake(scene, 5e-5)
    uneven(scene)
    check(scene, poses, times, 1e-5, steps=(3e-7, 1e-6, 3e-6) if case == "unsettled" else (1e-8, 1e-9, 2e-8))


def test_relaxing_gel_that_is_pressed_and_drawn_against_differences_of_rollouts():
    """On a rigid box with rounded edges, with friction; statically."""
    rig, poses, times = pad()
    data = rig.model_dump()
    data["effects"] = {"gel_relaxation": {"share": 0.4, "tau_s": 0.1}}
    scene = build_scene(parse_rig(data, "relaxing"))
    shake(scene, 5e-5)
    check(scene, poses, times, 1e-5, singles=1, steps=(1e-8, 3e-9, 1e-7))


def test_card_press_against_differences_of_rollouts():
    rig = load_rig("card_press")
    poses = compile_experiment(load_experiment("press_hold_release"), rig)
    scene = build_scene(rig)
    shake(scene, 5e-5)
    times = np.arange(0.0, 1.06, rig.solver.dt_s)
    assert simulate(scene, poses, times).reports[-1].contacts > 0
    check(scene, poses, times, 1e-5, singles=0, steps=(3e-8, 1e-7, 1e-8))


@pytest.mark.parametrize("settles", [True, False])
def test_what_follows_a_mount_that_starts_elsewhere(settles, small_rig):
    """The finger starts moved and turned against its start pose; its gel has weight, and is seen from the world."""
    rig = small_rig(effects=EFFECTS)
    data = rig.model_dump()
    seen = {"body": "gel", "points": {"face": "top", "grid": [2, 2]}}
    data["cameras"]["side"]["sees"] = [*data["cameras"]["side"]["sees"], seen]
    if not settles:
        data["bodies"]["ball"] = BALL
    turns = Rotation.from_euler("xyz", [[20, 30, -40], [25, 30, -40], [25, 20, -40]], degrees=True).as_quat()
    path = np.array([0.03, -0.02, 0.08]) + 1e-3 * np.arange(9.0).reshape(3, 3)
    poses = {"finger": PoseTrajectory(np.array([0.0, 0.05, 0.1]), path, turns)}
    scene = build_scene(parse_rig(data, "elsewhere"))
    shake(scene, 5e-5)
    assert scene.all_held == settles
    check(scene, poses, np.linspace(0.0, 0.08, 5), 1e-5, singles=1, steps=(1e-6, 3e-7))


def built_from(rig, scene):
    """A scene whose meshes are the shapes that bodies of ``scene`` have at rest; markers by their material points."""
    draw = assembly._sheet_mesh, assembly.gel_mesh
    bodies = iter([b for b in scene.bodies.values() if b.mesh is not None and b.name != "ball"])

    def sheet(*given):
        return SheetMesh(next(bodies).formed, draw[0](*given).triangles)

    def gel(*given):
        mesh = draw[1](*given)
        return TetMesh(next(bodies).formed, mesh.tets, mesh.surface, mesh.face_sets)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assembly, "_sheet_mesh", sheet)
        patch.setattr(assembly, "gel_mesh", gel)
        built = build_scene(rig)
    for name, body in built.bodies.items():
        body.layout = scene.bodies[name].layout
    return built


@pytest.mark.parametrize("case", ["every effect", "damped, looking back"])
def test_a_shape_that_is_set_is_a_mesh_that_is_built(case, small_rig, visit):
    """With constants of contact that follow the edges of no mesh: those of a shape that is set stay the rig's."""
    rig, poses, times = SCENES[case](small_rig, visit, effects=EFFECTS)
    rig = explicit_contact(rig)
    scene, plain = build_scene(rig), build_scene(rig)
    shake(scene, 1e-4)
    other = built_from(rig, scene)
    assert np.array_equal(other.rest, scene.rest) and np.abs(scene.rest - plain.rest).max() > 1e-4
    found, expected, before = (simulate(s, poses, times, settings=TIGHT).outputs for s in (scene, other, plain))
    for channel, there in expected.items():
        size = np.nanmax(np.abs(there))
        assert np.nanmax(np.abs(found[channel] - there)) < 1e-10 * size
        assert np.nanmax(np.abs(before[channel] - there)) > 1e-4 * size


def test_the_shape_of_the_rig_changes_no_bit(small_rig, visit):
    """Set to what it is, or back to it; values of elements stay with these, and creases with their hinges."""
    rig, poses, times = SCENES["every effect"](small_rig, visit, effects=EFFECTS)
    scene, other = build_scene(rig), build_scene(rig)
    plain, fields = simulate(scene, poses, times[:6]), scene.fields
    for name in shapes_of(scene):
        fields[name] = fields[name]
    same = simulate(scene, poses, times[:6])
    own = fields["card.rest_angle"]
    fields["gel.E"], fields["card.rest_angle"] = 2.0 * fields["gel.E"], own + 1e-3
    shake(scene, 5e-5)
    assert np.all(fields["gel.E"] == 2.0 * other.fields["gel.E"])
    shape = {name: fields[name] for name in shapes_of(scene)}
    for name, rest in shape.items():
        other.fields[name] = rest
    assert fields["card.rest_angle"] == pytest.approx(other.fields["card.rest_angle"] + 1e-3, abs=1e-12)
    assert np.ptp(other.fields["card.rest_angle"]) > 1e-3
    fields.reset()
    again = simulate(scene, poses, times[:6])
    for channel, expected in plain.outputs.items():
        assert np.array_equal(same.outputs[channel], expected, equal_nan=True)
        assert np.array_equal(again.outputs[channel], expected, equal_nan=True)


def stack():
    """A gel that falls on a card in a vice."""
    return parse_rig(
        {
            "name": "stack",
            "solver": {"dt_s": 0.005},
            "bodies": {
                "card": {
                    "type": "sheet",
                    "shape": {"type": "rectangle", "length_m": 0.04, "width_m": 0.02, "cells": [6, 3]},
                    "material": {"E_pa": 2.0e9, "nu": 0.3, "thickness_m": 2.0e-4, "density_kg_m3": 700.0},
                },
                "gel": {
                    "type": "gel",
                    "shape": {"type": "block", "size_m": [0.01, 0.01, 0.005], "cells": [1, 1, 1]},
                    "pose": {"position_m": [0.012, 0.003, 0.00272], "rpy_deg": [0.0, 0.0, 20.0]},
                    "material": {"E_pa": 5.0e4, "nu": 0.4, "density_kg_m3": 1000.0},
                },
            },
            "clamps": [{"name": "vice", "body": "card", "region": {"x_m": [-0.02, -0.013]}}],
            "contacts": [{"between": ["gel", "card"], "friction": 0.4}],
            "sensors": {
                "corners": {
                    "type": "markers",
                    "body": "gel",
                    "points": {"face": "top", "grid": [2, 2]},
                    "topic": "top",
                },
                "shape": {"type": "markers", "body": "card", "points": {"grid": [4, 2]}},
            },
        },
        "stack",
    )


def test_a_rigid_motion_of_all_shapes_moves_what_happens_and_nothing_else():
    """The gradient by a translation is that of moving the readings themselves."""
    rig, times = stack(), np.linspace(0.0, 0.04, 9)
    scene = build_scene(rig)
    shake(scene, 2e-5)
    tape = Tape(scene, {}, times, TIGHT)
    assert tape.trace.reports[-1].contacts > 0
    given = weights(tape.trace)
    found = Backward(tape, [], shapes_of(scene)).gradient(0.0, given).fields
    push = sum(gradient.sum(axis=0) for gradient in found.values())
    for name, w in given.items():
        push = push - rig.bodies[rig.sensors[name].body].pose.rotation().apply(w.reshape(-1, 3)).sum(axis=0)
    assert np.abs(push).max() < 1e-10 * sum(np.abs(gradient).sum() for gradient in found.values())
    for name, rest in [(name, scene.fields[name]) for name in found]:
        scene.fields[name] = rest + [0.1, -0.2, 0.3]
    moved = simulate(scene, {}, times, settings=TIGHT).outputs
    for name, there in tape.trace.outputs.items():
        turn = rig.bodies[rig.sensors[name].body].pose.rotation()
        assert np.abs(moved[name] - there - turn.inv().apply([0.1, -0.2, 0.3])).max() < 1e-9


def test_a_card_that_hangs_straight_is_found():
    """Which shape at rest does a card need that its weight bends flat? Three modes of it, by L-BFGS from flat on; the
    answer is the deflection of a beam, q s^2 (6 l^2 - 4 l s + s^2) / (24 D), upside down."""
    rig, poses, times = held_or_shaken(False)
    scene = build_scene(rig)
    flat, name, length = scene.fields["card.rest"], "card.rest_m", 0.07
    s = np.maximum(flat[:, 0] + 0.03, 0.0) / length
    modes = 1e-2 * np.linalg.qr(np.stack([s**2, s**3, s**4], axis=-1))[0]
    values = []

    def loss(trace):
        """Mean square of the markers' heights [mm^2]."""
        height = 1e3 * trace.outputs["shape"][-1, :, 2]
        by = np.zeros_like(trace.outputs["shape"])
        by[-1, :, 2] = 2e3 * height / height.size
        return float(np.mean(height**2)), {"shape": by}

    def evaluate(amounts):
        scene.fields[name] = flat + [0.0, 0.0, 1.0] * (modes @ amounts)[:, None]
        found = simulate_adjoint(scene, poses, times, loss, [], settings=TIGHT, fields=[name])
        values.append(found.value)
        return found.value, modes.T @ found.fields[name][:, 2]

    result = minimize(evaluate, np.zeros(3), jac=True, method="L-BFGS-B", options={"ftol": 1e-9})
    assert values[0] > 1.0 and result.fun < 2e-5 * values[0] and len(values) <= 20
    card = rig.bodies["card"].material
    q = 9.81 * card.density_kg_m3 * card.thickness_m
    stiff = card.E_pa * card.thickness_m**3 / 12.0
    beam = q * (s * length) ** 2 * (6.0 - 4.0 * s + s**2) * length**2 / (24.0 * stiff)
    assert np.abs(modes @ result.x - beam).max() < 0.05 * beam.max()


def test_shapes_that_cannot_be_used(small_rig, visit):
    scene = build_scene(small_rig())
    fields, simulation = scene.fields, Simulation(scene)
    card, gel = fields["card.rest"], fields["gel.rest_m"]
    assert np.array_equal(fields.places("gel.rest_m"), gel)
    flat, inverted, through = card.copy(), gel.copy(), gel + [0.0, 0.0, -2.5e-3]
    flat[[0, 1]] = card[1]
    inverted[0] = 2.0 * gel.mean(axis=0) - gel[0]
    for name, values, words in (
        ("card.rest_m", 0.0, "values, not an array"),
        ("card.rest_m", card[:-1], "values, not an array"),
        ("gel.rest_m", gel * np.nan, "finite"),
        ("card.rest_m", flat, "without area"),
        ("gel.rest_m", inverted, "inside out"),
        ("gel.rest_m", through, "through each other"),
    ):
        with pytest.raises(ConfigError, match=words):
            fields[name] = values
        assert np.array_equal(fields["card.rest_m"], card) and np.array_equal(fields["gel.rest_m"], gel)
    simulation.step({}, 0.02)
    tape = Tape(scene, visit(*[[0.0, 0.1], [[0, 0, 0], [0, 0, 0]]]), np.array([0.0, 0.02]))
    fields["gel.rest_m"] = gel + [1e-4, 0.0, 0.0]
    for go_on in (simulation.reset, lambda: simulation.step({}, 0.02)):
        with pytest.raises(ConfigError, match="another shape at rest"):
            go_on()
    with pytest.raises(ConfigError, match="another shape at rest"):
        Backward(tape, [], ["gel.rest_m"]).gradient(0.0, {})
    Simulation(scene).step({}, 0.02)


@pytest.mark.parametrize(("friction", "effects"), [(0.0, {}), (0.3, {}), (0.0, EFFECTS)])
def test_first_equilibria_that_depend_on_their_path(friction, effects, small_rig, visit):
    """A card that settles on a post with its end, where it rubs, or over which it yields."""
    data = small_rig(contacts=[{"between": ["card", "post"], "friction": friction}], effects=effects).model_dump()
    data["bodies"]["post"]["pose"] = {"position_m": [0.05, 0.0, 0.05 - 2.5e-4 - 0.02]}
    if effects:
        data["effects"] = {"bending_plasticity": {"yield_curvature_per_m": 0.1, "hardening_ratio": 0.3}}
    scene, poses = build_scene(parse_rig(data, "resting")), visit([0.0, 0.1], [[0, 0, 0], [0, 0, 0]])
    times = np.array([0.0, 0.02])
    tape = Tape(scene, poses, times, TIGHT)
    assert tape.trace.reports[0].contacts > 0
    assert bool(effects) == bool(np.any(tape.start.internals["card.bending"].get("accumulated_curvature", 0.0)))
    check(scene, poses, times, 1e-5, singles=1, steps=(1e-7, 3e-8))
