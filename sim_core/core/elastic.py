"""Elastic elements of sheets and gels for the record of the core, with the derivatives of their numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from sim_core.core.layout import Layout
from sim_core.core.slopes import NumberSlopes
from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.neo_hookean_moduli import apart


def collected(parts: dict[int, list[np.ndarray]], *shapes: tuple[int, ...]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Columns that have a block, and their blocks stacked. ``parts``: by column, arrays of the ``shapes``."""
    columns = sorted(parts)
    stacks = [
        np.stack([parts[c][k] for c in columns]) if columns else np.zeros((0, *shape)) for k, shape in enumerate(shapes)
    ]
    return np.array(columns, dtype=np.int32), stacks


def elastic_slopes(
    term: Membrane | Bending, by: NumberSlopes
) -> list[tuple[np.ndarray, np.ndarray | None, np.ndarray | None]]:
    """By each number of a term that changes: its slopes ``(p,)``, the derivative of area times stiffness ``(m, 3, 3)``
    and that of damping ``(m,)``; None: zero, or the core's own where the stiffness changes in time."""
    found: list[tuple[np.ndarray, np.ndarray | None, np.ndarray | None]] = []
    for quantity, slope in by.of(term.name):
        if quantity == "stiffness_damping_s":
            found.append((slope, None, np.ones(len(term.sizes))))
        elif term.grading is not None and quantity in term.grading.numbers:
            grown = term.sizes * (0.0 if term.grading.changes else term.grading.by(quantity))
            found.append((slope, grown[:, None, None] * term.stiffness, None))
        else:
            found.append((slope, term.sizes[:, None, None] * term.stiffness_by(quantity), None))
    return found


def triangles(layout: Layout, by: NumberSlopes) -> dict[str, Any]:
    """Triangles that stretch."""
    terms = layout.membranes
    count = sum(len(t.triangles) for t in terms)
    parts: dict[int, list[np.ndarray]] = {}
    first = 0
    for term in terms:
        own = slice(first, first + len(term.triangles))
        first = own.stop
        for slope, stiffness, damping in elastic_slopes(term, by):
            for column in np.flatnonzero(slope).tolist():
                part = parts.setdefault(column, [np.zeros((count, 3, 3)), np.zeros(count)])
                if stiffness is not None:
                    part[0][own] += slope[column] * stiffness
                if damping is not None:
                    part[1][own] += slope[column] * damping
    columns, (d_stiffness, d_damping) = collected(parts, (count, 3, 3), (count,))
    return {
        "triangles": count,
        "triangle": np.vstack([t.triangles for t in terms] or [np.empty((0, 3))]),
        "hats": np.concatenate([t.hats() for t in terms] or [np.empty((0, 3, 2))]),
        "stretch_stiffness": np.concatenate(
            [t.sizes[:, None, None] * t.stiffness for t in terms] or [np.empty((0, 3, 3))]
        ),
        "stretch_damping": np.concatenate([t.damping for t in terms] or [np.empty(0)]),
        "stretch_blocks": len(columns),
        "stretch_of": columns,
        "d_stretch_stiffness": d_stiffness,
        "d_stretch_damping": d_damping,
    }


