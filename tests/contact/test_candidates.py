import numpy as np
import pytest

from sim_core.contact.candidates import Candidates, distance_to_triangles
from sim_core.contact.samples import sheet_samples
from sim_core.geometry.sheets import rectangle


def two_sheets(gap):
    lower, upper = rectangle(0.1, 0.05, (12, 6), "irregular"), rectangle(0.03, 0.02, (6, 4), "crossed")
    offset = len(lower.nodes)
    samples = sheet_samples(upper, offset, 1e-4)
    x = np.vstack([lower.nodes, upper.nodes + [0.0, 0.0, gap]])
    return Candidates(samples, lower.triangles, 1e-4), samples, lower.triangles, x


def distance(p, corners):
    """From a point to a triangle, by a fine sampling of the triangle."""
    a, b = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60))
    inside = a + b <= 1.0
    w = np.column_stack([1 - a[inside] - b[inside], a[inside], b[inside]])
    return np.linalg.norm(w @ corners - p, axis=1).min()


@pytest.mark.parametrize("gap", [5e-4, 2e-3])
def test_every_triangle_within_reach_is_found(gap):
    found, samples, triangles, x = two_sheets(gap)
    reach = 2e-3
    found.search(x, reach, 1e-3)
    points = samples.positions(x)
    for s, p in enumerate(points):
        near = set(found.near[found.first[s] : found.first[s + 1]].tolist())
        for t, corners in enumerate(x[triangles]):
            if t not in near:
                assert distance(p, corners) > reach + 1e-4
    assert found.any


def test_distance_to_a_triangle_over_its_face_its_edges_and_its_corners():
    rng = np.random.default_rng(4)
    corners = rng.standard_normal((200, 3, 3))
    points = 2.0 * rng.standard_normal((200, 3))
    expected = [distance(p, c) for p, c in zip(points, corners, strict=True)]
    np.testing.assert_allclose(distance_to_triangles(points, corners), expected, atol=0.05, rtol=0.02)
    over = corners.mean(axis=1) + 0.1 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    heights = np.linalg.norm(over - corners.mean(axis=1), axis=1)
    np.testing.assert_allclose(distance_to_triangles(over, corners), heights)


def test_a_search_serves_until_the_surfaces_have_moved_by_its_surplus():
    found, _, _, x = two_sheets(5e-4)
    found.search(x, 1e-3, 1e-3)
    first, near = found.first.copy(), found.near.copy()
    x[-50:, 0] += 2e-4
    found.search(x, 1e-3, 1e-3)
    assert np.array_equal(found.first, first) and np.array_equal(found.near, near)
    x[-50:, 0] += 4e-4
    found.search(x, 1e-3, 1e-3)
    assert not np.array_equal(found.first, first)


def test_the_coupled_pairs_stay_while_they_cover_what_is_near():
    found, _, _, x = two_sheets(5e-4)
    assert found.search(x, 1e-3, 2e-3)[0]
    coupled = found.coupled
    x[-50:, 0] += 5e-4
    assert not found.search(x, 1e-3, 2e-3)[0]
    assert found.coupled is coupled
    x[-50:, 0] += 0.01
    assert found.search(x, 1e-3, 2e-3)[0]


def test_pairs_of_a_violent_step_are_given_up_afterwards():
    """Otherwise every later factorisation pays for couplings that can no longer come."""
    found, _, _, x = two_sheets(5e-4)
    found.search(x, 0.02, 1e-3)
    many = found.coupled[0].size
    assert found.search(x, 1e-3, 1e-3)[0]
    assert found.coupled[0].size < 0.2 * many


def test_what_is_far_away_has_no_candidates_and_motion_is_measured_between_the_surfaces():
    found, _, _, x = two_sheets(0.05)
    found.search(x, 1e-3, 1e-3)
    assert not found.any
    assert not found.outran(x + [0.3, 0.0, 0.0])
    moved = x.copy()
    moved[-1, 2] -= 3e-3
    assert found.outran(moved)
