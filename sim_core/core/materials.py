"""Material laws of effects, and plastic flow, for the record of the core: rows of what their points see."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from sim_core.core.layout import Layout, layout_of
from sim_core.core.material import MaterialFormula, PointLayout
from sim_core.core.mechanics import Mechanics
from sim_core.core.slopes import NumberSlopes
from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.plastic_flow import LAW as PLASTIC_FLOW
from sim_core.energies.strain import SheetStrain, Strain
from sim_core.energies.strain_law import StrainLaws

KINDS: dict[type, int] = {Membrane: 0, Bending: 1, NeoHookean: 2}
"""Kinds of elements by their terms, as of include/strain_laws.hpp."""

PLASTIC = PointLayout(
    3,
    (("plastic_curvature", (3,)), ("accumulated_curvature", ())),
    ("yield_curvature_per_m", "hardening_ratio"),
)
"""What plastic flow sees of a triangle."""


@dataclass(frozen=True)
class PointLaw:
    """One law of a ``term``. ``prefix``: of the names of its internal variables, and of its numbers, in the term.
    ``numbers``: by argument, ``(n,)`` or one of all points; ``shares``: what points have of the numbers that the term
    is configured with, if not the whole."""

    term: str
    prefix: str
    measure: Strain
    formula: MaterialFormula
    layout: PointLayout
    numbers: Mapping[str, Any]
    shares: Mapping[str, np.ndarray]

    def internals(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Internal variables, or their derivatives, as the term names them, ``(n, size, width)`` each: parts of the
        core's ``(n, states, width)``."""
        at, found = 0, {}
        for name, shape in self.layout.state:
            size = int(np.prod(shape))
            found[f"{self.prefix}{name}"] = rows[:, at : at + size]
            at += size
        return found


def point_laws(scene: Mechanics) -> list[PointLaw]:
    """All laws of the scene, in the order of the record."""
    found: list[PointLaw] = []
    for term in scene.system.terms:
        if isinstance(term, StrainLaws):
            measure: Any = term.measure
            for key, law, values in term.laws:
                layout = law.layout(measure.components)
                shares = {name: term.share(f"{key}.{name}") for name in layout.numbers}
                found.append(PointLaw(term.name, f"{key}.", measure, law.formula, layout, values, shares))
        if isinstance(term, Bending) and term.initial_internals():
            numbers, shares = (
                dict(zip(PLASTIC.numbers, v, strict=True)) for v in (term.flow_numbers, term.flow_shares)
            )
            found.append(PointLaw(term.name, "", SheetStrain(term), PLASTIC_FLOW, PLASTIC, numbers, shares))
    return found


def bent_by_laws(scene: Mechanics) -> list[tuple[Bending, int]]:
    """Terms that bend by laws, with the first of their triangles among those that do."""
    found, first, owners = [], 0, [law.measure.own for law in point_laws(scene)]
    for term in layout_of(scene).bendings:
        if any(own is term for own in owners):
            found.append((term, first))
            first += len(term.whole_sizes)
    return found


def materials(scene: Mechanics, layout: Layout, by: NumberSlopes) -> dict[str, Any]:
    """Fields of the record."""
    laws = point_laws(scene)
    bent = [term for term, _ in bent_by_laws(scene)]
    rows = [law.layout.rows({"d": law.measure.stiffness, **law.numbers}, len(law.measure.areas)) for law in laws]
    elements = [_elements(law, layout, bent) for law in laws]
    blocks = [_blocks(law, by) for law in laws]
    flat = [block for own in blocks for block in own.items()]
    return {
        "material_laws": len(laws),
        "material_kind": [KINDS[type(law.measure.own)] for law in laws],
        "material_inputs": [law.layout.inputs for law in laws],
        "material_states": [law.layout.states for law in laws],
        "material_function": [law.formula.addresses(law.layout) for law in laws],
        "material_start": np.cumsum([0, *(len(e) for e in elements)]),
        "material_row_start": np.cumsum([0, *(r.size for r in rows)]),
        "material_element": np.concatenate([*elements, np.empty(0)]),
        "material_area": np.concatenate([*(law.measure.areas for law in laws), np.empty(0)]),
        "material_row": np.concatenate([*(r.ravel() for r in rows), np.empty(0)]),
        **_curvatures(bent, layout),
        "material_block_start": np.cumsum([0, *(len(own) for own in blocks)]),
        "material_of": [column for column, _ in flat],
        "material_block_row": np.cumsum([0, *(change.size for _, change in flat)]),
        "d_material_row": np.concatenate([*(change.ravel() for _, change in flat), np.empty(0)]),
    }


def _elements(law: PointLaw, layout: Layout, bent: list[Bending]) -> np.ndarray:
    """Numbers of its points among those of all terms of the kind."""
    kinds: list[list[Any]] = [[*layout.membranes], [*bent], [*layout.gels]]
    terms = kinds[KINDS[type(law.measure.own)]]
    first: int = sum(t.whole_sizes.size for t in terms[: _place(law.measure.own, terms)])
    return first + np.arange(len(law.measure.areas))


def _place(one: Any, of: list[Any]) -> int:
    return [other is one for other in of].index(True)


def _blocks(law: PointLaw, by: NumberSlopes) -> dict[int, np.ndarray]:
    """By columns: changes of the rows, and of the logarithm of the area behind each ``(n, inputs + 1)``."""
    found: dict[int, np.ndarray] = {}
    for quantity, slope in by.of(law.term):
        for change in _changes(law, quantity):
            for column in np.flatnonzero(slope).tolist():
                found[column] = found.get(column, 0.0) + slope[column] * change
    return dict(sorted(found.items()))


def _changes(law: PointLaw, quantity: str) -> Iterator[np.ndarray]:
    """What one number of its term changes, if anything."""
    measure, grading, count = law.measure, law.measure.own.grading, len(law.measure.areas)
    change = np.zeros((count, law.layout.inputs + 1))
    argument = quantity.removeprefix(law.prefix)
    if grading is not None and quantity in grading.numbers:
        change[:, -1] = 0.0 if grading.changes else measure.at_points(grading.by(quantity))
        yield change
    elif any(quantity == own.name for own in measure.quantities):
        change[:, :-1] = law.layout.rows({"d": measure.stiffness_by(quantity)}, count)
        yield change
    elif quantity.startswith(law.prefix) and argument in law.layout.numbers:
        change[:, :-1] = law.layout.rows({argument: law.shares.get(argument, 1.0)}, count)
        yield change


def _curvatures(bent: list[Bending], layout: Layout) -> dict[str, Any]:
    """What the angles of hinges make of the curvatures of the triangles of some terms."""
    starts, hinges, weights = [np.zeros(1, dtype=int)], [np.empty(0, dtype=int)], [np.empty((0, 3))]
    firsts = np.cumsum([0, *(len(t.hinge_nodes) for t in layout.bendings)])
    for term in bent:
        parts = [sp.csr_matrix(term.operator[k::3]) for k in range(3)]
        around = sp.csr_matrix(sum(abs(p) for p in parts))
        around.sort_indices()
        rows = np.repeat(np.arange(around.shape[0]), np.diff(around.indptr))
        starts.append(starts[-1][-1] + around.indptr[1:])
        hinges.append(int(firsts[_place(term, layout.bendings)]) + around.indices)
        weights.append(np.stack([np.asarray(p[rows, around.indices]).ravel() for p in parts], axis=-1))
    return {
        "bent": sum(len(t.whole_sizes) for t in bent),
        "bent_start": np.concatenate(starts),
        "bent_hinge": np.concatenate(hinges),
        "bent_weight": np.concatenate(weights),
    }
