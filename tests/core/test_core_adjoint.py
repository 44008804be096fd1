"""The adjoint on the compiled core: against its columns, and against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from adjoint_against_columns import TIGHT, compare_with_columns, weights
from scipy.spatial.transform import Rotation
from strip_over_table import LAND, SWING, strip_rig
from strips_that_touch import PRESS_AND_RUB, RIGS
from test_core_columns import EFFECTS, NUMBERS, OF_EFFECTS, PRESSED
from test_core_contact_laws import DRAWN, LAWS
from test_core_gels import PRESSED as GEL_PRESSED
from test_core_gels import SHAKEN, gel_rig
from test_core_gels import TIMES as GEL_TIMES
from test_core_materials import GELS, SHEETS, case, own

from sim_core.core import rollout
from sim_core.gradients import Backward, Tape, directions, simulate_tangent
from sim_core.rigs import list_parameters, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sim_core.solve.report import NewtonSettings

GEL_NUMBERS = ["gel.E_pa", "gel.nu", "gel.density_kg_m3", "gel.stiffness_damping_s", "gel.mass_damping_per_s",
               "gripper.offset_x_m", "gripper.offset_rx_deg", "contacts.gel-table.friction"]  # fmt: skip


def strip(poses, names=NUMBERS, **changes):
    return lambda: (strip_rig(**changes), poses, step_times(0.0, float(poses["gripper"].times[-1]), 0.01), names)


def gel(poses, names=GEL_NUMBERS, **changes):
    return lambda: (gel_rig(**changes), poses, GEL_TIMES, names)


def touching(name):
    rig = RIGS[name]()
    bodies = [n for n in ("strip", "upper", "lower") if n in rig.bodies]
    contacts = [f"contacts.{'-'.join(c.between)}.friction" for c in rig.contacts]
    names = [f"{b}.{q}" for b in bodies for q in ("E_pa", "thickness_m")] + contacts
    return lambda: (rig, PRESS_AND_RUB[name], step_times(0.0, 0.2, 0.01), [*names, "gripper.offset_z_m"])


def material(name):
    body = ["gel.E_pa", "gel.nu"] if name in GELS else ["strip.E_pa", "strip.thickness_m"]
    return lambda: (*case(name), [*own(name), *body, "gripper.offset_z_m"])


def contact_law(name):
    names = [*(f"effects.{name}.{p}" for p in LAWS[name]), "contacts.strip-table.friction", "tray.offset_rx_deg"]
    return strip(DRAWN, names, effects={name: LAWS[name]})


FIRST_ORDER = {"dt_s": 0.01, "inertia": True, "integrator": "implicit_euler"}
STATIC = {"dt_s": 0.01, "inertia": False, "integrator": "bdf2"}

AWAY = {
    "type": "wrench", "on": "gripper", "rate_hz": 100.0,
    "pose": {"position_m": [0.02, -0.03, 0.05], "quaternion_xyzw": [0.6, 0.0, 0.0, 0.8]},
}  # fmt: skip
"""A wrench sensor that stands elsewhere in its mount, and turned."""

CASES = {
    "swing": strip(SWING),
    "pressed": strip(PRESSED),
    "land": strip(LAND),
    "first order": strip(LAND, solver=FIRST_ORDER),
    "static": strip(PRESSED, solver=STATIC),
    "effects": strip(PRESSED, [*NUMBERS[:3], *OF_EFFECTS, "side.fx_px", "side.offset_x_m"], effects=EFFECTS),
    "sensor away from its mount": strip(
        LAND,
        [n for n in NUMBERS if ".offset_" in n],
        sensors={"wrist": AWAY, "under": {**AWAY, "on": "tray", "topic": "tray/wrench"}},
    ),
    "gel shaken": gel(SHAKEN),
    "gel pressed": gel(GEL_PRESSED),
    "gel in balance": gel(GEL_PRESSED, GEL_NUMBERS[:3], solver={"dt_s": 0.005, "inertia": False}),
    **{f"{name} touch": touching(name) for name in RIGS},
    **{name: material(name) for name in [*SHEETS, *GELS]},
    **{name: contact_law(name) for name in LAWS},
}


def summed(values, given):
    return float(np.nansum(values * given))


@pytest.mark.parametrize("name", CASES)
def test_adjoint_is_the_transpose_of_the_columns(name):
    loose = 1e-7 if name == "static" else 1e-9  # round-off, by the condition of what holds a strip in balance
    compare_with_columns(*CASES[name](), loose)


HALVED = NewtonSettings(fast_iterations=1, max_iterations=2, step_tolerance_m=1e-11, force_tolerance=1e-9)
"""So few iterations that the swing turns back in a step that is halved."""


@pytest.mark.parametrize(
    ("name", "settings"), [("land", TIGHT), ("gel pressed", TIGHT), ("first order", TIGHT), ("swing", HALVED)]
)
def test_poses_against_differences_of_rollouts(name, settings):
    """Of both hands at one instant or all, turned and shifted at once."""
    rig, poses, times, _ = CASES[name]()
    scene = build_scene(rig)
    tape = Tape(scene, poses, times, settings)
    assert (max(r.parts for r in tape.trace.reports) > 1) == (settings is HALVED)
    given = weights(tape.trace)
    for channel, w in given.items():
        by_pose = Backward(tape, []).gradient(0.0, {channel: w}).poses
        for mount, trajectory in poses.items():
            positions, quaternions = trajectory.sample(times)
            rng = np.random.default_rng(3)
            move = rng.standard_normal((len(times), 6)) * np.repeat([1e-3, 1e-2], 3)
            move[: len(times) // 2] = 0.0  # the end of the motion alone: without impacts
            move[0] = rng.standard_normal(6) * np.repeat([1e-3, 1e-2], 3)
            errors = []
            for h in (1e-3, 1e-4, 1e-5):
                ends = []
                for s in (h, -h):
                    turns = Rotation.from_quat(quaternions)
                    p = positions + turns.apply(s * move[:, :3])
                    q = (turns * Rotation.from_rotvec(s * move[:, 3:])).as_quat()
                    there = {**poses, mount: PoseTrajectory(times, p, q)}
                    ends.append(summed(simulate(scene, there, times, settings=settings).outputs[channel], w))
                errors.append(abs((ends[0] - ends[1]) / (2.0 * h) - float(np.vdot(by_pose[mount], move))))
            assert min(errors) <= 1e-5 * float(np.abs(by_pose[mount] * move).sum()), (channel, mount)


def test_steps_in_parts():
    """As the columns, which are carried over the parts of steps too."""
    few = NewtonSettings(fast_iterations=1, max_iterations=4)
    rig = strip_rig()
    scene, along = build_scene(rig), directions(rig, ["strip.E_pa", "gripper.offset_z_m", "tray.offset_rx_deg"])
    times = step_times(0.0, 0.4, 0.01)
    tape = Tape(scene, LAND, times, few)
    trace, columns = simulate_tangent(scene, LAND, times, along, settings=few)
    assert max(r.parts for r in tape.trace.reports) > 1
    for channel, w in weights(trace).items():
        found = Backward(tape, along).gradient(0.0, {channel: w}).parameters
        for k, direction in enumerate(along):
            products = np.nan_to_num(columns[channel][..., k]) * w
            # The two rollouts are searched for to 1e-8 m, from tangents that differ.
            assert found[direction.name] == pytest.approx(products.sum(), abs=1e-6 * np.abs(products).sum())


@pytest.mark.parametrize(("case", "allowed"), [("land", 6), ("swing", 2)])
def test_steps_that_were_halved(case, allowed):
    """All parts of them are on the tape, with motions of mounts that turn by up to 7 degrees in a step."""
    few = replace(HALVED, max_iterations=allowed)
    rig, poses, times, names = CASES[case]()
    scene, along = build_scene(rig), directions(rig, names)
    tape, again = Tape(scene, poses, times, TIGHT), Tape(scene, poses, times, few)
    assert max(r.parts for r in again.trace.reports) > 1
    given = weights(tape.trace)
    columns = simulate_tangent(scene, poses, times, along, settings=few)[1]
    found = Backward(again, along).gradient(0.0, given)
    for k, direction in enumerate(along):
        products = [np.nan_to_num(columns[channel][..., k]) * w for channel, w in given.items()]
        size = sum(float(np.abs(p).sum()) for p in products)
        assert found.parameters[direction.name] == pytest.approx(sum(float(p.sum()) for p in products), abs=1e-7 * size)


def test_going_back_in_small_calls_gives_the_same_bits(monkeypatch):
    rig, poses, times, names = CASES["land"]()
    scene, along = build_scene(rig), directions(rig, names)
    tape = Tape(scene, poses, times)
    given = weights(tape.trace)
    whole = Backward(tape, along).gradient(0.0, given)
    monkeypatch.setattr(rollout, "CHUNK_BYTES", 1)
    monkeypatch.setattr("sim_core.gradients.adjoint.CHUNK_BYTES", 1)
    again = Tape(scene, poses, times)
    parts = Backward(again, along).gradient(0.0, given)
    assert whole.parameters == pytest.approx(parts.parameters, rel=1e-12)
    assert np.array_equal(whole.poses["gripper"], parts.poses["gripper"])


@pytest.mark.parametrize("name", ["land", "gel pressed", "folded touch", "bending_plasticity", "viscoelastic_gel"])
def test_steps_that_found_no_room_are_made_again(name):
    """From positions, to the same state but for round-off."""
    rig, poses, times, names = CASES[name]()
    scene, along = build_scene(rig), directions(rig, names)
    whole = Tape(scene, poses, times, TIGHT)
    given = weights(whole.trace)
    expected = Backward(whole, along).gradient(0.0, given)
    kept = [whole.rollout.kept_bytes]
    for share in (0.9, 0.0):
        tape = Tape(scene, poses, times, TIGHT, memory_mb=1e-6 * share * kept[0])
        kept.append(tape.rollout.kept_bytes)
        assert kept[-1] <= 0.9 * kept[0] and kept[-1] < kept[-2]
        found = Backward(tape, along).gradient(0.0, given)
        for parameter, value in expected.parameters.items():
            assert found.parameters[parameter] == pytest.approx(value, rel=1e-9), parameter
        for mount, value in expected.poses.items():
            np.testing.assert_allclose(found.poses[mount], value, atol=1e-9 * np.abs(value).max())
        np.testing.assert_allclose(found.start_v, expected.start_v, atol=1e-9 * np.abs(expected.start_v).max())


def test_a_loss_of_what_is_remembered_at_the_end():
    """Of plastic curvature: against differences of rollouts."""
    rig, poses, times, _ = CASES["bending_plasticity"]()
    names = ["effects.bending_plasticity.yield_curvature_per_m", "strip.E_pa", "strip.thickness_m"]
    tape = Tape(build_scene(rig), poses, times, TIGHT)
    rng = np.random.default_rng(1)
    remembered = tape.end.internals["strip.bending"]
    assert np.abs(remembered["plastic_curvature"]).max() > 1e-3
    given = {name: rng.standard_normal(value.shape) for name, value in remembered.items()}
    found = Backward(tape, directions(rig, names)).gradient(0.0, {}, {"strip.bending": given}).parameters
    known = {p.name: p.value for p in list_parameters(rig)}
    for name in names:
        ends = []
        for step in (1e-6 * known[name], -1e-6 * known[name]):
            there = Tape(build_scene(with_parameters(rig, {name: known[name] + step})), poses, times, TIGHT).end
            ends.append({what: there.internals["strip.bending"][what] for what in given})
        change = {what: (ends[0][what] - ends[1][what]) / (2e-6 * known[name]) for what in given}
        size = sum(float(np.abs(change[what] * w).sum()) for what, w in given.items())
        expected = sum(float(np.vdot(change[what], w)) for what, w in given.items())
        assert abs(found[name] - expected) < 1e-5 * size, name


FIELDS = {
    **{
        name: CASES[name] for name in ("land", "gel pressed", "bending_plasticity", "viscoelastic_sheet", "gel_mullins")
    },
    "gel without damping": gel(SHAKEN, damping_s=0.0),
}


@pytest.mark.parametrize("name", FIELDS)
def test_fields_sum_up_to_the_numbers(name):
    """One value an element, each other than those near by, and of dampings that are nowhere."""
    rig, poses, times, _ = FIELDS[name]()
    scene, rng = build_scene(rig), np.random.default_rng(4)
    names = [n for n in scene.fields.names if n != "strip.rest_m"]  # a strip of one cell across has no derivative by it
    for field in sorted(names, key=lambda n: not n.endswith("rest_m")):  # shapes first, with which fields are set anew
        values = scene.fields[field]
        small = 1e-3 if field.endswith("rest_angle_rad") else 1e-4
        change = small if field.endswith(("rest_angle_rad", "rest_m")) else 0.05 * values
        scene.fields[field] = values + change * rng.random(values.shape)
    # How stiff a contact is follows from the moduli of the rig, which do more than scale the field where one touches.
    numbers = [n for n in names if n.endswith(("E_pa", "density_kg_m3") if poses is SHAKEN else "density_kg_m3")]
    tape, along = Tape(scene, poses, times, TIGHT), directions(rig, numbers)
    found = Backward(tape, along, names).gradient(0.0, weights(tape.trace))
    assert all(np.abs(found.fields[field]).max() > 0.0 for field in names)
    for field in numbers:  # a number scales the whole field
        body, _, key = field.partition(".")
        number = getattr(rig.bodies[body].material, key)
        whole = float(found.fields[field] @ scene.fields[field])
        assert number * found.parameters[field] == pytest.approx(whole, rel=1e-6), field
