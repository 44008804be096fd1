import numpy as np
import pytest
from contact_scenes import LAW, check_derivatives, on_rigid
from scipy.spatial.transform import Rotation

from sim_core.contact.shapes import BOX, CYLINDER, HALF_SPACE, SPHERE
from sim_core.effects.static_friction import StaticFriction
from sim_core.solve.integrator import step_context

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
    internals = {"rigid": term.initial_internals()}
    step = step_context(x, np.zeros_like(x), 0.01)
    for _ in range(2):
        system.x[:] = x
        system.begin_step(step, internals)
        system.residual()
        internals = {"rigid": term.end_step(step, internals["rigid"])}
    system.begin_step(step, internals)
    tangent = np.cross(turn.apply(normal), [0.2, 0.9, -0.4])
    return system, term, x, tangent / np.linalg.norm(tangent)


@pytest.mark.parametrize("slip", [0.0, 2e-6, 9e-5], ids=["at rest", "stick", "slip"])
@pytest.mark.parametrize("name", SHAPES)
def test_derivatives_match_differences(name, slip):
    system, _, x, tangent = resting(name)
    moved = x.copy()
    moved[:-1] += slip * tangent
    assert check_derivatives(system, moved) > 0.1


@pytest.mark.parametrize("name", SHAPES)
def test_hessian_without_curvature_of_the_shape_is_positive_semidefinite(name):
    system, _, x, tangent = resting(name)
    system.x[:-1] = x[:-1] + 4e-5 * tangent
    upper = system.hessian().toarray()
    values = np.linalg.eigvalsh(upper + np.triu(upper, 1).T)
    assert values[0] > -1e-10 * values[-1]


def test_action_is_reaction_and_their_moments_cancel():
    system, term, x, tangent = resting("sphere")
    system.x[:-1] = x[:-1] + 4e-5 * tangent
    gradient = system.gradient()
    scale = np.abs(gradient).max()
    assert scale > 1e-3
    np.testing.assert_allclose(gradient.sum(axis=0), 0.0, atol=1e-12 * scale)
    at, force = term.sample_forces()
    np.testing.assert_allclose(force.sum(axis=0), -gradient[:-1].sum(axis=0), atol=1e-12 * scale)
    np.testing.assert_allclose(at, system.x[:-1], atol=1e-15)


def test_friction_threshold_does_not_depend_on_the_orientation():
    """The largest tangential force is mu times the load, in any direction and for the whole scene turned in
    any way (D8: a tangent basis that is not orthonormal loses up to a third)."""
    rng = np.random.default_rng(5)
    for turn in Rotation.random(20, random_state=6):
        system, term, x, tangent = resting("half space", turn=turn)
        normal = turn.apply([0.0, 0.0, 1.0])
        direction = Rotation.from_rotvec(rng.uniform(0, 2 * np.pi) * normal).apply(tangent)
        load = term._load.sum()
        system.x[:-1] = x[:-1] + 1e-3 * direction
        force = -system.gradient()[:-1].sum(axis=0)
        assert load > 1e-3
        assert -force @ direction == pytest.approx(LAW["friction"] * load, rel=1e-9)
        assert np.linalg.norm(force - (force @ normal) * normal) == pytest.approx(LAW["friction"] * load, rel=1e-9)


def test_stick_is_a_spring_until_the_limit_and_returns_to_where_it_was():
    system, term, x, tangent = resting("half space")
    area, k = term._areas.sum(), LAW["stiffness_pa_per_m"]
    system.x[:-1] = x[:-1] + 1e-9 * tangent
    assert -system.gradient()[-1] @ tangent == pytest.approx(k * area * 1e-9, rel=1e-4)
    system.x[:-1] = x[:-1] + term._limit.sum() / (k * area) * tangent
    assert -system.gradient()[-1] @ tangent == pytest.approx(0.75 * term._limit.sum(), rel=1e-6)
    system.x[:] = x
    assert abs(system.gradient()[-1] @ tangent) < 1e-12


def test_static_excess_raises_the_threshold_only_at_rest():
    law = {**LAW, "static_friction.excess": 0.5}
    _, term, x, _ = resting("half space", law=law, effects=[StaticFriction()])
    internals = term.initial_internals()
    internals["load"] = np.ones(4)
    step = step_context(x, np.zeros_like(x), 0.01)
    term.begin_step(step, internals)
    at_rest = term._limit.copy()
    internals["slip_speed"] = np.full(4, 0.1)
    term.begin_step(step, internals)
    np.testing.assert_allclose(at_rest, 1.5 * LAW["friction"])
    np.testing.assert_allclose(term._limit, LAW["friction"])
