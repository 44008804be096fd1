"""Exact derivatives of contact between deformable surfaces by the start of the step and the memory.

A pair rubs in a frame that it had at the start of the step (:mod:`sim_core.contact.surface`,
:mod:`sim_core.contact.edges`): with four points z (sample and corners, or the ends of two edges), their motions
and matrices B_a(z),

    w = anchor + sum_a B_a (z'_a - z_a),    force on point a:  B_a^T F(w, m(z), limit, spring(z))

Friction is differentiated by :mod:`sim_core.contact.rubbing`, the frames by a complex step of the functions here.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim_core.contact.law import STIFFNESS
from sim_core.contact.rubbing import limit_derivatives, limits_by_numbers, rubbing
from sim_core.energies.linearised import ByNumber, Linearised, axes_of, complex_step, cross, dot, gathered, placed, skew
from sim_core.energies.term import Buffers


@dataclass(frozen=True)
class Pairs:
    """Pairs of one step that press or rub. ``nodes`` ``(n, k)`` and ``weights`` ``(n, k, 4)`` of the four points;
    ``start``, ``move``: of the points [m] ``(n, 4, 3)``; ``memory``, ``after``: places of (anchor, load, slip speed) in
    the old and in the new internal variables ``(n, 5)`` each, -1 where there is none; ``anchor`` ``(n, 3)``, ``load``,
    ``speed``: old; ``load_now``: at the end."""

    nodes: np.ndarray
    weights: np.ndarray
    start: np.ndarray
    move: np.ndarray
    limit: np.ndarray
    spring: np.ndarray
    memory: np.ndarray
    after: np.ndarray
    anchor: np.ndarray
    load: np.ndarray
    speed: np.ndarray
    load_now: np.ndarray

    @property
    def touching(self) -> np.ndarray:
        return self.load_now > 0.0


@dataclass(frozen=True)
class Frames:
    """B ``(n, 4, 3, 3)`` and m ``(n, 3)`` of pairs, their derivatives by the points ``(..., 4, 3)``, and that of the
    spring ``(n, 4, 3)`` (None: it has none)."""

    b: np.ndarray
    m: np.ndarray
    db: np.ndarray
    dm: np.ndarray
    dspring: np.ndarray | None = None


def framed_derivatives(
    pairs: Pairs,
    frames: Frames,
    loads: tuple[np.ndarray, np.ndarray],
    total: np.ndarray,
    c: np.ndarray,
    dt: float,
    sizes: tuple[int, ...],
) -> Linearised:
    """Derivatives of one step. ``loads``: derivatives of the new loads by nodes ``(n, q, 3)``, and these nodes
    ``(n, q)``; ``total``: dE/dx of the term ``(3 n_nodes)``; ``sizes``: number of nodes, of old and of new internal
    variables."""
    count, whole = len(pairs.limit), 3 * sizes[0]
    old, new = sizes[1:]
    b, m = frames.b, frames.m
    w = pairs.anchor + np.einsum("naij,naj->ni", b, pairs.move)
    rub = rubbing(w, m, pairs.limit, pairs.spring, dt)
    by_load, by_speed = limit_derivatives(c, pairs.load, pairs.speed)

    # Derivatives of w and m by the points at the start (12) and at the end (12), and by the memory (5).
    motion = b.transpose(0, 2, 1, 3).reshape(count, 3, 12)
    turning = np.einsum("naijbk,naj->nibk", frames.db, pairs.move).reshape(count, 3, 12)
    dm = frames.dm.reshape(count, 3, 12)

    def chain(by: tuple[np.ndarray, ...], start: bool) -> np.ndarray:
        out = rub.chain(by, turning - motion, dm) if start else np.asarray(by[0] @ motion)
        if start and frames.dspring is not None:
            out = out + by[3] * frames.dspring.reshape(count, 1, 12)
        return out

    def remember(by: tuple[np.ndarray, ...]) -> np.ndarray:
        limits = by[2] * np.stack([by_load, by_speed], axis=-1)[:, None]
        return np.asarray(np.concatenate([by[0], limits], axis=-1))

    back = b.transpose(0, 1, 3, 2).reshape(count, 12, 3)
    turned = np.einsum("naijbk,ni->najbk", frames.db, rub.force).reshape(count, 12, 12)
    weights = pairs.weights

    def rows(block: np.ndarray) -> np.ndarray:
        """From the four points to the nodes, along the second axis."""
        out = np.einsum("nka,najq->nkjq", weights, block.reshape(count, 4, 3, -1))
        return np.asarray(out.reshape(count, -1, block.shape[-1]))

    def columns(block: np.ndarray) -> np.ndarray:
        return np.asarray(np.swapaxes(rows(np.swapaxes(block, 1, 2)), 1, 2))

    axes = axes_of(pairs.nodes)
    rubs = (pairs.limit > 0.0)[:, None, None]
    force_start = rows(columns(np.where(rubs, back @ chain(rub.force_by, True) + turned, 0.0)))
    force_memory = rows(np.where(rubs, back @ remember(rub.force_by), 0.0))
    known, kept = pairs.memory[:, 0] >= 0, pairs.after[:, 0] >= 0
    hold = kept & pairs.touching
    slip, speed = pairs.after[:, :3], pairs.after[:, 4:]
    held = hold & known
    pushed, by_nodes = loads

    def number(limit: np.ndarray, spring: np.ndarray, pressed: float) -> ByNumber:
        """Along changes of the pairs' limits and springs, and of the pressure (as a share)."""
        force, by_slip, by_speed = (
            by[2][..., 0] * limit[:, None] + by[3][..., 0] * spring[:, None]
            for by in (rub.force_by, rub.slip_by, rub.speed_by)
        )
        nodal = gathered((rows(np.where(rubs, back @ force[..., None], 0.0)), axes), size=whole)
        memory = gathered(
            (by_slip[hold], slip[hold]), (by_speed[hold], speed[hold]),
            (pressed * pairs.load_now[kept], pairs.after[kept, 3]), size=new,
        )  # fmt: skip
        return ByNumber(nodal + pressed * (total - rubbed), memory, np.zeros(3))

    rubbed = gathered((rows(np.where(rubs, back @ rub.force[..., None], 0.0)), axes), size=whole)
    none = np.zeros(count)
    numbers = {q: number(by, none, 0.0) for q, by in limits_by_numbers(c, pairs.load, pairs.speed).items()}
    numbers["stiffness_pa_per_m"] = number(none, pairs.spring / c[STIFFNESS], 1.0 / c[STIFFNESS])
    return Linearised(
        numbers=numbers,
        force_start=placed((force_start, axes, axes), shape=(whole, whole)),
        force_memory=placed((force_memory[known], axes[known], pairs.memory[known]), shape=(whole, old)),
        memory_start=placed(
            (columns(chain(rub.slip_by, True))[hold], slip[hold], axes[hold]),
            (columns(chain(rub.speed_by, True))[hold], speed[hold], axes[hold]),
            shape=(new, whole),
        ),
        memory_memory=placed(
            (remember(rub.slip_by)[held], slip[held], pairs.memory[held]),
            (remember(rub.speed_by)[held], speed[held], pairs.memory[held]),
            shape=(new, old),
        ),
        memory_end=placed(
            (columns(chain(rub.slip_by, False))[hold], slip[hold], axes[hold]),
            (columns(chain(rub.speed_by, False))[hold], speed[hold], axes[hold]),
            (pushed[kept].reshape(int(kept.sum()), 1, -1), pairs.after[kept, 3:4], axes_of(by_nodes[kept])),
            shape=(new, whole),
        ),
    )


