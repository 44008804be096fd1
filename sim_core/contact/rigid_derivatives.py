"""Exact derivatives of contact with a rigid shape by the start of the step, its memory and the body's turn.

With p the sample, c the body's node, R its rotation now and R_n at the start, y_n = R_n^T (p_n - c_n) and the slip

    w = R (anchor - y_n) + p - c,    m = R n(y_n),

friction follows from :mod:`sim_core.contact.friction_derivatives`; a turn of the body changes R by R [omega]x. The
tangent plane changes with y_n where the shape is curved, dn = phi'' dy.

The slip of what rests, 1e-9 m, is a difference of positions of 0.1 m, and is known to 1e-8 of itself. Near the verge of
slip, at the share y of the longest elastic slip, friction holds with k A (1 - y) alone, once by the end of the step (in
the Hessian) and once, negative, by its start: the same rounded y in both, or a shift of the body would push it.
"""

from dataclasses import dataclass

import numpy as np
import taichi as ti

from sim_core.contact.added_laws import AddedLaws
from sim_core.contact.friction_derivatives import friction_derivatives
from sim_core.contact.pressure_and_friction import OFFSET, REACH, STIFFNESS, by_range, normal_law
from sim_core.contact.shapes import signed_distance
from sim_core.energies.linearised import ByNumber, Linearised, axes_of, cross, dot, gathered, placed, places, skew
from sim_core.energies.term import Internals
from sim_core.kernels import F1, F2, F3, BoundKernel, vec3


@ti.kernel
def _surface(y: F2, shape: F1, distance: F1, normal: F2, second: F3):
    ti.loop_config(serialize=True)
    for s in range(y.shape[0]):
        d, n, curved = signed_distance(vec3(y[s, 0], y[s, 1], y[s, 2]), shape)
        distance[s] = d
        for i in ti.static(range(3)):
            normal[s, i] = n[i]
            for j in ti.static(range(3)):
                second[s, i, j] = curved[i, j]


@dataclass(frozen=True)
class RigidStep:
    """What happened at the samples in a step. Positions relative to the body's node [m] ``(n, 3)``: ``before``,
    ``after``; ``slip``: elastic slip within the tangent plane [m] ``(n, 3)``, with the round-off that it has in the
    Hessian; rotations ``(3, 3)``; ``nodes`` and ``weights`` ``(n, k)``, the body's node last with -1."""

    nodes: np.ndarray
    weights: np.ndarray
    areas: np.ndarray
    before: np.ndarray
    after: np.ndarray
    slip: np.ndarray
    rotation_start: np.ndarray
    rotation: np.ndarray
    limit: np.ndarray
    dt: float


