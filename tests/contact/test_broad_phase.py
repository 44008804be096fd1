import numpy as np
import pytest

from sim_core.contact.broad_phase import Candidates
from sim_core.contact.primitives import Primitives
from sim_core.geometry.sheets import rectangle

OFFSET = 1e-4


def distance(p, corners):
    """From a point to a triangle, by a fine sampling of the triangle."""
    a, b = np.meshgrid(np.linspace(0, 1, 30), np.linspace(0, 1, 30))
    inside = a + b <= 1.0
    w = np.column_stack([1 - a[inside] - b[inside], a[inside], b[inside]])
    return np.linalg.norm(w @ corners - p, axis=1).min()


def two_sheets(gap):
    """Nodes of an upper sheet against the triangles of a lower one."""
    lower, upper = rectangle(0.1, 0.05, (12, 6), "irregular"), rectangle(0.03, 0.02, (6, 4), "crossed")
    x = np.vstack([lower.nodes, upper.nodes + [0.0, 0.0, gap]])
    points = np.arange(len(lower.nodes), len(x), dtype=np.int32)[:, None]

    def distances(x, first, second):
        return np.array([distance(x[points[i, 0]], x[lower.triangles[t]]) for i, t in zip(first, second, strict=True)])

    return Candidates(Primitives(points), Primitives(lower.triangles), OFFSET, distances), points, lower.triangles, x


@pytest.mark.parametrize("gap", [5e-4, 3e-3])
def test_every_triangle_within_reach_is_found(gap):
    found, points, triangles, x = two_sheets(gap)
    reach = 2e-3
    found.search(x, x, reach, 1e-3)
    pairs = set(zip(*(p.tolist() for p in found.pairs), strict=True))
    for s, p in enumerate(x[points[:, 0]]):
        for t, corners in enumerate(x[triangles]):
            if (s, t) not in pairs:
                assert distance(p, corners) > reach + OFFSET
    assert found.any == (gap < reach)


def test_a_search_serves_until_its_surplus_is_used_up():
    found, _, _, x = two_sheets(5e-4)
    assert found.search(x, x, 1e-3, 2e-3) == (True, True)
    x[-50:, 0] += 5e-4
    assert found.search(x, x, 1e-3, 2e-3) == (False, False)
    x[-50:, 0] += 2e-3
    assert found.search(x, x, 1e-3, 2e-3)[0]


def test_the_coupled_pairs_stay_while_they_cover_what_is_near():
    found, _, _, x = two_sheets(5e-4)
    found.search(x, x, 1e-3, 2e-3)
    coupled = found.coupled
    found.search(x, x, 1.9e-3, 1e-4)
    assert found.coupled is coupled
    x[-50:, 0] += 0.01
    assert found.search(x, x, 1e-3, 2e-3) == (True, True)


def test_pairs_of_a_violent_step_are_given_up_afterwards():
    """Otherwise every later factorisation pays for couplings that can no longer come."""
    found, _, _, x = two_sheets(5e-4)
    found.search(x, x, 0.05, 1e-3)
    many = found.coupled[0].size
    assert found.search(x, x, 1e-3, 1e-3) == (True, True)
    assert found.coupled[0].size < 0.2 * many


def test_candidates_of_a_violent_motion_are_given_up_where_it_ends():
    """Also if nothing moves any more; they would be measured in every step."""
    found, points, _, x = two_sheets(5e-3)
    start = x.copy()
    start[points[:, 0], 2] -= 0.06
    found.search(start, x, 2e-5, 1e-3)
    assert len(found.pairs[0]) > 1000
    assert found.search(x, x, 2e-5, 1e-3) == (True, True) and not found.any
    found.search(x, start, 2e-5, 1e-3)
    found.search(x, x, 2e-5, 1e-3)
    assert not found.any and found.coupled[0].size == 0
    assert found.search(x, x, 2e-5, 1e-3) == (False, False)


def test_what_the_foreseen_motion_brings_together_is_found_and_nothing_else_far_away():
    found, points, _, x = two_sheets(5e-3)
    towards = x.copy()
    towards[points[:10, 0], 2] -= 8e-3
    found.search(x, towards, 2e-5, 1e-3)
    assert set(found.pairs[0].tolist()) == set(range(10))
    assert not found.outran(towards)
    towards[points[10:, 0], 2] -= 8e-3
    assert found.outran(towards)


