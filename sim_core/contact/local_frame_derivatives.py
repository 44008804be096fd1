"""Exact derivatives of contact between deformable surfaces by the start of the step and the memory.

A pair rubs in a frame that it had at the start of the step (:mod:`sim_core.contact.surface`,
:mod:`sim_core.contact.edges`): with four points z (sample and corners, or the ends of two edges), their motions
and matrices B_a(z),

    w = anchor + sum_a B_a (z'_a - z_a),    force on point a:  B_a^T F(w, m(z), limit, spring(z))

Frames and friction are differentiated by :mod:`sim_core.contact.local_frame_kernels`, for the four points; what they do
is passed on to the nodes that the points are made of.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim_core.contact.friction_derivatives import limit_derivatives, limits_by_numbers
from sim_core.contact.law import STIFFNESS
from sim_core.contact.local_frame_kernels import Frames
from sim_core.energies.linearised import ByNumber, Linearised, axes_of, gathered, placed
from sim_core.energies.term import Buffers


@dataclass(frozen=True)
class Pairs:
    """Pairs of one step that press or rub. ``nodes`` ``(n, k)``: of the four points; ``point`` ``(k,)``: which one a
    node belongs to, with the ``weights`` ``(n, k)``; ``move``: of the points [m] ``(n, 4, 3)``; ``memory``, ``after``:
    places of (anchor, load, slip speed) in the old and in the new internal variables ``(n, 5)`` each, -1 where there is
    none; ``anchor`` ``(n, 3)``, ``load``, ``speed``: old; ``load_now``: at the end."""

    nodes: np.ndarray
    point: np.ndarray
    weights: np.ndarray
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
class Loads:
    """Derivatives of the loads of pairs at the end of a step: by ``nodes`` ``(n, q)`` [N/m] ``(n, q, 3)``, and by the
    distance without gap [N/m] ``(n,)``. Load is the derivative of the energy by that distance, so the former are also
    the derivatives of the nodes' forces by it."""

    by_nodes: np.ndarray
    nodes: np.ndarray
    by_offset: np.ndarray


@dataclass(frozen=True)
class AtRest:
    """Derivatives of pairs by ``r`` measures of the shape at rest each: of their springs and of their loads at the end
    ``(n, r)``, and of the pressing forces on the nodes of the loads ``(n, q, 3, r)``. ``columns``: which measures, int
    ``(n, r)``, of ``count``."""

    spring: np.ndarray
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
    law = np.zeros((count, 6, 2))
    law[:, 0, 0], law[:, 0, 1] = pairs.limit, pairs.spring
    law[:, 1, 0], law[:, 2, 0] = limit_derivatives(c, pairs.load, pairs.speed)
    by_number = limits_by_numbers(c, pairs.load, pairs.speed)
    law[:, 3, 0], law[:, 4, 0] = by_number["friction"], by_number["static_excess"]
    law[:, 5, 1] = pairs.spring / c[STIFFNESS]
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

    def number(k: int, pressed: float) -> ByNumber:
        """Along direction ``k``, and a change of the pressure (as a share)."""
        memory = gathered(
            (slip_along[hold, :, k], slides[hold]), (pressed * pairs.load_now[kept], pairs.after[kept, 3]), size=new
        )
        return ByNumber(gathered((along[..., k], axes), size=whole) + pressed * normal, memory, np.zeros(3))

    normal = total - gathered((rows(np.where(rubs[:, None], force, 0.0))[..., 0], axes), size=whole)
    numbers = {
        "friction": number(5, 0.0),
        "static_excess": number(6, 0.0),
        "stiffness_pa_per_m": number(7, 1.0 / c[STIFFNESS]),
        "offset_m": ByNumber(
            gathered((pushed[:, 0], pushed_at), size=whole),
            gathered((loads.by_offset[kept], pairs.after[kept, 3]), size=new),
            np.zeros(3),
        ),
    }
    start = rubs.nonzero()[0]
    sprung = np.where(pairs.spring > 0.0, pairs.spring, np.inf) / c[STIFFNESS]  # along the last direction
    stiffer = (at_rest.spring / sprung[:, None])[:, None]
    measured = at_rest.columns
    return Linearised(
        numbers=numbers,
        force_rest=placed(
            (along[..., -1:] * stiffer, axes, measured),
            (at_rest.pressing.reshape(count, -1, measured.shape[1]), pushed_at, measured),
            shape=(whole, at_rest.count),
        ),
        memory_rest=placed(
            (slip_along[hold, :, -1:] * stiffer[hold], slides[hold], measured[hold]),
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
