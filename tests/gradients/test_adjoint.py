"""The gradient of a loss over a rollout: against forward sensitivities, differences of rollouts, and itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gradient_scenes import ball, damped, forming, laid
from scipy.spatial.transform import Rotation
from test_tangent import PRESS, RUB

from sim_core.errors import ConfigError
from sim_core.gradients import Backward, Tape, directions, simulate_adjoint, simulate_tangent
from sim_core.rigs import list_parameters, parse_rig, with_parameters
from sim_core.rigs.pose_offset import OFFSETS
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation, simulate, step_times
from sim_core.solve.step import NewtonSettings

EFFECTS = {
    "gel_relaxation": {"share": 0.3, "tau_s": 0.2},
    "static_friction": {"excess": 0.4},
    "end_effector_compliance": {"compliance_m_per_n": 2e-4},
    "bending_plasticity": {"yield_curvature_per_m": 0.5, "hardening_ratio": 0.3},
    "air_drag": {"drag_coefficient": 1.0},
    "sheet_orthotropy": {"modulus_ratio": 1.5, "grain_angle_rad": 0.3},
}
BDF2 = {"dt_s": 0.02, "inertia": True, "integrator": "bdf2"}
STEEL = {"density_kg_m3": 7800.0}
STATIC = {"dt_s": 0.02, "inertia": False}

TIGHT = NewtonSettings(step_tolerance_m=5e-15)


def weights(trace, seed=0):
    rng = np.random.default_rng(seed)
    return {c: rng.standard_normal(o.shape) for c, o in trace.outputs.items()}


def small(path, end=None):
    def build(small_rig, visit, **changes):
        return small_rig(**changes), visit(*path), step_times(0.0, end or path[0][-1], 0.02)

    return build


def swung():
    """A rod on a hinge that is shaken, with a bob on a ball joint; the hand bears both."""

    def box(z, along):
        shape = {"type": "box", "size_m": [0.01, along, 0.04]}
        return {"type": "affine", "shape": shape, "pose": {"position_m": [0.0, 0.0, z]}, "material": STEEL}

    joints = [
        {"type": "hinge", "body": "rod", "to": "hand", "at_m": [0.0, 0.0, 0.02], "axis": [0.0, 1.0, 0.0]},
        {"type": "ball", "body": "bob", "to": "rod", "at_m": [0.0, 0.0, 0.02]},
    ]
    rig = parse_rig(
        {
            "name": "swung",
            "solver": {"dt_s": 0.01, "integrator": "bdf2"},
            "bodies": {"rod": box(-0.02, 0.01), "bob": box(-0.06, 0.02)},
            "joints": joints,
            "end_effectors": {"hand": {}},
            "sensors": {"load": {"type": "wrench", "on": "hand", "rate_hz": 50.0, "topic": "load"}},
        },
        "swung",
    )
    path = np.outer([0.0, 0.0, 1.0, 1.0], [0.01, 0.0, 0.0])
    poses = {"hand": PoseTrajectory(np.array([0.0, 0.05, 0.15, 0.2]), path, np.tile([0.0, 0.0, 0.0, 1.0], (4, 1)))}
    return rig, poses, np.linspace(0.0, 0.2, 21)


CASES = {
    "press": (small(PRESS), {}),
    "rub with every effect": (small(RUB), {"effects": EFFECTS}),
    "press with every effect": (small(PRESS), {"effects": EFFECTS}),
    "looking back": (small(PRESS), {"solver": BDF2}),
    "damped, looking back": (lambda *given: damped("bdf2", *given), {}),
    "static": (small(PRESS, 0.4), {"solver": STATIC}),
    "ball on an arm": (lambda *given: ball(), {}),
    "forming": (lambda *given: forming(), {}),
    "swung": (lambda *given: swung(), {}),
}


MILLISECOND = 1e-3
"""Size of dampings, by which what is nothing but round-off is recognised: a card that nothing moves has no rates."""


@pytest.mark.parametrize("case", CASES)
def test_adjoint_is_the_transpose_of_the_tangent(case, small_rig, visit):
    """For every channel and every parameter of the rig (offsets of poses: ``test_offset.py``), to round-off of the
    sums."""
    build, changes = CASES[case]
    rig, poses, times = build(small_rig, visit, **changes)
    fitted = [p for p in list_parameters(rig) if p.value is not None and p.name.rpartition(".")[2] not in OFFSETS]
    along = directions(rig, [p.name for p in fitted])
    scene = build_scene(rig)
    tape = Tape(scene, poses, times, TIGHT)
    trace, derivatives = simulate_tangent(scene, poses, times, along, settings=TIGHT)
    given = weights(trace)
    compared = 0
    for channel in trace.outputs:
        found = Backward(tape, along).gradient(0.0, {channel: given[channel]})
        products = np.nan_to_num(derivatives[channel]) * given[channel][..., None]
        nothing = 1e-18 * np.nansum(np.abs(given[channel] * trace.outputs[channel]))
        sizes = np.abs(products).reshape(-1, len(along)).sum(axis=0)
        for k, direction in enumerate(along):
            compared += sizes[k] > nothing
            error = abs(found.parameters[direction.name] - products[..., k].sum())
            usual = MILLISECOND if direction.name.endswith("stiffness_damping_s") else 1.0
            assert error <= 1e-8 * sizes[k] + nothing / usual, direction.name
    assert compared >= 5


def test_poses_against_differences_of_rollouts(small_rig, visit):
    check_poses(*small(RUB, 0.4)(small_rig, visit, effects={"end_effector_compliance": {"compliance_m_per_n": 2e-4}}))


def test_poses_of_a_rigid_body_against_differences_of_rollouts():
    rig, poses, times = ball()
    check_poses(rig, poses, times[:-1])


def test_poses_of_a_mount_that_carries_joints_against_differences_of_rollouts():
    rig, poses, times = swung()
    check_poses(rig, poses, times[:8])


def check_poses(rig, poses, times):
    scene = build_scene(rig)
    (mount,) = poses
    positions, quaternions = poses[mount].sample(times)
    tape = Tape(scene, poses, times, TIGHT)
    given = weights(tape.trace)

    def losses(k, step):
        """Of every channel, where the pose at one time is moved by a step in its own frame."""
        p, q, turn = positions.copy(), quaternions.copy(), Rotation.from_quat(quaternions[k])
        p[k] += turn.apply(step[:3])
        q[k] = (turn * Rotation.from_rotvec(step[3:])).as_quat()
        trace = simulate(scene, {mount: PoseTrajectory(times, p, q)}, times, settings=TIGHT)
        products = {channel: trace.outputs[channel] * w for channel, w in given.items()}
        return {c: (np.nansum(v), 1e-15 * np.nansum(np.abs(v))) for c, v in products.items()}

    moves = []
    for k in (0, len(times) // 2 + 1, len(times) - 1):
        for axes, steps in (((0, 1, 2), (1e-7, 1e-8)), ((3, 4, 5), (1e-4, 1e-5))):
            move = np.zeros(6)
            move[list(axes)] = [0.5, -0.6, 0.7]
            moves.append((k, axes, move, [(h, losses(k, h * move), losses(k, -h * move)) for h in steps]))
    for channel, w in given.items():
        found = Backward(tape, []).gradient(0.0, {channel: w}).poses[mount]
        largest = np.abs(found).max(axis=0)
        for k, axes, move, ends in moves:
            errors = []
            for h, up, down in ends:
                slope = (up[channel][0] - down[channel][0]) / (2.0 * h)
                errors.append(abs(slope - found[k] @ move) - down[channel][1] / h)
            assert min(errors) < 1e-5 * largest[list(axes)].max(), (channel, k, axes)


def test_start_state_against_differences_of_rollouts(small_rig, visit):
    """The velocity and position of the state in which the first step starts."""
    rig, poses, times = small(PRESS, 0.3)(small_rig, visit)
    scene = build_scene(rig)
    given = weights(Tape(scene, poses, times, TIGHT).trace)
    rng = np.random.default_rng(2)
    free = ~scene.system.prescribed

    def value(dx, dv):
        simulation = Simulation(scene, TIGHT)
        tracks = {n: p.sample(times) for n, p in poses.items()}
        frames = [{n: frame_of(p[k], q[k]) for n, (p, q) in tracks.items()} for k in range(len(times))]
        simulation.reset(frames[0])
        total, state = 0.0, simulation.state
        simulation.state = replace(state, x=state.x + dx, v=state.v + dv)
        for k in range(1, len(times)):
            simulation.step(frames[k], times[k] - times[k - 1])
            total += sum(np.nansum(r * given[c][k]) for c, r in simulation.read().items())
        return total

    move = rng.standard_normal(scene.rest.shape) * free
    later = {c: np.concatenate([np.zeros_like(w[:1]), w[1:]]) for c, w in given.items()}
    found = simulate_adjoint(scene, poses, times, lambda trace: (0.0, later), [], settings=TIGHT)
    for by, name, steps in ((found.start_v, "v", (1e-4, 1e-5)), (found.start_x, "x", (1e-8, 1e-9))):
        errors = []
        for h in steps:
            ends = [value(*((s * move, 0.0) if name == "x" else (0.0, s * move))) for s in (h, -h)]
            errors.append(abs((ends[0] - ends[1]) / (2.0 * h) - np.vdot(by, move)))
        assert min(errors) < 1e-5 * np.abs(by * move).sum(), name


def rests(small_rig, visit):
    """A soft card that weight draws along a soft post, which holds it by friction within micrometres."""
    bodies = small_rig().model_dump(mode="json", exclude_none=True)["bodies"]
    bodies["card"]["material"].update(E_pa=2e6, thickness_m=3e-3)
    bodies["card"]["pose"]["position_m"] = [0.0, 0.0, 0.052]
    contact = {"friction": 0.1, "stiffness_pa_per_m": 3e6}
    rig = laid(small_rig, contact, bodies=bodies, gravity_m_s2=[4.0, 2.0, -9.0])
    return rig, visit(*PRESS), step_times(0.0, 0.1, 0.02)


REMEMBERED = {
    "card.bending": {"plastic_curvature": 0.01, "accumulated_curvature": 0.01},
    "gel.elastic_laws": {"gel_relaxation.stress": 10.0},
    "contact.card-post": {"anchor": 3e-8, "load": 1e-4},
}
"""Changes of internal variables by term and name [1/m, Pa, m, N]."""


@pytest.mark.parametrize("term", REMEMBERED)
def test_memory_at_the_start_against_differences_of_rollouts(term, small_rig, visit):
    """Plastic curvature and its accumulation, the memory of stress, elastic slip of friction and the load it is of.

    Friction depends on the reciprocal of the load. At steps large enough to stand out of the round-off of readings the
    plain central difference D(h) therefore has a truncation error of 1e-4, so the references are extrapolated to
    (4 D(h/2) - D(h)) / 3 (Richardson), and differences are taken of readings before anything is summed.
    """
    pressed = small(PRESS, 0.3)
    rig, poses, times = (
        rests(small_rig, visit) if term.startswith("contact") else pressed(small_rig, visit, effects=EFFECTS)
    )
    scene = build_scene(rig)
    tracks = {n: p.sample(times) for n, p in poses.items()}
    frames = [{n: frame_of(p[k], q[k]) for n, (p, q) in tracks.items()} for k in range(len(times))]
    simulation = Simulation(scene, TIGHT)
    simulation.reset(frames[0])
    start = simulation.state.internals[term]
    given = weights(Tape(scene, poses, times, TIGHT).trace)
    later = {c: np.concatenate([np.zeros_like(w[:1]), w[1:]]) for c, w in given.items()}
    found = simulate_adjoint(scene, poses, times, lambda trace: (0.0, later), [], settings=TIGHT).start_memory[term]

    def readings(name, change):
        simulation.reset(frames[0])
        state = simulation.state
        known = state.internals[term]
        simulation.state = replace(state, internals={**state.internals, term: {**known, name: known[name] + change}})
        read = []
        for k in range(1, len(times)):
            simulation.step(frames[k], times[k] - times[k - 1])
            read.append(simulation.read())
        return read

    def difference(name, change):
        """Of the weighted sum of readings, between starts with the change and with its opposite."""
        pairs = enumerate(zip(readings(name, change), readings(name, -change), strict=True), start=1)
        return sum(np.nansum((up[c] - down[c]) * w[k]) for k, (up, down) in pairs for c, w in given.items())

    rng = np.random.default_rng(4)
    for name, size in REMEMBERED[term].items():
        move, errors = size * rng.standard_normal(found[name].shape), []
        if "load" in start:
            move *= start[name] != 0.0  # where nothing touches, more load is a limit of friction, and less is none
        for h in (2e-1, 2e-2, 2e-3):
            coarse, fine = (difference(name, step * move) / (2.0 * step) for step in (h, 0.5 * h))
            errors.append(abs((4.0 * fine - coarse) / 3.0 - np.vdot(found[name], move)))
        assert min(errors) < 1e-5 * np.abs(found[name] * move).sum(), name


def other_rig(scene):
    scene.use(with_parameters(scene.rig, {"card.E_pa": 3e9}))


def other_fields(scene):
    scene.fields["card.E_pa"] *= 2.0


def other_angles(scene):
    scene.fields["card.rest_angle_rad"] += 1e-3


def other_loads(scene):
    scene.system.loads[:, 2] -= 1e-6


def other_gravity(scene):
    scene.system.gravity = np.zeros(3)


@pytest.mark.parametrize("memory_mb", [1000.0, 0.0])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (other_rig, "another rig"),
        (other_fields, "other fields"),
        (other_angles, "other fields"),
        (lambda scene: scene.fields.reset(), "other fields"),
        (other_loads, "other loads"),
        (other_gravity, "other gravity"),
    ],
)
def test_a_tape_of_a_scene_that_was_changed_is_refused(change, words, memory_mb, small_rig, visit):
    """Its steps are those of the scene as it was, and all else would be of the scene as it is."""
    rig, poses, times = small(PRESS)(small_rig, visit)
    scene = build_scene(rig)
    tape = Tape(scene, poses, times[:4], memory_mb=memory_mb)
    along, given = directions(rig, ["card.thickness_m"]), weights(tape.trace)
    backward = Backward(tape, along)
    backward.gradient(0.0, given)
    change(scene)
    for again in (lambda: backward.gradient(0.0, given), lambda: Backward(tape, along)):
        with pytest.raises(ConfigError, match=f"given {words} since the rollout was recorded"):
            again()
    fresh = Tape(scene, poses, times[:4])
    Backward(fresh, along).gradient(0.0, weights(fresh.trace))


def test_a_tape_is_of_use_as_long_as_the_scene_is_the_same(small_rig, visit):
    """With a rig of the same numbers, after fields were read, what was read was changed, or values were refused."""
    rig, poses, times = small(PRESS)(small_rig, visit)
    scene = build_scene(rig)
    tape = Tape(scene, poses, times[:4])
    along, given = directions(rig, ["card.thickness_m"]), weights(tape.trace)
    expected = Backward(tape, along).gradient(0.0, given).parameters
    other_rig(scene)
    scene.use(with_parameters(rig, {"card.E_pa": 2e9}))
    read = scene.fields["card.E_pa"]
    read *= 2.0
    for values in (-1.0, np.ones(3)):
        with pytest.raises(ConfigError):
            scene.fields["card.E_pa"] = values
    assert Backward(tape, along).gradient(0.0, given).parameters == pytest.approx(expected, rel=1e-9)


def test_a_scene_that_the_core_does_not_cover_is_refused(small_rig, visit, monkeypatch):
    rig, poses, times = small(PRESS)(small_rig, visit)
    monkeypatch.setattr("sim_core.gradients.tape.covers", lambda scene: "The core has no elements for card.kite.")
    with pytest.raises(ConfigError, match=r"no gradient on the way back: the core has no elements for card\.kite"):
        Tape(build_scene(rig), poses, times[:4])