def hinges(layout: Layout, by: NumberSlopes) -> dict[str, Any]:
    """Hinges that bend, and how they are coupled: sum over triangles of B^T A D B, and of B^T A beta D B."""
    terms, pattern = layout.bendings, layout.pattern
    rows = np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))

    def coupled(parts: list[np.ndarray]) -> np.ndarray:
        """On the pattern, of stiffnesses ``(m, 3, 3)`` of the triangles of all terms."""
        if not any(part.any() for part in parts):
            return np.zeros(len(rows))
        blocks = []
        for term, part in zip(terms, parts, strict=True):
            starts = np.arange(len(part) + 1)
            middle = sp.bsr_matrix((part, starts[:-1], starts), shape=(3 * len(part),) * 2)
            blocks.append(term.operator.T @ (middle @ term.operator))
        return np.asarray(sp.block_diag(blocks).tocsr()[rows, pattern.indices]).ravel()

    stiffness = [t.sizes[:, None, None] * t.stiffness for t in terms]
    none = [np.zeros_like(s) for s in stiffness]
    parts: dict[int, list[np.ndarray]] = {}
    for at, term in enumerate(terms):
        for slope, harder, damping in elastic_slopes(term, by):
            changed, rubbed = list(none), list(none)
            if harder is not None:
                changed[at], rubbed[at] = harder, term.damping[:, None, None] * harder
            if damping is not None:
                rubbed[at] = rubbed[at] + damping[:, None, None] * stiffness[at]
            by_stiffness, by_damping = coupled(changed), coupled(rubbed)
            for column in np.flatnonzero(slope).tolist():
                part = parts.setdefault(column, [np.zeros(len(rows)), np.zeros(len(rows))])
                part[0] += slope[column] * by_stiffness
                part[1] += slope[column] * by_damping
    columns, (d_stiffness, d_damping) = collected(parts, (len(rows),), (len(rows),))
    return {
        "hinges": pattern.shape[0],
        "couplings": len(rows),
        "hinge": np.vstack([t.hinge_nodes for t in terms] or [np.empty((0, 4))]),
        "rest_angle": np.concatenate([t.rest_angles for t in terms] or [np.empty(0)]),
        "coupling_start": pattern.indptr,
        "coupling_column": pattern.indices,
        "bend_stiffness": coupled(stiffness),
        "bend_damping": coupled([t.damping[:, None, None] * s for t, s in zip(terms, stiffness, strict=True)]),
        "bend_blocks": len(columns),
        "bend_of": columns,
        "d_bend_stiffness": d_stiffness,
        "d_bend_damping": d_damping,
    }


def _gel_slopes(term: NeoHookean, by: NumberSlopes) -> list[tuple[np.ndarray, np.ndarray]]:
    """By each number of a gel that changes: its slopes ``(p,)``, the derivatives of the numbers of the elements, and of
    the logarithm of their factor, ``(m, 5)``."""
    found = []
    for quantity, slope in by.of(term.name):
        change = np.zeros((len(term.tets), 5))
        if quantity == "stiffness_damping_s":
            change[:, 3] = 1.0
        elif term.grading is not None and quantity in term.grading.numbers:
            change[:, 4] = 0.0 if term.grading.changes else term.grading.by(quantity)
        else:
            change[:, :3] = apart(term.moduli_by(quantity))
        found.append((slope, change))
    return found


def tetrahedra(layout: Layout, by: NumberSlopes) -> dict[str, Any]:
    """Tetrahedra of gels."""
    terms = layout.gels
    count, first = sum(len(t.tets) for t in terms), 0
    parts: dict[int, list[np.ndarray]] = {}
    for term in terms:
        own = slice(first, first + len(term.tets))
        first = own.stop
        for slope, change in _gel_slopes(term, by):
            for column in np.flatnonzero(slope).tolist():
                parts.setdefault(column, [np.zeros((count, 5))])[0][own] += slope[column] * change
    columns, (d_gel,) = collected(parts, (count, 5))
    numbers = [np.column_stack([apart(t.moduli), t.damping]) for t in terms]
    return {
        "tetrahedra": count,
        "tetrahedron": np.vstack([t.tets for t in terms] or [np.empty((0, 10))]),
        "gel_gradient": np.concatenate([t.gradients for t in terms] or [np.empty((0, 10, 3))]),
        "gel_volume": np.concatenate([t.sizes for t in terms] or [np.empty((0, 4))]),
        "gel_number": np.concatenate(numbers or [np.empty((0, 4))]),
        "gel_blocks": len(columns),
        "gel_of": columns,
        "d_gel": d_gel,
    }
