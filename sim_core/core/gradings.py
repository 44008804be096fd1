"""Stiffness that changes in time, for the record of the core: formulas that it evaluates at the start of each step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from sim_core.core.elastic import elastic_slopes
from sim_core.core.layout import Layout
from sim_core.core.materials import KINDS, point_laws
from sim_core.core.mechanics import Mechanics
from sim_core.core.slopes import NumberSlopes
from sim_core.energies.bending import Bending
from sim_core.energies.grading import Grading
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean

Graded = Membrane | Bending | NeoHookean


def changing(layout: Layout) -> list[tuple[int, int, Graded, Grading]]:
    """Terms whose stiffness changes in time: the kind of their elements, the first of these in the record, the term and
    its factors."""
    found: list[tuple[int, int, Graded, Grading]] = []
    groups: dict[type, Sequence[Graded]] = {
        Membrane: layout.membranes,
        Bending: layout.bendings,
        NeoHookean: layout.gels,
    }
    for kind, terms in groups.items():
        first = 0
        for term in terms:
            if term.grading is not None and term.grading.changes:
                found.append((KINDS[kind], first, term, term.grading))
            first += len(term.damping)
    return found


def start_of(layout: Layout, term: Graded) -> int | None:
    """Number of the first element of a term among those whose stiffness changes in time; None: it does not."""
    first = 0
    for _, _, own, grading in changing(layout):
        if own is term:
            return first
        first += len(grading.places)
    return None


def at_the_start(layout: Layout) -> None:
    """Let all stiffness be that at the start of a rollout."""
    for _, _, term, _ in changing(layout):
        term.grade_at(0.0)


def gradings(scene: Mechanics, layout: Layout, by: NumberSlopes, columns: int, bend_of: np.ndarray) -> dict[str, Any]:
    """Fields of the record; ``columns``: room for derivatives; ``bend_of``: columns of the blocks of bending."""
    parts = changing(layout)
    maps = [(term.name, *found) for _, _, term, grading in parts for found in grading.maps]
    numbers = [(owner, key, name, v[name]) for owner, key, e, v in maps for name in e.formula.arguments[4:]]
    slopes = np.zeros((len(numbers), columns))
    for k, (owner, key, name, _) in enumerate(numbers):
        slopes[k, : by.count] = dict(by.of(owner)).get(f"{key}.{name}", 0.0)
    starts = np.cumsum([0, *(len(grading.places) for *_, grading in parts)])
    return {
        "graded": len(parts),
        "graded_kind": [kind for kind, *_ in parts],
        "graded_first": [first for _, first, *_ in parts],
        "graded_start": starts,
        "graded_place": np.concatenate([*(grading.places for *_, grading in parts), np.empty((0, 3))]),
        "graded_map_start": np.cumsum([0, *(len(grading.maps) for *_, grading in parts)]),
        "graded_function": [effect.formula.address for _, _, effect, _ in maps],
        "graded_number_start": np.cumsum([0, *(len(effect.formula.arguments) - 4 for _, _, effect, _ in maps)]),
        "graded_number": [value for *_, value in numbers],
        "d_graded_number": slopes,
        "material_graded": _of_points(scene, parts, starts),
        **_couplings(layout, parts, starts, by, bend_of),
    }


def _of_points(scene: Mechanics, parts: list[tuple[int, int, Graded, Grading]], starts: np.ndarray) -> np.ndarray:
    """Which of the elements each point of a material law is of, -1: of none."""
    found = [np.empty(0, dtype=int)]
    for law in point_laws(scene):
        own = np.full(len(law.measure.areas), -1)
        for (_, _, term, grading), start in zip(parts, starts, strict=False):
            if law.measure.own is term:
                own = law.measure.at_points(start + np.arange(len(grading.places)))
        found.append(own)
    return np.concatenate(found)


def _couplings(
    layout: Layout,
    parts: list[tuple[int, int, Graded, Grading]],
    starts: np.ndarray,
    by: NumberSlopes,
    bend_of: np.ndarray,
) -> dict[str, Any]:
    """What each triangle adds to the couplings of hinges."""
    pattern, elements, places = layout.pattern, [np.empty(0, dtype=int)], [np.empty(0, dtype=int)]
    values: list[list[np.ndarray]] = [[np.empty(0)] for _ in range(2 + 2 * len(bend_of))]
    first = 0
    for bending in layout.bendings:
        for (_, _, term, _), start in zip(parts, starts, strict=False):
            if term is not bending:
                continue
            stiffness = bending.sizes[:, None, None] * bending.stiffness
            columns = [stiffness, bending.damping[:, None, None] * stiffness]
            columns += list(_changes(bending, stiffness, by, bend_of))
            for t in range(len(bending.sizes)):
                rows = bending.operator[3 * t : 3 * t + 3]
                hinges = np.unique(rows.indices)
                b = rows[:, hinges].toarray()
                for k, column in enumerate(columns):
                    values[k].append((b.T @ column[t] @ b).ravel())
                elements.append(np.full(len(hinges) ** 2, start + t))
                for hinge in first + hinges:
                    own = slice(*pattern.indptr[hinge : hinge + 2])
                    places.append(own.start + np.searchsorted(pattern.indices[own], first + hinges))
        first += len(bending.hinge_nodes)
    whole = [np.concatenate(v) for v in values]
    return {
        "shared": len(whole[0]),
        "shared_element": np.concatenate(elements),
        "shared_coupling": np.concatenate(places),
        "shared_stiffness": whole[0],
        "shared_damping": whole[1],
        "d_shared_stiffness": np.concatenate([*whole[2::2], np.empty(0)]),
        "d_shared_damping": np.concatenate([*whole[3::2], np.empty(0)]),
    }


def _changes(bending: Bending, stiffness: np.ndarray, by: NumberSlopes, columns: np.ndarray) -> Iterator[np.ndarray]:
    """Derivatives of area times stiffness, and of that times damping, in the blocks of bending, one after the other."""
    slopes = elastic_slopes(bending, by)
    for column in columns.tolist():
        harder, rubbed = np.zeros_like(stiffness), np.zeros_like(stiffness)
        for slope, more, damping in slopes:
            if more is not None:
                harder = harder + slope[column] * more
                rubbed = rubbed + slope[column] * bending.damping[:, None, None] * more
            if damping is not None:
                rubbed = rubbed + slope[column] * damping[:, None, None] * stiffness
        yield harder
        yield rubbed
