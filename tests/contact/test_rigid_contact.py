import numpy as np
import pytest
import scipy.sparse as sp
from contact_scenes import LAW, on_rigid
from potentials import check_derivatives
from scipy.spatial.transform import Rotation

from sim_core.contact.shapes import BOX, CYLINDER, HALF_SPACE, SPHERE
from sim_core.effects.static_friction import StaticFriction
from sim_core.solve.report import Result
from sim_core.solve.step import State, advance
from sim_core.solve.system import System

R = 0.01
SHAPES = {
    "half space": ([HALF_SPACE, 0, 0, 0, 0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
    "sphere": ([SPHERE, R, 0, 0, 0], R * np.array([0.48, 0.6, 0.64]), [0.48, 0.6, 0.64]),
    "cylinder": ([CYLINDER, R, 0.02, 1e-3, 0], R * np.array([0.6, 0.8, 0.0]), [0.6, 0.8, 0.0]),
    "box": ([BOX, R, R, R, 1e-3], [R, 0.002, 0.001], [1.0, 0.0, 0.0]),
}


def patch(point, normal, gap):
    """Two triangles with sides of 0.4 mm, tangential to a surface at ``point``, ``gap`` above it."""
    n = np.asarray(normal, dtype=float)
    u = np.cross(n, [0.3, -0.5, 0.81])
    u /= np.linalg.norm(u)
    v = np.cross(n, u)
    side = 4e-4 * np.array([[-0.5, -0.5], [0.5, -0.45], [0.5, 0.5], [-0.4, 0.5]])
    return np.asarray(point) + side @ [u, v] + gap * n, [[0, 1, 2], [0, 2, 3]]


def resting(name, gap=1e-4, law=LAW, turn=None, effects=()):
    """A patch pressed into a shape, in a step that knows the load; also its tangent."""
    turn = Rotation.identity() if turn is None else turn
    shape, point, normal = SHAPES[name]
    nodes, triangles = patch(point, normal, gap)
    nodes = turn.apply(nodes)
    system, term = on_rigid(shape, nodes, triangles, law, turn.as_matrix(), effects)
    x = np.vstack([nodes, np.zeros(3)])
    internals = None
    for _ in range(2):
        system.begin(x, dt=0.01, internals=internals)
        system.x[:] = x
        internals = system.end().internals
    system.begin(x, dt=0.01, internals=internals)
    tangent = np.cross(turn.apply(normal), [0.2, 0.9, -0.4])
    return system, term, x, tangent / np.linalg.norm(tangent)


@pytest.mark.parametrize("slip", [0.0, 2e-6, 9e-5], ids=["at rest", "stick", "slip"])
@pytest.mark.parametrize("name", SHAPES)
def test_derivatives_match_differences(name, slip):
    system, _, x, tangent = resting(name)
    moved = x.copy()
    moved[:-1] += slip * tangent
    assert check_derivatives(system, moved, h=1e-9, tolerance=1e-5) > 0.1


@pytest.mark.parametrize("name", SHAPES)
def test_hessian_without_curvature_of_the_shape_is_positive_semidefinite(name):
    system, _, x, tangent = resting(name)
    system.x[:-1] = x[:-1] + 4e-5 * tangent
    values = np.linalg.eigvalsh(system.hessian())
    assert values[0] > -1e-10 * values[-1]


def test_action_is_reaction_and_their_moments_cancel():
    system, _, x, tangent = resting("sphere")
    system.x[:-1] = x[:-1] + 4e-5 * tangent
    gradient = system.gradient()
    scale = np.abs(gradient).max()
    assert scale > 1e-3
    np.testing.assert_allclose(gradient.sum(axis=0), 0.0, atol=1e-12 * scale)
    np.testing.assert_allclose(system.at().forces["rigid"], -gradient, atol=1e-12 * scale)


def test_friction_threshold_does_not_depend_on_the_orientation():
    """The largest tangential force is mu times the load, in any direction and for the whole scene turned in
    any way (D8: a tangent basis that is not orthonormal loses up to a third)."""
    rng = np.random.default_rng(5)
    for turn in Rotation.random(20, random_state=6):
        system, _, x, tangent = resting("half space", turn=turn)
        normal = turn.apply([0.0, 0.0, 1.0])
        direction = Rotation.from_rotvec(rng.uniform(0, 2 * np.pi) * normal).apply(tangent)
        load = system.state.internals["rigid"]["load"].sum()
        system.x[:-1] = x[:-1] + 1e-3 * direction
        force = -system.gradient()[:-1].sum(axis=0)
        assert load > 1e-3
        assert -force @ direction == pytest.approx(LAW["friction"] * load, rel=1e-9)
        assert np.linalg.norm(force - (force @ normal) * normal) == pytest.approx(LAW["friction"] * load, rel=1e-9)


def test_stick_is_a_spring_until_the_limit_and_returns_to_where_it_was():
    system, term, x, tangent = resting("half space")
    area, k = term.areas.sum(), LAW["stiffness_pa_per_m"]
    limit = LAW["friction"] * system.state.internals["rigid"]["load"].sum()
    system.x[:-1] = x[:-1] + 1e-9 * tangent
    assert -system.gradient()[-1] @ tangent == pytest.approx(k * area * 1e-9, rel=1e-4)
    system.x[:-1] = x[:-1] + limit / (k * area) * tangent
    assert -system.gradient()[-1] @ tangent == pytest.approx(0.75 * limit, rel=1e-6)
    system.x[:] = x
    assert abs(system.gradient()[-1] @ tangent) < 1e-12


def test_static_excess_raises_the_threshold_only_at_rest():
    law = {**LAW, "static_friction.excess": 0.5}
    system, term, x, tangent = resting("half space", law=law, effects=[StaticFriction()])
    internals, found = {**term.initial_internals(), "load": np.ones(4)}, []
    for speed in (0.0, 0.1):
        system.begin(x, dt=0.01, internals={"rigid": {**internals, "slip_speed": np.full(4, speed)}})
        system.x[:] = x
        system.x[:-1] += tangent
        found.append(-system.at().forces["rigid"][:-1].sum(axis=0) @ tangent)
    assert found == pytest.approx([4.0 * 1.5 * LAW["friction"], 4.0 * LAW["friction"]])


@pytest.mark.parametrize("name", SHAPES)
def test_a_start_elsewhere_with_springs_stretched_by_as_much_rubs_alike(name):
    """Along the tangent, and turned: friction at the end is that of the same slip."""
    turn = Rotation.from_rotvec([0.4, -0.3, 0.8])
    system, term, x, tangent = resting(name, turn=turn)
    system.x[:-1] = x[:-1] + 1e-6 * tangent
    whole = system.gradient()
    kept = system.state.internals
    start = x.copy()
    start[:-1] += 2e-7 * tangent
    system.begin(start, dt=0.01, internals=kept)
    slipped = system.gradient()
    stretched = {"rigid": term.carried(kept["rigid"], start - x)}
    system.begin(start, dt=0.01, internals=stretched)
    scale = np.abs(whole).max()
    np.testing.assert_allclose(system.gradient(), whole, atol=1e-3 * np.abs(slipped - whole).max() + 1e-12 * scale)
    assert np.abs(slipped - whole).max() > 1e-3 * scale


def test_a_step_in_which_nothing_can_give_way_says_so():
    """Three corners of a patch are led a millimetre into a half space."""
    nodes, triangles = patch(np.zeros(3), [0.0, 0.0, 1.0], 1e-4)
    plain = on_rigid([HALF_SPACE, 0, 0, 0, 0], nodes, triangles)[0].system
    prescribed = plain.prescribed.copy()
    prescribed[:3] = True
    system = System(plain.nodes, 1e-6 * sp.identity(5).tocsr(), prescribed, plain.terms, np.zeros(3))
    still = State(0.0, system.nodes, np.zeros_like(system.nodes), system.initial_internals())
    targets = system.nodes - np.array([[0.0, 0.0, 1e-3]] * 4 + [[0.0] * 3])
    _, report = advance(system, still, targets, 0.01, check=False)
    assert report.result is Result.BLOCKED
    assert report.tightest == "rigid" and 0.0 < report.min_gap_m < 1e-4
