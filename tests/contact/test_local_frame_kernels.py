"""Closed-form derivatives of frames and friction against a complex step of the laws themselves."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.contact.friction_derivatives import friction_derivatives
from sim_core.contact.local_frame_kernels import Frames
from sim_core.energies.linearised import complex_step, cross, dot, skew

DT = 0.01


def triangle_law(kind, first, second):
    """B and m of a sample over a triangle, of which it is nearest to the inside, to an edge or to a corner."""

    def law(z):
        p, y0, y1, y2 = (z[..., k, :] for k in range(4))
        e1, e2, r = y1 - y0, y2 - y0, p - y0
        n = cross(e1, e2)
        square = dot(n, n)[..., None]
        g1, g2 = cross(e2, n) / square, cross(n, e1) / square
        n = n / np.sqrt(square)
        h = dot(n, r)[..., None]
        g = np.stack([-g1 - g2, g1, g2], axis=-2)
        beta = (g * r[..., None, :]).sum(axis=-1)
        beta[..., 0] += 1.0
        corners = beta[..., None, None] * np.eye(3) - h[..., None, None] * g[..., :, None] * n[..., None, None, :]
        a, b = z[..., 1 + first, :], z[..., 1 + second, :]
        along = b - a
        away = p - a
        if kind == 2:
            away = away - (dot(away, along) / dot(along, along))[..., None] * along
        one = np.broadcast_to(np.eye(3), (*corners.shape[:-3], 1, 3, 3))
        normal = n if kind == 3 else away / np.sqrt(dot(away, away))[..., None]
        return np.concatenate([one, -corners], axis=-3), normal

    return law


def edge_law(at):
    """B and m of two edges, nearest within both or at an end of one or of both."""
    free_s, free_t = (0.0 < value < 1.0 for value in at)

    def law(z):
        u, v, gap = z[..., 1, :] - z[..., 0, :], z[..., 3, :] - z[..., 2, :], z[..., 0, :] - z[..., 2, :]
        s, t = np.full_like(u[..., 0], at[0]), np.full_like(u[..., 0], at[1])
        if free_s and free_t:
            # The nearest points minimise |gap + s u - t v|: two linear equations.
            m = np.stack([np.stack([dot(u, u), -dot(u, v)], -1), np.stack([-dot(u, v), dot(v, v)], -1)], -2)
            found = np.linalg.solve(m, np.stack([-dot(u, gap), dot(v, gap)], -1)[..., None])[..., 0]
            s, t = found[..., 0], found[..., 1]
        elif free_s:
            s = dot(u, t[..., None] * v - gap) / dot(u, u)
        elif free_t:
            t = dot(v, gap + s[..., None] * u) / dot(v, v)
        apart = gap + s[..., None] * u - t[..., None] * v
        n = cross(u, v)
        h = dot(n, apart) / dot(n, n) if free_s and free_t else np.zeros_like(s)
        shares = np.stack([1.0 - s, s, t - 1.0, -t], axis=-1)
        arms = np.stack([-v, v, u, -u], axis=-2)
        matrices = shares[..., None, None] * np.eye(3) + h[..., None, None, None] * skew(arms)
        return matrices, apart / np.sqrt(dot(apart, apart))[..., None]

    return law


TRIANGLES = {
    "inside": (3, (0.2, 0.3, 0.5), 0, 2),
    "edge 01": (2, (0.4, 0.6, 0.0), 0, 1),
    "edge 12": (2, (0.0, 0.4, 0.6), 1, 2),
    "edge 20": (2, (0.3, 0.0, 0.7), 0, 2),
    "edge 20 at its end 0": (2, (1.0, 0.0, 0.0), 0, 2),
    "edge 12 at its end 1": (2, (0.0, 1.0, 0.0), 1, 2),
    "edge 12 at its end 2": (2, (0.0, 0.0, 1.0), 1, 2),
    "corner 1": (1, (0.0, 1.0, 0.0), 1, 1),
}
EDGES = {"both": (0.4, 0.7), "first": (0.4, 1.0), "second": (0.0, 0.3), "ends": (1.0, 0.0)}


@pytest.mark.parametrize("case", [*TRIANGLES, *EDGES])
def test_friction_in_a_frame(case):
    rng = np.random.default_rng(3)
    count = 40
    z = rng.standard_normal((count, 4, 3))
    z_end = z + 0.3 * rng.standard_normal(z.shape)
    anchor, along = 0.3 * rng.standard_normal((count, 3)), rng.standard_normal((count, 4))
    limit, spring = rng.uniform(0.05, 1.0, count), rng.uniform(0.5, 2.0, count)
    limit[:3] = 0.0
    turned = rng.standard_normal((count, 4, 3))
    if case in TRIANGLES:
        kind, at, first, second = TRIANGLES[case]
        law, turned = triangle_law(kind, first, second), np.zeros_like(turned)
    else:
        law = edge_law(EDGES[case])
    direction = rng.standard_normal((count, 3))
    frames = Frames()
    if case in TRIANGLES:
        frames.of_triangles(z, np.full(count, kind), np.tile(at, (count, 1)), direction)
    else:
        frames.of_edges(z, np.tile(EDGES[case], (count, 1)), direction, turned)

    def friction(z, z_end, anchor, numbers):
        b, m = law(z)
        change = dot(turned, z - z.real).sum(axis=-1) if np.iscomplexobj(z) else 0.0
        stiff = spring + change + numbers[..., 3]
        bound = limit + numbers[..., :3].sum(axis=-1)
        w = anchor + (b @ (z_end - z)[..., None])[..., 0].sum(axis=-2)
        u = w - m * dot(m, w)[..., None]
        length = np.sqrt(dot(u, u))
        longest = 2.0 * bound / stiff
        beyond = length.real > longest.real
        pull = np.where(beyond, bound / length, stiff * (1.0 - 0.5 * length / np.where(beyond, 1.0, longest)))
        kept = np.where(beyond, longest / length, 1.0)
        push = np.swapaxes(b, -1, -2) @ (pull[..., None] * u)[..., None, :, None]
        slip = np.concatenate([kept[..., None] * u, np.where(beyond, length - longest, 0.0)[..., None] / DT], -1)
        return push[..., 0].reshape(*push.shape[:-3], 12), slip

    changes = np.zeros((count, 5, 2))
    changes[:, 0, 0], changes[:, 0, 1] = limit, spring
    changes[:, 1:4, 0], changes[:, 4, 1] = along[:, :3], along[:, 3]
    force, force_start, force_along, *slips = frames.rub(z_end - z, anchor, changes, DT)
    (by_z, _, by_anchor, by_numbers), slip_by = complex_step(friction, z, z_end, anchor, np.zeros((count, 4)))
    expected = friction(z, z_end, anchor, np.zeros((count, 4)))[0]
    assert 0 < np.count_nonzero(np.abs(slips[0][:, 3]).max(axis=-1)) < count  # some slide, some hold
    assert np.allclose(force, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())
    pairs = [
        (force_start, by_z.reshape(count, 12, 12)),
        (force_along, np.concatenate([by_anchor, by_numbers * along[:, None]], axis=-1)),
        (slips[0], slip_by[0].reshape(count, 4, 12)),
        (slips[1], slip_by[1].reshape(count, 4, 12)),
        (slips[2], np.concatenate([slip_by[2], slip_by[3] * along[:, None]], axis=-1)),
    ]
    for ours, reference in pairs:
        assert np.abs(ours - reference).max() < 1e-12 * np.abs(reference).max()


def test_friction_derivatives():
    """By slip, normal, limit and spring; some slide, some hold, some have never been pressed, some have not moved."""
    rng = np.random.default_rng(4)
    count = 200
    w, m = rng.standard_normal((2, count, 3))
    m /= np.linalg.norm(m, axis=1)[:, None]
    limit, spring = rng.uniform(0.05, 2.0, count), rng.uniform(0.5, 2.0, count)
    limit[:20], w[10:30] = 0.0, 0.0

    def law(w, m, limit, spring):
        u = w - m * dot(m, w)[..., None]
        length = np.sqrt(dot(u, u))[..., None]
        longest = 2.0 * limit / spring
        slides = length.real > longest.real
        beyond = slides | (limit.real == 0.0)
        still = length == 0.0
        far, near = np.where(still, 1.0, length), np.where(longest == 0.0, 1.0, longest)
        pull = np.where(beyond, limit / far, spring * (1.0 - 0.5 * length / near))
        return u * pull, u * np.where(beyond, longest / far, 1.0), np.where(slides, (length - longest) / DT, 0.0)

    found = friction_derivatives(w, m, limit, spring, DT)
    expected = complex_step(law, w, m, limit[:, None], spring[:, None])
    for ours, reference in zip((found.force_by, found.slip_by, found.speed_by), expected, strict=True):
        for a, b in zip(ours, reference, strict=True):
            assert np.abs(a - b).max() < 1e-12 * np.abs(b).max()
