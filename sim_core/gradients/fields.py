"""Derivatives by fields over elements and nodes (:mod:`sim_core.scene.fields`).

The core sums up the weights of its record's arrays (include/record.hpp): stiffnesses of triangles and of pairs of
hinges, moduli of tetrahedra, masses. What a field changes in these is known in closed form, so the derivatives by its
values are products with the sums, once a gradient. The force of an element is its factor f times that of a uniform
body, with f = prod (q / q_rig)^p; so with W_part the product of a part's stiffness or mass with its weights,

    dL/dq = sum_parts p W_part / q

Poisson's ratio enters through the moduli of an element, and with them through what laws see of them and the norm by
which a sheet yields; dampings, shares and time constants through numbers of their own. Rest angles enter through the
curvatures of the triangles around a hinge, shapes at rest through all that is measured on them
(:mod:`sim_core.gradients.rest_shape`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from sim_core.core.adjoint import CoreAdjoint
from sim_core.core.curving import Curving, curving_of
from sim_core.core.gradings import at_the_start
from sim_core.core.layout import layout_of
from sim_core.core.materials import PointLaw, point_laws
from sim_core.core.slopes import NumberSlopes
from sim_core.energies.air_drag import AirDragTerm
from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.neo_hookean_moduli import apart
from sim_core.gradients.rest_shape import GelShape, RestShapes, SheetShape
from sim_core.scene.fields import (
    FLOW,
    MASS,
    MASS_DAMPING,
    MASS_POWERS,
    NU,
    RELAXATION,
    REST,
    REST_ANGLE,
    STIFFNESS_DAMPING,
)
from sim_core.scene.scene import Scene

Elastic = Membrane | Bending | NeoHookean


class FieldGradients:
    """Fields by ``names``, for one adjoint after the other."""

    def __init__(self, scene: Scene, names: Sequence[str]) -> None:
        self._scene = scene
        self._names = list(dict.fromkeys(scene.fields.resolve(name) for name in names))
        self._values = {name: scene.fields[name] for name in self._names}
        self._density = scene.values(scene.rig).density
        self.shapes = RestShapes(scene, [name.split(".")[0] for name in self._names if name.endswith(f".{REST}")])
        self.curving = curving_of(scene, self.shapes.pairs) if self._names else None
        """What the core sums up weights of, in addition to the record's arrays."""

    def damped(self, numbers: NumberSlopes) -> NumberSlopes:
        """The numbers along which a rollout is differentiated, and a column more where the core has to look at rates of
        strain for a damping that may be nowhere."""
        bodies = [name.split(".")[0] for name in self._names if name.endswith(f".{STIFFNESS_DAMPING}")]
        terms = [t.name for body in bodies for t in self._scene.bodies[body].terms if isinstance(t, Elastic)]
        if not terms:
            return numbers
        keys = [*numbers.keys, *(("terms", term, STIFFNESS_DAMPING) for term in terms)]
        table = np.zeros((len(keys), numbers.count + 1))
        table[: len(numbers.keys), : numbers.count] = numbers.table.reshape(len(numbers.keys), numbers.count)
        table[len(numbers.keys) :, -1] = 1.0
        return NumberSlopes(keys, table)

    def gradients(self, adjoint: CoreAdjoint) -> dict[str, np.ndarray]:
        """Derivatives by the values of each field in SI units."""
        at_the_start(layout_of(self._scene))
        if self.curving is None:
            return {}
        shapes = self.shapes.total(adjoint) if self.shapes else np.zeros(0)
        parts: dict[str, _Body] = {}
        out = {}
        for name, values in self._values.items():
            body, key = name.split(".")
            if body not in parts:
                parts[body] = _Body(self._scene, body, self._density[body], adjoint, self.curving)
            if key != REST:
                out[name] = parts[body].by(key, values)
            elif body in self.shapes.sheets:
                parts[body].pass_on_sheet(self.shapes.sheets[body], shapes)
            else:
                parts[body].pass_on_gel(self.shapes.gels[body], shapes)
        return out | {f"{body}.{REST}": shapes[self._scene.bodies[body].nodes] for body in self.shapes.bodies}