def test_a_way_that_turns_keeps_what_its_first_leg_was_searched_for():
    """From A to B, and on from B to C: what lies between B and C was found on the way to B."""
    x = np.array([[0.0, 0, 0], [7e-3, 3.5e-3, 0], [7.2e-3, 3.5e-3, 0], [7.1e-3, 3.7e-3, 0]])
    far = np.array([[2e-3, 6.8e-3, 0], [2.2e-3, 6.8e-3, 0], [2.1e-3, 7e-3, 0]])
    x = np.vstack([x, far])
    points, triangles = np.array([[0]], dtype=np.int32), np.array([[1, 2, 3], [4, 5, 6]], dtype=np.int32)
    distance = lambda x, first, second: np.linalg.norm(x[points[first, 0]] - x[triangles[second, 0]], axis=1)  # noqa: E731
    found = Candidates(Primitives(points, np.ones((1, 1))), Primitives(triangles), 0.0, distance)
    b, c = x.copy(), x.copy()
    b[0], c[0] = [10e-3, 0, 0], [4e-3, 7e-3, 0]
    found.search(x, b, 3e-5, 1e-4)
    assert 0 in found.pairs[1]
    found.search(x, c, 3e-5, 1e-4, more=True)
    assert {0, 1} <= set(found.pairs[1].tolist())


def test_what_is_far_away_has_no_candidates_and_motion_is_measured_between_the_surfaces():
    found, _, _, x = two_sheets(0.05)
    found.search(x, x, 1e-3, 1e-3)
    assert not found.any
    assert not found.outran(x + [0.3, 0.0, 0.0])
    moved = x.copy()
    moved[-1, 2] -= 0.04
    assert not found.outran(moved)
    moved[-1, 2] -= 0.01
    assert found.outran(moved)


def test_primitives_of_one_mesh_that_share_a_node_are_no_pair():
    mesh = rectangle(0.02, 0.02, (4, 4))
    every = Primitives(mesh.triangles)
    found = Candidates(every, every, OFFSET, lambda x, first, second: np.zeros(len(first)), once=True)
    found.search(mesh.nodes, mesh.nodes, 0.05, 1e-3)
    first, second = found.pairs
    assert (first < second).all()
    joined = (mesh.triangles[:, None, :, None] == mesh.triangles[None, :, None, :]).any(axis=(2, 3))
    assert len(first) == np.count_nonzero(np.triu(~joined))
    assert not joined[first, second].any()


@pytest.mark.parametrize("step_m", [1e-4, 4e-4, 2e-3])
def test_no_pair_is_missed_on_a_long_walk(step_m):
    """Lists and rings serve for several steps: at every one of them they have all that comes within the range."""
    found, points, triangles, x = two_sheets(1.5e-3)
    reach, random = 4e-4, np.random.default_rng(4)
    drift = step_m * np.array([0.5, 0.1, -0.2])
    for _ in range(15):
        towards = x + 0.1 * step_m * random.standard_normal(x.shape)
        towards[points[:, 0]] += drift
        found.search(x, towards, reach, 5e-4)
        pairs = set(zip(*(p.tolist() for p in found.pairs), strict=True))
        coupled = set(zip(*(p.tolist() for p in found.coupled), strict=True))
        assert pairs <= coupled
        for share in (0.5, 1.0):
            now = x + share * (towards - x)
            for s in range(0, len(points), 3):
                p = now[points[s, 0]]
                near = np.flatnonzero(np.linalg.norm(now[triangles].mean(axis=1) - p, axis=1) < 1e-2)
                for t in near:
                    assert (s, int(t)) in pairs or distance(p, now[triangles[t]]) > reach + OFFSET
        x = towards


def test_coupled_pairs_are_renewed_together_with_those_of_another_contact():
    found, points, _, x = two_sheets(2e-3)
    found.search(x, x, 1e-3, 2e-3)
    x[points[:, 0], 0] += 9e-4
    assert found.search(x, x, 1e-3, 2e-3) == (False, False)
    before, pairs = set(zip(*found.coupled, strict=True)), set(zip(*found.pairs, strict=True))
    found.recouple(x, x)
    assert set(zip(*found.coupled, strict=True)) != before
    assert set(zip(*found.pairs, strict=True)) == pairs <= set(zip(*found.coupled, strict=True))
