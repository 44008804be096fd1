"""Derivatives by fields over elements and nodes (:mod:`sim_core.scene.fields`), summed up on the way back.

The force of an element is its factor f times that of a uniform body, so the derivative of the residual by f, times the
weights of the forces, is the work of the element's forces along these weights, over f; with f = prod (q / q_rig)^p

    dL/dq = sum_parts p W_part / q,    W_part = weights . F_element    (of mass: weights . m_element (a - g))

New internal variables do not depend on f: relaxing stresses are kept per f, plastic curvatures know no stiffness. A
field costs one kernel a term and step.

Poisson's ratio enters through the moduli of its element, and with them through the stress that relaxes and the norm by
which a sheet yields, so beside forces it changes the new internal variables xi' (``by_nu`` of the terms, closed forms):

    dL/dnu = weights . dF_element/dnu + weights of xi' . dxi'_element/dnu

The mean dilatation of a gel is that of one element, so no element's nu acts in another.

The curvature at which a triangle yields, and its hardening, enter through its flow alone.

Rest angles enter through the curvatures of the triangles around a hinge
(:meth:`sim_core.energies.bending.Bending.by_rest_angles`), shapes at rest through all that is measured on them
(:mod:`sim_core.gradients.rest_shape`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sim_core.energies.linearised import Linearised
from sim_core.energies.term import Internals, StepContext
from sim_core.gradients.columns import borne_by_mass
from sim_core.gradients.rest_shape import RestSums
from sim_core.gradients.step import Pulled, Weights
from sim_core.scene.fields import FLOW, MASS, NU, POWERS, REST, REST_ANGLE, YIELD
from sim_core.scene.scene import Scene


class FieldSums:
    """Sums over the steps of a rollout, for fields by ``names``."""

    def __init__(self, scene: Scene, names: Sequence[str]) -> None:
        self._scene = scene
        self._names = list(dict.fromkeys(scene.fields.resolve(name) for name in names))
        self._values = {name: scene.fields[name] for name in self._names}
        terms: dict[str, Any] = {t.name: t for t in scene.system.terms}
        pairs = [name.split(".") for name in self._names]
        self._parts = list(dict.fromkeys((b, part) for b, key in pairs for part in POWERS.get(key, ())))
        self._mixed = {b: _elastic(terms, b) for b, key in pairs if key == NU}
        self._bent = [body for body, key in pairs if key == REST_ANGLE]
        self._flows = [(body, key) for body, key in pairs if key in FLOW]
        self._terms = {(b, part): terms[f"{b}.{part}"] for b, part in self._parts if f"{b}.{part}" in terms}
        self._masses = {b: scene.fields.mass_blocks(b) for b, part in self._parts if part == MASS}
        self._numbers = scene.values(scene.rig)
        self.shapes = RestSums(scene, self._numbers, [body for body, key in pairs if key == REST])
        self.clear()

    def __bool__(self) -> bool:
        return bool(self._names)

    def clear(self) -> None:
        """Begin anew."""
        self._work: dict[tuple[str, str], Any] = dict.fromkeys(self._parts, 0.0)
        self._by_nu: dict[str, Any] = dict.fromkeys(self._mixed, 0.0)
        self._bending: dict[str, Any] = dict.fromkeys(self._bent, 0.0)
        self._by_flow: dict[tuple[str, str], Any] = dict.fromkeys(self._flows, 0.0)
        self.shapes.clear()

    def add(
        self,
        step: StepContext,
        internals: Mapping[str, Internals],
        pulled: Pulled,
        after: Weights,
        terms: Mapping[str, Linearised],
    ) -> None:
        """Add what a step has, at the end of which the system is. ``internals``: before it; ``after``: weights of its
        end; ``terms``: as linearised."""
        exerted, borne, memory = pulled.exerted, pulled.borne, after.memory
        for part, term in self._terms.items():
            term.begin_step(step, internals[term.name])
            self._work[part] = self._work[part] + term.work(exerted, internals[term.name])
        for body in self._masses:
            self._work[body, MASS] = self._work[body, MASS] + self._of_mass(body, step, exerted, borne)
        for body, terms_of in self._mixed.items():
            for term in terms_of:
                term.begin_step(step, internals[term.name])
                found = term.by_nu(exerted, memory[term.name], step, internals[term.name])
                self._by_nu[body] = self._by_nu[body] + found
        for body in self._bent:
            term = self._scene.fields.bending(body)
            term.begin_step(step, internals[term.name])
            found = term.by_rest_angles(exerted, memory[term.name], internals[term.name])
            self._bending[body] = self._bending[body] + found
        for body, key in self._flows:
            term = self._scene.fields.bending(body)
            term.begin_step(step, internals[term.name])
            by = term.by_yield if key == YIELD else term.by_hardening
            found = by(exerted, memory[term.name], internals[term.name])
            self._by_flow[body, key] = self._by_flow[body, key] + found
        if self.shapes:
            self.shapes.add(step, internals, pulled, after, terms)

    def _of_mass(self, body: str, step: StepContext, exerted: np.ndarray, borne: np.ndarray) -> np.ndarray:
        """Work of inertia, weight, and damping by mass of each element."""
        system, (nodes, blocks) = self._scene.system, self._masses[body]
        pairs = borne_by_mass(system, self._numbers, body, step, exerted, borne)
        return np.asarray(sum(np.einsum("mab,mai,mbi->m", blocks, v[nodes], w[nodes]) for v, w in pairs))

    def gradients(self) -> dict[str, np.ndarray]:
        """Derivatives by the values of each field in SI units."""
        out, shapes = {}, self.shapes.gradients()
        for name, values in self._values.items():
            body, key = name.split(".")
            if key == REST:
                out[name] = shapes[body]
                continue
            if key == NU:
                total = self._by_nu[body]
            elif key == REST_ANGLE:
                total = self._bending[body]
            elif key in FLOW:
                total = self._by_flow[body, key]
            else:
                total = sum(power * self._work[body, part] for part, power in POWERS[key].items()) / values
            out[name] = total + np.zeros(len(values))
        return out


def _elastic(terms: Mapping[str, Any], body: str) -> list[Any]:
    """Terms of a body that depend on Poisson's ratio."""
    return [terms[f"{body}.{part}"] for part in ("elastic", "membrane", "bending") if f"{body}.{part}" in terms]