class _Body:
    """What the sums have for one body."""

    def __init__(self, scene: Scene, name: str, density: float, adjoint: CoreAdjoint, curving: Curving) -> None:
        self._scene, self._name, self._density, self._adjoint = scene, name, density, adjoint
        self._curving = curving
        self._terms: list[Elastic] = [t for t in scene.bodies[name].terms if isinstance(t, Elastic)]
        self._laws = [found for found in self._of_points() if any(found[0].measure.own is t for t in self._terms)]

    def by(self, key: str, values: np.ndarray) -> np.ndarray:
        """Derivatives by the ``values`` of one of its fields."""
        if key == REST_ANGLE:
            total = self._adjoint.elements("rest_angle")[self._hinges()]
            for law, rows, _ in self._laws:
                if isinstance(law.measure.own, Bending):  # curvatures at the end and at the start of a step
                    total = total - law.measure.own.operator.T @ (rows[:, :3] + rows[:, 3:6]).ravel()
            return np.asarray(total)
        if key in FLOW:
            return np.asarray(sum(rows[:, law.layout.places[key][0]] for law, rows, _ in self._laws if not law.prefix))
        if key in RELAXATION:
            number, argument = self._scene.fields.quantity(self._name, key), RELAXATION[key]
            law, rows, _ = next(found for found in self._laws if f"{found[0].prefix}{argument}" == number)
            return np.asarray(law.measure.of_elements(rows[:, law.layout.places[argument][0]]))
        if key == MASS_DAMPING:
            return self._by_masses(damping=True)
        if key in (NU, STIFFNESS_DAMPING):
            total = np.asarray(sum(self._of(term, key) for term in self._terms))
            for law, rows, _ in self._laws if key == NU else ():
                change = law.layout.rows({"d": law.measure.stiffness_by(NU)}, len(rows))
                total = total + law.measure.of_elements((rows * change).sum(axis=1))
            return np.asarray(total)
        powers = {q.name: q.power for term in self._terms for q in term.quantities} | MASS_POWERS
        assert key in powers, key
        total = np.zeros(len(values))
        for term in self._terms:
            power = next((q.power for q in term.quantities if q.name == key), 0)
            if power:
                total += power * self._of(term, "work")
        for law, _, work in self._laws:
            power = next((q.power for q in law.measure.quantities if q.name == key), 0)
            total += power * law.measure.of_elements(work)
        if key in MASS_POWERS:
            total += MASS_POWERS[key] * (self._by_masses() + self._alpha() * self._by_masses(damping=True))
        return np.asarray(total / values)

    def _of_points(self) -> Iterator[tuple[PointLaw, np.ndarray, np.ndarray]]:
        """All laws of effects, weights of what their points see ``(n, inputs)``, and the points' work ``(n,)``."""
        rows, work = self._adjoint.elements("material_row"), self._adjoint.elements("material_area")
        row = first = 0
        for law in point_laws(self._scene):
            count, inputs = len(law.measure.areas), law.layout.inputs
            yield law, rows[row : row + count * inputs].reshape(count, inputs), work[first : first + count]
            row, first = row + count * inputs, first + count

    def _of(self, term: Elastic, what: str) -> np.ndarray:
        """Work of the elements of a term, or their derivatives by nu or by the damping."""
        if isinstance(term, NeoHookean):
            weights = self._adjoint.elements("gel").reshape(-1, 5)[_own(term, layout_of(self._scene).gels)]
            if what == NU:
                return np.asarray((weights[:, :3] * apart(term.moduli_by(NU))).sum(axis=1))
            return weights[:, 3 if what == STIFFNESS_DAMPING else 4]
        stiffness, damping = self._stretching(term) if isinstance(term, Membrane) else self._bending(term)
        if what == STIFFNESS_DAMPING:
            return damping
        change = term.stiffness_by(NU) if what == NU else term.stiffness
        return np.asarray(term.sizes * (stiffness * change).sum(axis=(1, 2)))

    def _stretching(self, term: Membrane) -> tuple[np.ndarray, np.ndarray]:
        """Weights of A h C ``(m, 3, 3)`` and of the damping ``(m,)`` of the triangles."""
        own = _own(term, layout_of(self._scene).membranes)
        stiffness = self._adjoint.elements("stretch_stiffness").reshape(-1, 3, 3)
        return stiffness[own], self._adjoint.elements("stretch_damping")[own]

    def _bending(self, term: Bending) -> tuple[np.ndarray, np.ndarray]:
        """Weights of A D ``(m, 3, 3)``, which hinges are coupled by as sum_T B_T^T A D B_T, and by the same with beta
        where rates count; and of the damping beta ``(m,)``."""
        own, _ = self._curving.own[term.name]
        stiff, rubbed = (self._adjoint.elements(f"curve_{k}").reshape(-1, 3, 3)[own] for k in ("stiffness", "damping"))
        damping = term.sizes * (rubbed * term.stiffness).sum(axis=(1, 2))
        return stiff + term.damping[:, None, None] * rubbed, np.asarray(damping)

    def _hinges(self) -> slice:
        """Its hinges among those of the record."""
        (bending,) = (t for t in self._terms if isinstance(t, Bending))
        terms = layout_of(self._scene).bendings
        first = sum(len(t.hinge_nodes) for t in terms[: _place(bending, terms)])
        return slice(first, first + len(bending.hinge_nodes))

    def _by_masses(self, damping: bool = False) -> np.ndarray:
        """Products of the elements' masses with their weights in inertia and weight, or, with ``damping``, in damping
        by mass per unit of alpha."""
        return np.asarray((self._scene.fields.mass_blocks(self._name)[1] * self._masses(damping)).sum(axis=(1, 2)))

    def _masses(self, damping: bool) -> np.ndarray:
        """These weights, of the blocks of the elements per unit of density ``(m, k, k)``."""
        scene, system = self._scene, self._scene.system
        mass = sp.csr_matrix(system.mass)
        mass.sum_duplicates()
        mass.sort_indices()
        entries = self._adjoint.elements("mass_damping" if damping else "mass")
        nodes, _ = scene.fields.mass_blocks(self._name)
        rows, columns = np.broadcast_arrays(nodes[:, :, None], nodes[:, None, :])
        weights = sp.csr_matrix((entries, mass.indices, mass.indptr), shape=mass.shape)
        found = np.asarray(weights[rows.ravel(), columns.ravel()]).reshape(rows.shape)
        if damping:
            loose = np.asarray(~system.prescribed.all(axis=1))
            return np.asarray(self._density * found * (loose[rows] & loose[columns]))
        return np.asarray(
            self._density * (found + (self._adjoint.elements("external").reshape(-1, 3) @ system.gravity)[rows])
        )

    def _alpha(self) -> np.ndarray:
        return self._scene.fields[f"{self._name}.{MASS_DAMPING}"]

    def pass_on_sheet(self, shape: SheetShape, total: np.ndarray) -> None:
        """Add derivatives by what is measured on a sheet at rest, passed on to the nodes ``(n, 3)``."""
        bending, own = shape.bending, self._curving.own[shape.bending.name]
        membrane = next(t for t in self._terms if isinstance(t, Membrane))
        hats = self._adjoint.elements("hats").reshape(-1, 3, 2)[_own(membrane, layout_of(self._scene).membranes)]
        work = sum(self._of(term, "work") for term in self._terms) + sum(work for *_, work in self._laws)
        work = work + self._by_masses() + self._alpha() * self._by_masses(damping=True)
        factors, first = self._adjoint.elements("drag_factor"), 0
        for term in self._scene.system.terms:
            if isinstance(term, AirDragTerm):
                mine = factors[first : first + len(term.triangles)]
                first += len(term.triangles)
                if term.name.startswith(f"{self._name}."):
                    work = work + mine * term.drag_areas()
        stiff, rubbed, operator = (
            self._adjoint.elements(f"operator_{k}").reshape(-1, 3)[own[1]] for k in ("stiffness", "damping", "law")
        )
        triangle = shape.pairs[0]
        moment = np.einsum("kij,kj->ki", bending.stiffness[triangle], stiff + bending.damping[triangle, None] * rubbed)
        operator = operator + bending.sizes[triangle, None] * moment
        shape.pass_on(hats, work / bending.whole_sizes, operator, self.by(REST_ANGLE, np.zeros(0)), total)

    def pass_on_gel(self, shape: GelShape, total: np.ndarray) -> None:
        """The same of a gel."""
        (term,) = (t for t in self._terms if isinstance(t, NeoHookean))
        own = _own(term, layout_of(self._scene).gels)
        gradient = self._adjoint.elements("gel_gradient").reshape(-1, 4, 10, 3)[own]
        volume = self._adjoint.elements("gel_volume").reshape(-1, 4)[own] * term.sizes
        volume = volume + sum(work.reshape(-1, 4) for *_, work in self._laws)
        mass = self._masses(False) + self._alpha()[:, None, None] * self._masses(True)
        factor = self._scene.fields.factor(self._name, MASS)
        shape.pass_on(gradient, volume, factor[:, None, None] * mass, total)


def _place(term: Any, of: Sequence[Any]) -> int:
    return [other is term for other in of].index(True)


def _own(term: Membrane | NeoHookean, of: Sequence[Any]) -> slice:
    """The elements of a term among those of all of its kind."""
    sizes = [len(t.tets if isinstance(t, NeoHookean) else t.triangles) for t in of]
    first = sum(sizes[: _place(term, of)])
    return slice(first, first + sizes[_place(term, of)])