class ShapeSurface:
    """Signed distance [m], its gradient and its second derivative [1/m] at ``count`` points of a body."""

    def __init__(self, shape: np.ndarray, count: int) -> None:
        self._y = np.zeros((count, 3))
        self._found = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))
        self._measure = BoundKernel(_surface, self._y, shape, *self._found)

    def at(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All three at points [m] ``(count, 3)``."""
        self._y[:] = y
        self._measure()
        distance, normal, second = (found.copy() for found in self._found)
        return distance, normal, second


def rigid_derivatives(
    at: RigidStep, c: np.ndarray, laws: AddedLaws, surface: ShapeSurface, internals: Internals, n_nodes: int
) -> Linearised:
    """Derivatives of one step; ``c``, ``laws``: of the term; ``surface``: of its shape; ``internals``: from before."""
    place, size = places(internals), sum(a.size for a in internals.values())
    r = at.rotation
    turned = np.stack([(r @ skew(e)).ravel() for e in np.eye(3)], axis=-1)[None]
    nine = place["rotation"].reshape(1, 9)
    memory_turn = [(turned, nine, np.arange(3)[None])]
    distance, normal_now, curved_now = surface.at(at.after @ r)
    gap = distance - c[OFFSET]
    some = np.flatnonzero((gap < c[REACH]) | (at.limit > 0.0))
    count = len(some)
    if not count:
        return Linearised(memory_turn=placed(*memory_turn, shape=(size, 3)))
    weights, areas, before, after = at.weights[some], at.areas[some], at.before[some], at.after[some]
    anchor, load, speed = (internals[n][some] for n in ("anchor", "load", "slip_speed"))
    y, here = before @ at.rotation_start, after @ r
    _, normal, curved = (found[some] for found in surface.at(at.before @ at.rotation_start))
    gap, normal_now, curved_now = gap[some], normal_now[some], curved_now[some]
    _, push, steep = normal_law(c, gap)
    added = np.zeros((count, 3))
    laws.write_normal(gap, added, some)
    whole_push, whole_steep = push + added[:, 1], steep + added[:, 2]
    plane = normal @ r.T
    slip = at.slip[some] + plane * dot(plane, anchor @ r.T + after - y @ r.T)[:, None]
    rub = friction_derivatives(slip, plane, at.limit[some], c[STIFFNESS] * areas, at.dt)
    bound = laws.bound(c, load, areas, speed)
    by_load, by_speed = bound.by_load, bound.by_speed

    # Derivatives of w and m by: the position at the start, R_n, the anchor, a turn, the position at the end.
    twist = np.zeros((count, 3, 9))
    for j in range(3):
        twist[:, j, j::3] = before
    steps = (np.broadcast_to(at.rotation_start.T, (count, 3, 3)), twist)
    slips = [(-r @ dy, r @ curved @ dy) for dy in steps]
    zero = np.zeros((count, 3, 3))
    slips += [(np.broadcast_to(r, zero.shape), zero), (-r @ skew(anchor - y), -r @ skew(normal))]
    slips.append((np.broadcast_to(np.eye(3), zero.shape), zero))
    forces, anchors, speeds = ([rub.chain(by, *s) for s in slips] for by in (rub.force_by, rub.slip_by, rub.speed_by))

    limits = np.stack([by_load, by_speed], axis=-1)[:, None]
    moved = [here_by.transpose(0, 1, 2) for here_by in (np.broadcast_to(r.T, zero.shape), skew(here))]
    loads = [-(areas * steep)[:, None, None] * (normal_now[:, None] @ dy) for dy in moved]
    pressed = [
        -(areas * whole_steep)[:, None, None] * ((normal_now @ r.T)[:, :, None] * (normal_now[:, None] @ dy))
        + (areas * whole_push)[:, None, None] * (r @ curved_now @ dy)
        for dy in moved
    ]
    pressed[1] = pressed[1] - (areas * whole_push)[:, None, None] * (r @ skew(normal_now))
    anchors[3] = anchors[3] + r @ skew(rub.slip @ r)

    axes, own = axes_of(at.nodes[some]), place["anchor"][some]
    nines = np.broadcast_to(nine, (count, 9))
    pair = np.stack([place["load"][some], place["slip_speed"][some]], axis=-1)
    three = np.broadcast_to(np.arange(3), (count, 3))

    def rows(block: np.ndarray) -> np.ndarray:
        """From a sample to its nodes, along the second axis."""
        return np.asarray((weights[:, :, None, None] * block[:, None]).reshape(count, -1, block.shape[-1]))

    def columns(block: np.ndarray) -> np.ndarray:
        return np.asarray(np.swapaxes(rows(np.swapaxes(block, 1, 2)), 1, 2))

    rubbed = rub.force_by[2] @ limits
    touching = (areas * push > 0.0)[:, None, None]
    kept = [
        (np.where(touching, r.T @ a, 0.0), own) for a in (*anchors, rub.slip_by[2] @ limits)
    ] + [(np.where(touching, v, 0.0), pair[:, 1:]) for v in (*speeds, rub.speed_by[2] @ limits)]  # fmt: skip
    to = [axes, nines, own, three, axes, pair]
    spread = [columns(b) if k in (0, 4) else b for k, b in enumerate(b for b, _ in kept[:6])]
    spread_speed = [columns(b) if k in (0, 4) else b for k, b in enumerate(b for b, _ in kept[6:])]

    def memory(*which: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        return [(spread[k], own, to[k]) for k in which] + [(spread_speed[k], pair[:, 1:], to[k]) for k in which]

    arms = skew(after)

    def moment(*parts: tuple[np.ndarray, np.ndarray]) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        return [(arms @ block, three, column) for block, column in parts]

    force = (areas * whole_push)[:, None] * (normal_now @ r.T) - rub.force
    by_end = arms @ (pressed[0] - forces[4]) - skew(force)
    whole = 3 * n_nodes

    def changed(limit: np.ndarray, spring: np.ndarray, grown: np.ndarray) -> tuple[np.ndarray, ...]:
        """Of forces, elastic slips, slip speeds and moments, one row a sample, along changes of the samples' limits,
        springs and normal forces."""
        turned_by = [by[2][..., 0] * limit[:, None] + by[3][..., 0] * spring[:, None] for by in
                     (rub.force_by, rub.slip_by, rub.speed_by)]  # fmt: skip
        force = turned_by[0] - grown[:, None] * (normal_now @ r.T)
        held = touching[:, 0]
        slip, speed = np.where(held, turned_by[1] @ r, 0.0), np.where(held, turned_by[2], 0.0)
        return rows(force[..., None])[..., 0], slip, speed, -cross(after, force)

    def number(limit: np.ndarray, spring: np.ndarray, load: np.ndarray, beside: np.ndarray) -> ByNumber:
        """Of all samples together. ``load``: change of what keeps the surfaces apart; ``beside``: of other pressure."""
        force, slip, speed, turning = changed(limit, spring, load + beside)
        kept = gathered((slip, own), (load, pair[:, 0]), (speed, pair[:, 1:]), size=size)
        return ByNumber(gathered((force, axes), size=whole), kept, turning.sum(axis=0))

    none = np.zeros(count)
    numbers = {q: number(limit, none, none, none) for q, limit in bound.by_number.items()}
    numbers |= {q: number(none, none, none, areas * by) for q, by in laws.normal_by(gap, some).items()}
    numbers["stiffness_pa_per_m"] = number(none, areas, areas * push / c[STIFFNESS], none)
    numbers["offset_m"] = number(none, none, areas * steep, areas * added[:, 2])
    numbers["range_m"] = number(none, none, areas * by_range(c, gap)[1], none)
    wider = [a[..., None] for a in changed(bound.by_area, c[STIFFNESS] * np.ones(count), whole_push)]
    sample, samples = some[:, None], len(at.areas)
    return Linearised(
        numbers=numbers,
        force_rest=placed((wider[0], axes, sample), shape=(whole, samples)),
        memory_rest=placed(
            *((wider[1], own, sample), (push[:, None, None], pair[:, :1], sample), (wider[2], pair[:, 1:], sample)),
            shape=(size, samples),
        ),
        moment_rest=placed((wider[3], three, sample), shape=(3, samples)),
        force_start=placed((columns(rows(forces[0])), axes, axes), shape=(whole, whole)),
        force_memory=placed(
            *((rows(forces[1]), axes, nines), (rows(forces[2]), axes, own), (rows(rubbed), axes, pair)),
            shape=(whole, size),
        ),
        force_turn=placed((rows(forces[3] - pressed[1]), axes, three), shape=(whole, 3)),
        memory_start=placed(*memory(0), shape=(size, whole)),
        memory_memory=placed(*memory(1, 2, 5), shape=(size, size)),
        memory_end=placed(*memory(4), (columns(loads[0]), pair[:, :1], axes), shape=(size, whole)),
        memory_turn=placed(*memory(3), (loads[1], pair[:, :1], three), *memory_turn, shape=(size, 3)),
        moment_start=placed(*moment((columns(-forces[0]), axes)), shape=(3, whole)),
        moment_memory=placed(*moment((-forces[1], nines), (-forces[2], own), (-rubbed, pair)), shape=(3, size)),
        moment_end=placed((columns(by_end), three, axes), shape=(3, whole)),
        moment_turn=placed(*moment((pressed[1] - forces[3], three)), shape=(3, 3)),
    )
