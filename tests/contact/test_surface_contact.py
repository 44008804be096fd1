import numpy as np
import pytest
import scipy.sparse as sp
from contact_scenes import LAW, SHEET, Two
from crossing import crossings_of
from potentials import Look, check_derivatives
from scipy.spatial.transform import Rotation

from sim_core.contact.samples import Samples
from sim_core.contact.surface import SurfaceContact
from sim_core.solve.step import State, advance, contact_force
from sim_core.solve.system import System


@pytest.mark.parametrize("slip", [1e-7, 2e-6, 1e-4], ids=["at rest", "stick", "slip"])
def test_derivatives_match_differences(slip):
    """Overlapping rough sheets: faces, edges and corners are all in contact."""
    two = Two(gap=1e-4)
    x = two.nodes + 2e-5 * np.random.default_rng(5).standard_normal(two.nodes.shape)
    internals = two.touching(x)
    moved = x.copy()
    moved[two.upper] += slip * np.array([0.6, -0.8, 0.0])
    assert check_derivatives(two.look, moved, h=1e-9, tolerance=1e-4) > 100.0
    assert all(internals[term.name]["load"].any() for term in two.contact)


def test_derivatives_still_match_after_the_candidates_have_changed():
    """The pattern of the Hessian follows what can touch; nothing is lost when it is renewed."""
    two = Two(gap=1e-4)
    rng = np.random.default_rng(2)
    two.touching(two.nodes)
    places = two.look.at().hessian.nnz
    x = two.nodes + 2e-5 * rng.standard_normal(two.nodes.shape)
    x[two.upper] += [0.012, -0.008, 0.0]
    two.touching(x)
    assert two.look.at().hessian.nnz != places
    x[two.upper] += [3e-5, 0.0, 0.0]
    check_derivatives(two.look, x, h=1e-9, tolerance=1e-5)


def test_hessian_without_curvature_of_the_gap_is_positive_semidefinite():
    two = Two(gap=1e-4, elastic=False)
    x = two.nodes + 2e-5 * np.random.default_rng(3).standard_normal(two.nodes.shape)
    two.touching(x)
    two.look.x[two.upper] += [1e-4, 0.0, 0.0]
    values = np.linalg.eigvalsh(two.look.hessian())
    assert values[0] > -1e-10 * values[-1]


@pytest.mark.parametrize("noise", [0.0, 1e-5], ids=["smooth", "rough"])
def test_action_is_reaction(noise):
    """What the contact does to one sheet it does to the other, force and moment, friction included."""
    two = Two(gap=1e-4, elastic=False)
    x = two.nodes + noise * np.random.default_rng(6).standard_normal(two.nodes.shape)
    two.touching(x)
    two.look.x[two.upper] += [1e-5, 5e-6, 0.0]
    gradient = two.look.gradient()
    rubbing = np.linalg.norm(gradient[two.upper].sum(axis=0)[:2])
    assert rubbing > 0.01 * np.abs(gradient).max()
    np.testing.assert_allclose(gradient.sum(axis=0), 0.0, atol=1e-12 * np.abs(gradient).sum())
    moment = np.cross(two.look.x, gradient).sum(axis=0)
    np.testing.assert_allclose(moment, 0.0, atol=1e-2 * rubbing * SHEET["thickness_m"])


def test_turning_the_whole_scene_turns_the_forces():
    two = Two(gap=1e-4, elastic=False)
    x = two.nodes + 2e-5 * np.random.default_rng(4).standard_normal(two.nodes.shape)

    def slipping(turn):
        two.touching(turn.apply(x))
        moved = x.copy()
        moved[two.upper] += [1e-4, 5e-5, 0.0]
        two.look.x[:] = turn.apply(moved)
        return two.look.energy(), two.look.gradient()

    energy, gradient = slipping(Rotation.identity())
    for turn in Rotation.random(5, random_state=7):
        e, g = slipping(turn)
        assert e == pytest.approx(energy, rel=1e-9)
        np.testing.assert_allclose(g, turn.apply(gradient), atol=1e-8 * np.abs(gradient).max())


