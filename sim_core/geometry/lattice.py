"""Lattices of cells, graded towards a place: lines of a block, a square grid, a square core with rings around it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.errors import ConfigError


def check_positive(**values: tuple[float, ...]) -> None:
    for name, given in values.items():
        if not all(v > 0 for v in given):
            raise ConfigError(f"{name} = {given} must be positive.", "Give positive sizes and cell counts.")


def graded_lines(
    size_m: tuple[float, float, float], cells: tuple[int, int, int], towards: Mapping[str, float]
) -> list[np.ndarray]:
    """Coordinates [m] of the cells' borders along each axis, symmetric about zero unless graded towards an end.

    The widths of the cells grow in proportion from the place that is named to those farthest from it, where they are
    1 / ratio times as wide. Several gradings along one axis multiply.
    """
    places = [{"x_min": 0.0, "x_middle": 0.5, "x_max": 1.0}, {"y_min": 0.0, "y_middle": 0.5, "y_max": 1.0}]
    places.append({"bottom": 0.0, "z_middle": 0.5, "top": 1.0})
    unknown = set(towards).difference(*places)
    if unknown:
        raise ConfigError(
            f"Cells cannot be graded towards {min(unknown)!r}.",
            f"Choose among: {', '.join(name for axis in places for name in axis)}.",
        )
    lines = []
    for length, count, named in zip(size_m, cells, places, strict=True):
        middle = (np.arange(count) + 0.5) / count
        widths = np.ones(count)
        for name, at in named.items():
            ratio = towards.get(name, 1.0)
            check_positive(**{f"The ratio towards {name}": (ratio,)})
            away = np.abs(middle - at)
            widths *= (1.0 / ratio) ** ((away - away.min()) / max(float(np.ptp(away)), 1e-300))
        whole = np.concatenate([[0.0], np.cumsum(widths)]) / widths.sum() - 0.5
        if count % 2 == 0 and all(towards.get(name, 1.0) == 1.0 for name, at in named.items() if at != 0.5):
            whole[count // 2] = 0.0
        lines.append(length * whole)
    return lines


def core_and_ring_shares(n: int, rings: int, ratio: float) -> np.ndarray:
    """Shares of the radius at which the core of a disc with ``n`` cells along its side ends, and its rings end. The
    widths of the cells on the axis are ``ratio`` times those at the rim."""
    check_positive(**{"The ratio towards the axis": (ratio,)})
    widths = (1.0 / ratio) ** np.linspace(0.0, 1.0, rings + 1)
    widths[0] *= n / 2.0
    shares: np.ndarray = np.cumsum(widths) / widths.sum()
    return shares


def grid(nx: int, ny: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lattice nodes ``(k, 2)``, their quads ``(q, 4)`` counter-clockwise, and the colour of each node."""
    j, i = (g.ravel() for g in np.meshgrid(np.arange(ny + 1), np.arange(nx + 1), indexing="ij"))
    first = (np.arange(ny)[:, None] * (nx + 1) + np.arange(nx)[None, :]).ravel()
    quads = np.column_stack([first, first + 1, first + nx + 2, first + nx + 1])
    return np.column_stack([i, j]), quads, (i + j) % 2


def core_and_rings(n: int, rings: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A square grid of ``n x n`` cells with ``rings`` rings of quads around it.

    Returns the place of each node in the square [-1, 1]^2 (nodes of a ring: on its border), its ring
    as a share ``(k, 1)`` (0 in the core, 1 at the rim), the quads ``(q, 4)``, and the node colours.
    """
    flat, quads, parity = grid(n, n)
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    border = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    square = [2.0 * flat / n - 1.0]
    ring, colour, all_quads, inside = [np.zeros(len(flat))], [parity], [quads], border
    for r in range(1, rings + 1):
        outside = len(flat) + (r - 1) * len(border) + np.arange(len(border))
        square.append(square[0][border])
        ring.append(np.full(len(border), r / rings))
        colour.append((parity[border] + r) % 2)
        all_quads.append(np.column_stack([inside, outside, np.roll(outside, -1), np.roll(inside, -1)]))
        inside = outside
    place, share = np.concatenate(square), np.concatenate(ring)[:, None]
    return place, share, np.concatenate(all_quads), np.concatenate(colour)
