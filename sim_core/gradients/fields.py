"""Derivatives by fields over elements and nodes (:mod:`sim_core.scene.fields`), summed up on the way back.

The force of an element is its factor f times that of a uniform body, so the derivative of the residual by f, times the
weights of the forces, is the work of the element's forces along these weights, over f; with f = prod (q / q_rig)^p

    dL/dq = sum_parts p W_part / q,    W_part = weights . F_element    (of mass: weights . m_element (a - g))

New internal variables do not depend on f: relaxing stresses are kept per f, plastic curvatures know no stiffness. A
field costs one kernel a term and step.

Poisson's ratio enters through the moduli of its element, and with them through the stress that relaxes and the norm by
which a sheet yields, so beside forces it changes the new internal variables xi' (``by_nu``, closed forms):

    dL/dnu = weights . dF_element/dnu + weights of xi' . dxi'_element/dnu

The mean dilatation of a gel is that of one element, so no element's nu acts in another.

Of the numbers of the elements' memories, damping by stiffness changes forces alone, share and time constant of a
relaxation the new stress that relaxes, too (``by_damping``, ``by_relaxation``); damping by mass is a share of the mass
that a velocity meets. The curvature at which a triangle yields, and its hardening, enter through its flow alone.

Rest angles enter through the curvatures of the triangles around a hinge
(:meth:`sim_core.energies.bending.Bending.by_rest_angles`), shapes at rest through all that is measured on them
(:mod:`sim_core.gradients.rest_shape`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from sim_core.energies.linearised import Linearised
from sim_core.energies.term import ByRestAngles, Declaring, Quantity, Term
from sim_core.gradients.elements import Alongs
from sim_core.gradients.parameter_jacobian import borne_by_mass, damped_by_mass
from sim_core.gradients.rest_shape import RestSums
from sim_core.gradients.step import Weights
from sim_core.scene.fields import MASS, MASS_DAMPING, MASS_POWERS, REST, REST_ANGLE
from sim_core.scene.scene import Scene


class FieldSums:
    """Sums over the steps of a rollout, for fields by ``names``."""

    def __init__(self, scene: Scene, names: Sequence[str]) -> None:
        self._scene = scene
        self._names = list(dict.fromkeys(scene.fields.resolve(name) for name in names))
        self._values = {name: scene.fields[name] for name in self._names}
        terms: dict[str, Any] = {t.name: t for t in scene.system.terms}
        pairs = [(body, key) for body, _, key in (name.partition(".") for name in self._names)]
        self._declared = {pair: list(_declared(scene, *pair)) for pair in pairs}
        self._powers = {
            (body, key): {**{t.name: q.power for t, q in found if q.power}, **_of_mass(key)}
            for (body, key), found in self._declared.items()
        }
        self._parts = list(dict.fromkeys((b, part) for (b, _), powers in self._powers.items() for part in powers))
        self._others = [(body, key) for body, key in pairs if key != REST and not self._powers[body, key]]
        self._terms = {(b, part): terms[part] for b, part in self._parts if part in terms}
        weighed = [b for b, part in self._parts if part == MASS] + [b for b, key in self._others if key == MASS_DAMPING]
        self._masses = {b: scene.fields.mass_blocks(b) for b in weighed}
        self._numbers = scene.values(scene.rig)
        self.shapes = RestSums(scene, self._numbers, [body for body, key in pairs if key == REST])
        self.clear()

    def __bool__(self) -> bool:
        return bool(self._names)

    def clear(self) -> None:
        """Begin anew."""
        self._work: dict[tuple[str, str], Any] = dict.fromkeys(self._parts, 0.0)
        self._by: dict[tuple[str, str], Any] = dict.fromkeys(self._others, 0.0)
        self.shapes.clear()

    def add(self, alongs: Alongs, after: Weights, terms: Mapping[str, Linearised]) -> None:
        """Add what a step has. ``after``: weights of its end; ``terms``: as linearised."""
        step, pulled = alongs.step, alongs.pulled
        for part, term in self._terms.items():
            self._work[part] = self._work[part] + alongs.work(term)
        for body, of in self._parts:
            if of == MASS:
                density = self._numbers.density[body]
                pairs = borne_by_mass(self._scene, density, body, step, pulled.exerted, pulled.borne)
                work = sum(factor * self._by_mass(body, v, w) for factor, v, w in pairs)
                self._work[body, MASS] = self._work[body, MASS] + work
        for body, key in self._others:
            self._by[body, key] = self._by[body, key] + self._of(body, key, alongs)
        if self.shapes:
            self.shapes.add(step, alongs.internals, pulled, after, terms)

    def _of(self, body: str, key: str, alongs: Alongs) -> Any:
        """What a step adds to the derivatives by a field that is no factor of an energy or a mass."""
        step, exerted = alongs.step, alongs.pulled.exerted
        if key == MASS_DAMPING:
            return self._by_mass(body, *damped_by_mass(self._scene.system, self._numbers.density[body], step, exerted))
        total: Any = 0.0
        if key == REST_ANGLE:
            for term in self._scene.bodies[body].terms:
                if isinstance(term, ByRestAngles):
                    before = alongs.internals[term.name]
                    term.begin_step(step, before)
                    total = total + term.by_rest_angles(exerted, alongs.kept[term.name], step, before)
            return total
        for term, _ in self._declared[body, key]:
            total = total + alongs.by(term, key)
        return total

    def _by_mass(self, body: str, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Products of nodal vectors ``(n, 3)`` by the masses of the elements of a body, ``(m,)``."""
        nodes, blocks = self._masses[body]
        return np.asarray(np.einsum("mab,mai,mbi->m", blocks, v[nodes], w[nodes]))

    def gradients(self) -> dict[str, np.ndarray]:
        """Derivatives by the values of each field in SI units."""
        out, shapes = {}, self.shapes.gradients()
        for name, values in self._values.items():
            body, key = name.split(".")
            if key == REST:
                out[name] = shapes[body]
                continue
            if powers := self._powers[body, key]:
                total = sum(power * self._work[body, part] for part, power in powers.items()) / values
            else:
                total = self._by[body, key]
            out[name] = total + np.zeros(len(values))
        return out


def _declared(scene: Scene, body: str, key: str) -> Iterator[tuple[Term, Quantity]]:
    """Terms of a body whose elements have values of a quantity, as they declare it."""
    for term in scene.bodies[body].terms:
        if isinstance(term, Declaring):
            yield from ((term, q) for q in term.quantities if q.name == key)


def _of_mass(key: str) -> dict[str, int]:
    """The power of a quantity in the mass of an element, if it has any."""
    return {MASS: MASS_POWERS[key]} if key in MASS_POWERS else {}