THIN = {**LAW, "range_m": 4e-5}


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("offset", [0.0, 1e-7, -1e-7])
def test_right_above_an_edge_derivatives_are_those_of_one_side(offset, friction):
    """Two triangles of a plane; the sample is as near to both."""
    corners = 0.01 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.5, -1.0, 0.0]])
    nodes = np.vstack([corners, [0.004, offset, 2.2e-4]])
    samples = Samples(np.array([[4]], dtype=np.int32), np.ones((1, 1)), np.array([1e-6]), 0.0)
    term = SurfaceContact("c", samples, np.array([[0, 1, 2], [1, 0, 3]]), 2e-4, 1e-3)
    term.configure({**THIN, "friction": friction})
    system = System(nodes, sp.csr_matrix((5, 5)), np.zeros((5, 3), dtype=bool), [term], np.zeros(3), inertia=False)
    look = Look(system)
    look.begin(nodes, dt=0.01)
    look.begin(nodes, dt=0.01, internals=look.end().internals)
    hessian = look.hessian(exact=True)
    across, gradients = np.zeros_like(nodes), []
    across[4, 1] = h = 1e-10
    for shift in (-across, 0.0, across):
        look.x[:] = nodes + shift
        gradients.append(look.gradient().ravel())
    found, sides = hessian @ across.ravel() / h, np.diff(gradients, axis=0) / h
    # What a corner bears begins on one side of the edge; the sample itself has the same derivative on both.
    misses = [np.abs(found - slope).max() for slope in sides]
    assert min(misses) < 1e-4 * np.abs(sides).max()
    assert sides[0][12:] == pytest.approx(sides[1][12:], rel=1e-4, abs=1e-4 * np.abs(sides).max())


def one_triangle(point, size, law=THIN):
    """One sample at ``point`` against one triangle in the plane z = 0; returns force on it and gap."""
    corners = size * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    nodes = np.vstack([corners, point])
    samples = Samples(np.array([[3]], dtype=np.int32), np.ones((1, 1)), np.array([1e-6]), 0.0)
    term = SurfaceContact("c", samples, np.array([[0, 1, 2]]), 2e-4, 1e-3)
    term.configure(law)
    system = System(nodes, sp.csr_matrix((4, 4)), np.zeros((4, 3), dtype=bool), [term], np.zeros(3), inertia=False)
    found = Look(system).at()
    return -found.gradient[3], found.gap


@pytest.mark.parametrize("height", [1e-4, -1e-4, 0.0])
def test_nothing_is_felt_beyond_the_border_of_a_sheet(height):
    """A point off a sheet, in its plane or a little over it, further away than the thickness."""
    for place in ([-3e-4, 2e-3], [2e-3, -3e-4], [6e-3, 6e-3], [-3e-4, -3e-4]):
        force, gap = one_triangle([*place, height], 0.01)
        assert not force.any()
        assert gap > 0.0
    assert one_triangle([2e-3, 2e-3, 2.2e-4], 0.01)[0].any()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_sheet_pushes_back_to_the_side_that_one_is_on(side):
    force, _ = one_triangle([2e-3, 2e-3, side * 2.2e-4], 0.01)
    assert force[2] * side > 0.0
    assert force[:2] == pytest.approx([0.0, 0.0])


def test_the_force_over_a_border_leads_away_from_the_border():
    force, _ = one_triangle([-1.5e-4, 2e-3, 1.5e-4], 0.01)
    assert force[0] < 0.0 < force[2]


@pytest.mark.parametrize("size", [2e-3, 0.02, 0.5])
def test_triangles_much_larger_than_the_reach_are_not_missed(size):
    """Everywhere over the triangle, near corners and far from its middle."""
    rng = np.random.default_rng(8)
    for _ in range(30):
        a, b = np.sort(rng.uniform(0.0, 1.0, 2))
        point = size * np.array([a, 1.0 - b, 0.0]) + [0.0, 0.0, 2.2e-4]
        force, gap = one_triangle(point, size)
        assert gap == pytest.approx(2e-5, abs=1e-9)
        assert force[2] == pytest.approx(THIN["stiffness_pa_per_m"] * 1e-6 * 2e-5, rel=1e-4)


