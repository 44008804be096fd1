"""Exact derivatives of contact between deformable surfaces by the start of the step and the memory.

A pair rubs in a frame that it had at the start of the step (:mod:`sim_core.contact.surface`,
:mod:`sim_core.contact.edges`): with four points z (sample and corners, or the ends of two edges), their motions
and matrices B_a(z),

    w = anchor + sum_a B_a (z'_a - z_a),    force on point a:  B_a^T F(w, m(z), limit, spring(z))

Frames and friction are differentiated by :mod:`sim_core.contact.local_frame_kernels`, for the four points; what they do
is passed on to the nodes that the points are made of.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from sim_core.contact.added_laws import Bound
from sim_core.contact.local_frame_kernels import Frames
from sim_core.contact.pressure_and_friction import STIFFNESS
from sim_core.energies.linearised import ByNumber, Linearised, axes_of, gathered, placed
from sim_core.energies.term import Buffers


@dataclass(frozen=True)
class Pairs:
    """Pairs of one step that press or slide against each other. ``nodes`` ``(n, k)``: of the four points; ``point``
    ``(k,)``: which one a node belongs to, with the ``weights`` ``(n, k)``; ``move``: of the points [m] ``(n, 4, 3)``;
    ``memory``, ``after``: places of (anchor, load, slip speed) in the old and in the new internal variables ``(n, 5)``
    each, -1 where there is none; ``anchor`` ``(n, 3)``: old; ``bound``: on friction, by the old load and slip speed;
    ``load_now``: at the end."""

    nodes: np.ndarray
    point: np.ndarray
    weights: np.ndarray
    move: np.ndarray
    limit: np.ndarray
    spring: np.ndarray
    memory: np.ndarray
    after: np.ndarray
    anchor: np.ndarray
    bound: Bound
    load_now: np.ndarray

    @property
    def touching(self) -> np.ndarray:
        return self.load_now > 0.0


@dataclass(frozen=True)
class Loads:
    """Derivatives of the loads of pairs at the end of a step: by ``nodes`` ``(n, q)`` [N/m] ``(n, q, 3)``, and by the
    distance without gap and by the range of the law [N/m] ``(n,)`` each. ``forces_by_offset``, ``forces_by_range``: of
    the nodes' normal forces by these [N/m] ``(n, q, 3)`` each, of added pressures by the distance too. ``added``:
    normal forces on the nodes by added pressures [N] ``(n, q, 3)``; ``added_by``: their derivatives by numbers."""

    by_nodes: np.ndarray
    nodes: np.ndarray
    by_offset: np.ndarray
    forces_by_offset: np.ndarray
    by_range: np.ndarray
    forces_by_range: np.ndarray
    added: np.ndarray | None = None
    added_by: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class AtRest:
    """Derivatives of pairs by ``r`` measures of the shape at rest each: of their springs, of their friction bounds and
    of their loads at the end ``(n, r)``, and of the pressing forces on the nodes of the loads ``(n, q, 3, r)``.
    ``columns``: which measures, int ``(n, r)``, of ``count``."""

    spring: np.ndarray
    bound: np.ndarray
    load: np.ndarray
    pressing: np.ndarray
    columns: np.ndarray
    count: int


def framed_derivatives(
    pairs: Pairs,
    frames: Frames,
    loads: Loads,
    at_rest: AtRest,
    total: np.ndarray,
    c: np.ndarray,
    dt: float,
    sizes: tuple[int, ...],
) -> Linearised:
    """Derivatives of one step. ``frames``: of the pairs, just made; ``total``: dE/dx of the term ``(3 n_nodes)``;
    ``sizes``: number of nodes, of old and of new internal variables."""
    count, whole = len(pairs.limit), 3 * sizes[0]
    old, new = sizes[1:]
    law = np.zeros((count, 5, 2))
    law[:, 0, 0], law[:, 0, 1] = pairs.limit, pairs.spring
    law[:, 1, 0], law[:, 2, 0] = pairs.bound.by_load, pairs.bound.by_speed
    law[:, 3, 0] = 1.0
    law[:, 4, 1] = pairs.spring / c[STIFFNESS]
    force, force_start, force_along, *slips = frames.rub(pairs.move, pairs.anchor, law, dt)
    slip_start, slip_end, slip_along = slips
    weights, point = pairs.weights, pairs.point

    def rows(block: np.ndarray) -> np.ndarray:
        """From the four points to the nodes, along the second axis."""
        spread = block.reshape(count, 4, 3, -1)[:, point] * weights[:, :, None, None]
        return np.asarray(spread.reshape(count, 3 * len(point), -1))

    def columns(block: np.ndarray) -> np.ndarray:
        spread = block.reshape(count, -1, 4, 3)[:, :, point] * weights[:, None, :, None]
        return np.asarray(spread.reshape(count, -1, 3 * len(point)))

    axes = axes_of(pairs.nodes)
    rubs = pairs.limit > 0.0
    known, kept = pairs.memory[:, 0] >= 0, pairs.after[:, 0] >= 0
    hold = kept & pairs.touching
    held = hold & known
    slides = pairs.after[:, [0, 1, 2, 4]]
    along = rows(np.where(rubs[:, None, None], force_along, 0.0))
    pushed, pushed_at = loads.by_nodes.reshape(count, 1, -1), axes_of(loads.nodes)

    def by_bound(change: np.ndarray) -> ByNumber:
        """Along changes of the friction bounds."""
        memory = gathered((slip_along[hold, :, 5] * change[hold, None], slides[hold]), size=new)
        return ByNumber(gathered((along[..., 5] * change[:, None], axes), size=whole), memory, np.zeros(3))

    def by_stiffness() -> ByNumber:
        """Of springs, and of the pressure that keeps the surfaces apart."""
        share = 1.0 / c[STIFFNESS]
        memory = gathered(
            (slip_along[hold, :, 6], slides[hold]), (share * pairs.load_now[kept], pairs.after[kept, 3]), size=new
        )
        return ByNumber(gathered((along[..., 6], axes), size=whole) + share * normal, memory, np.zeros(3))

    def by_law(load: np.ndarray, forces: np.ndarray) -> ByNumber:
        """Of the pressure that keeps the surfaces apart, by a number of its law."""
        memory = gathered((load[kept], pairs.after[kept, 3]), size=new)
        return ByNumber(gathered((forces.reshape(count, -1), pushed_at), size=whole), memory, np.zeros(3))

    normal = total - gathered((rows(np.where(rubs[:, None], force, 0.0))[..., 0], axes), size=whole)
    if loads.added is not None:
        normal = normal - gathered((loads.added.reshape(count, -1), pushed_at), size=whole)
    numbers = {
        **{name: by_bound(change) for name, change in pairs.bound.by_number.items()},
        **{
            name: ByNumber(gathered((by.reshape(count, -1), pushed_at), size=whole), np.zeros(new), np.zeros(3))
            for name, by in loads.added_by.items()
        },
        "stiffness_pa_per_m": by_stiffness(),
        "offset_m": by_law(loads.by_offset, loads.forces_by_offset),
        "range_m": by_law(loads.by_range, loads.forces_by_range),
    }
    start = rubs.nonzero()[0]
    sprung = np.where(pairs.spring > 0.0, pairs.spring, np.inf) / c[STIFFNESS]  # along the last direction
    stiffer, wider = (at_rest.spring / sprung[:, None])[:, None], at_rest.bound[:, None]
    measured = at_rest.columns
    return Linearised(
        numbers=numbers,
        force_rest=placed(
            (along[..., 6:] * stiffer + along[..., 5:6] * wider, axes, measured),
            (at_rest.pressing.reshape(count, -1, measured.shape[1]), pushed_at, measured),
            shape=(whole, at_rest.count),
        ),
        memory_rest=placed(
            (
                slip_along[hold, :, 6:] * stiffer[hold] + slip_along[hold, :, 5:6] * wider[hold],
                slides[hold],
                measured[hold],
            ),
            (at_rest.load[kept, None], pairs.after[kept, 3:4], measured[kept]),
            shape=(new, at_rest.count),
        ),
        force_start=placed((rows(columns(force_start))[start], axes[start], axes[start]), shape=(whole, whole)),
        force_memory=placed((along[known, :, :5], axes[known], pairs.memory[known]), shape=(whole, old)),
        memory_start=placed((columns(slip_start)[hold], slides[hold], axes[hold]), shape=(new, whole)),
        memory_memory=placed((slip_along[held, :, :5], slides[held], pairs.memory[held]), shape=(new, old)),
        memory_end=placed(
            (columns(slip_end)[hold], slides[hold], axes[hold]),
            (pushed[kept], pairs.after[kept, 3:4], pushed_at[kept]),
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