def exerted(add_gradient: Callable[[], None], buffers: Buffers) -> np.ndarray:
    """dE/dx of one term, flattened."""
    kept = buffers.gradient.copy()
    buffers.gradient[:] = 0.0
    add_gradient()
    out = np.array(buffers.gradient.ravel())
    buffers.gradient[:] = kept
    return out


def memory_places(place: dict[str, np.ndarray], rows: np.ndarray) -> np.ndarray:
    """Places of (anchor, load, slip speed) of some samples, ``(n, 5)``."""
    return np.column_stack([place["anchor"][rows], place["load"][rows], place["slip_speed"][rows]])


def triangle_frames(z: np.ndarray, kind: np.ndarray, at: np.ndarray, direction: np.ndarray) -> Frames:
    """Frames of samples over triangles. ``z``: sample and corners [m] ``(n, 4, 3)``; ``kind``: 3 face, 2 edge, 1 corner
    of the closest point with weights ``at`` ``(n, 3)``; ``direction``: the lagged normal ``(n, 3)``."""
    # On an edge: its two corners; at a corner: that one twice.
    first = np.where(at[:, 0] != 0.0, 0, np.where(at[:, 1] != 0.0, 1, 2))
    second = np.where(at[:, 2] != 0.0, 2, np.where(at[:, 1] != 0.0, 1, 0))
    every = np.arange(len(z))
    face, edge = (kind == 3)[:, None], (kind == 2)[:, None]

    def law(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, y0, y1, y2 = (z[..., k, :] for k in range(4))
        e1, e2 = y1 - y0, y2 - y0
        n = cross(e1, e2)
        square = dot(n, n)[..., None]
        g1, g2 = cross(e2, n) / square, cross(n, e1) / square
        n = n / np.sqrt(square)
        r = p - y0
        h = dot(n, r)[..., None]
        g = np.stack([-g1 - g2, g1, g2], axis=-2)
        beta = (g * r[..., None, :]).sum(axis=-1)
        beta[..., 0] += 1.0
        corners = beta[..., None, None] * np.eye(3) - h[..., None, None] * g[..., :, None] * n[..., None, None, :]
        a, b = z[:, every, 1 + first], z[:, every, 1 + second]
        along = b - a
        length = dot(along, along)[..., None]
        share = dot(p - a, along)[..., None] / np.where(length == 0.0, 1.0, length)
        away = p - a - np.where(edge, share, 0.0) * along
        away = away / np.sqrt(dot(away, away))[..., None]
        one = np.broadcast_to(np.eye(3), (*corners.shape[:-3], 1, 3, 3))
        return np.concatenate([one, -corners], axis=-3), np.where(face, n, away)

    return _differentiated(law, z, direction)


def edge_frames(z: np.ndarray, at: np.ndarray, direction: np.ndarray) -> Frames:
    """Frames of pairs of edges. ``z``: their ends [m] ``(n, 4, 3)``; ``at``: closest points (s, t) ``(n, 2)``."""
    free = (at > 0.0) & (at < 1.0)
    both, only_s, only_t = free.all(axis=1), free[:, 0] & ~free[:, 1], free[:, 1] & ~free[:, 0]

    def law(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u, v, gap = z[..., 1, :] - z[..., 0, :], z[..., 3, :] - z[..., 2, :], z[..., 0, :] - z[..., 2, :]
        uu, vv, uv = dot(u, u), dot(v, v), dot(u, v)
        ug, vg = dot(u, gap), dot(v, gap)
        den = np.where(both, uu * vv - uv * uv, 1.0)
        s = np.where(both, (uv * vg - vv * ug) / den, np.where(only_s, (uv * at[:, 1] - ug) / uu, at[:, 0]))
        t = np.where(both, (uu * vg - uv * ug) / den, np.where(only_t, (uv * at[:, 0] + vg) / vv, at[:, 1]))
        apart = gap + s[..., None] * u - t[..., None] * v
        n = cross(u, v)
        square = dot(n, n)
        crossing = both & (square.real > 0.0)
        h = np.where(crossing, dot(n, apart) / np.where(crossing, square, 1.0), 0.0)
        shares = np.stack([1.0 - s, s, t - 1.0, -t], axis=-1)
        arms = np.stack([-v, v, u, -u], axis=-2)
        matrices = shares[..., None, None] * np.eye(3) + h[..., None, None, None] * skew(arms)
        return matrices, apart / np.sqrt(dot(apart, apart))[..., None]

    return _differentiated(law, z, direction)


def _differentiated(law: Callable[..., tuple[np.ndarray, ...]], z: np.ndarray, direction: np.ndarray) -> Frames:
    """Frames with their derivatives; the normal gets the sign of ``direction``."""
    b, m = (out[0].real for out in law(z[None].astype(complex)))
    (db,), (dm,) = complex_step(law, z)
    sign = np.where(dot(m, direction) < 0.0, -1.0, 1.0)
    return Frames(b, sign[:, None] * m, db, sign[:, None, None, None] * dm)