def apart(two, x):
    """Whether no edge of either sheet goes through the other."""
    lower, upper = (m.triangles + n[0] for m, n in zip(two.meshes, (two.lower, two.upper), strict=True))
    return crossings_of(x, lower, upper) == 0


@pytest.mark.parametrize("speed", [0.05, 0.4, 2.0])
def test_fast_approach_is_not_missed(speed):
    """A sheet thrown at another at up to 20 mm a step, far over its thickness, is caught on its own side."""
    two = Two(gap=4e-3, margin=1e-3)
    system = two.system
    system.inertia = True
    v = np.zeros_like(two.nodes)
    v[two.upper, 2] = -speed
    state = State(0.0, two.nodes, v, system.initial_internals())
    touched = False
    for _ in range(12):
        state, report = advance(system, state, two.nodes, 0.01)
        touched |= report.contacts > 0
        assert report.min_gap_m > 0.0
        assert apart(two, state.x)
    assert touched
    assert state.v[two.lower, 2].mean() < -0.1 * speed
    momentum = system.mass.diagonal() @ state.v
    expected = system.mass.diagonal() @ v
    np.testing.assert_allclose(momentum, expected, atol=1e-9 + 1e-6 * abs(expected[2]))


def test_a_jump_that_nothing_announced_is_not_missed():
    """From rest, a sudden load would carry a sheet through the other within one step."""
    two = Two(gap=1e-2, margin=1e-3)
    system = two.system
    system.inertia = True
    system.loads[two.upper, 2] = -130.0 * system.mass.diagonal()[two.upper]
    state = State(0.0, two.nodes, np.zeros_like(two.nodes), system.initial_internals())
    state, report = advance(system, state, two.nodes, 0.01)
    assert report.contacts > 0
    assert report.min_gap_m > 0.0
    assert apart(two, state.x)
    assert state.v[two.lower, 2].mean() < -0.05


def trough(angle, load):
    """A point pressed by ``load`` [N] into a fixed V of two triangles, each at ``angle`` to the horizontal."""
    c, s = 0.01 * np.cos(angle), 0.01 * np.sin(angle)
    nodes = np.array([[-0.01, 0, 0], [0.01, 0, 0], [0, c, s], [0, -c, s], [0, 0, 2.2e-4 / np.cos(angle)]])
    samples = Samples(np.array([[4]], dtype=np.int32), np.ones((1, 1)), np.array([1e-6]), 0.0)
    triangles = np.array([[0, 1, 2], [1, 0, 3]])
    term = SurfaceContact("c", samples, triangles, 2e-4, 1e-3)
    term.configure({**THIN, "friction": 0.0})
    prescribed = np.ones((5, 3), dtype=bool)
    prescribed[4] = False
    mass = sp.diags([0.0, 0.0, 0.0, 0.0, 1e-4]).tocsr()
    system = System(nodes, mass, prescribed, [term], np.zeros(3))
    system.loads[4] = load
    state = State(0.0, nodes, np.zeros_like(nodes), system.initial_internals())
    for _ in range(30):
        state, report = advance(system, state, nodes, 1e-3)
        assert report.converged
    return state, contact_force(system, term.name)


@pytest.mark.parametrize("aside", [0.0, 2e-3, -6e-3])
def test_a_point_comes_to_rest_in_a_concave_crease(aside):
    """Both faces push; between them they balance any load within the cone of their normals."""
    state, force = trough(0.6, [0.0, aside, -1.5e-2])
    np.testing.assert_allclose(force[4], [0.0, -aside, 1.5e-2], atol=1e-7)
    bottom = 2e-4 / np.cos(0.6)
    assert 0.0 < state.x[4, 2] - bottom < 2.0 * THIN["range_m"]
