"""Derivatives of one step by the numbers of the mechanics, one column a number.

Numbers of a term are stepped to both sides in that term alone: its gradient, its new internal variables, the moment
on its rigid body; but for those that the term differentiates itself, because steps of them could cross a switch.
What mass, its damping, gravity and compliance do is known in closed form.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sim_core.contact.rigid import RigidContact
from sim_core.energies.linearised import Linearised, flatten
from sim_core.energies.mass_damping import MassDamping
from sim_core.energies.term import AligningTerm, GuardedTerm, Internals, StepContext
from sim_core.gradients.directions import FROM_ZERO, RELATIVE_STEP, Key
from sim_core.scene.scene import Scene, Values
from sim_core.solve.system import System

GAP_STEP_M = 2e-11
"""Step of the distance at which a contact has no gap: small beside gaps, which are tenths of micrometres."""

DAMPING_STEP = 0.1
"""Step of a damping by the rate of strain, in which forces are linear, over that of time."""


@dataclass
class Column:
    """Derivative by one number. ``force``: of what the terms exert, dE/dx [N] ``(n, 3)``; ``body``: of inertia
    and weight ``(n, 3)``; ``unknowns``: of the residual, beyond both; ``memory``: of new internal variables by term;
    ``moment``: of a rigid body's surface forces by term. None: zero."""

    force: np.ndarray | None = None
    body: np.ndarray | None = None
    unknowns: np.ndarray | None = None
    memory: dict[str, np.ndarray] = field(default_factory=dict)
    moment: dict[str, np.ndarray] = field(default_factory=dict)


class Columns:
    """Columns of a scene whose system holds the end of a step. ``values``: of the rollout."""

    def __init__(self, scene: Scene, values: Values, keys: Sequence[Key]) -> None:
        self._scene, self._values, self.keys = scene, values, list(keys)
        self._terms: dict[str, Any] = {t.name: t for t in scene.system.terms}
        # Asked once: a check against a protocol looks at all its members.
        self._guarded = {n for n, t in self._terms.items() if isinstance(t, GuardedTerm)}
        self._aligning = {n for n, t in self._terms.items() if isinstance(t, AligningTerm)}
        self._mass: Any = None
        self._accelerations: np.ndarray | None = None
        self._weights: dict[str, np.ndarray] = {}

    def of_step(
        self,
        step: StepContext,
        internals: dict[str, Internals],
        after: dict[str, Internals],
        exact: Mapping[str, Linearised],
    ) -> list[Column]:
        """One column a key. ``internals``, ``after``: internal variables before and after the step; ``exact``: what the
        terms with memory know of themselves."""
        self._accelerations = None
        return [self._known(key, exact) or self._column(key, step, internals, after) for key in self.keys]

    def need_contact(self, exact: Mapping[str, Linearised]) -> bool:
        """Whether contact has to be looked for in a step, because a number of it has to be stepped."""
        touching = [k for k in self.keys if k[0] == "terms" and k[1] in self._guarded]
        return any(self._known(key, exact) is None for key in touching)

    def _known(self, key: Key, exact: Mapping[str, Linearised]) -> Column | None:
        """Column of a number that its term differentiates itself, or of a contact in which nothing touches."""
        kind, owner, quantity = key
        if kind != "terms" or owner not in exact:
            return None
        numbers = exact[owner].numbers
        if quantity not in numbers:
            idle = not numbers and owner in self._guarded
            return Column() if idle else None
        found = numbers[quantity]
        column = Column(force=found.force.reshape(-1, 3), memory={owner: found.memory})
        return replace(column, moment={owner: found.moment}) if found.moment.any() else column

    def _column(
        self, key: Key, step: StepContext, internals: dict[str, Internals], after: dict[str, Internals]
    ) -> Column:
        kind, owner, quantity = key
        if kind == "terms":
            term = self._terms.get(owner)
            if term is None:
                return Column()
            if isinstance(term, MassDamping):
                return Column(force=term.force_by(quantity, step))
            return self._of_term(term, quantity, step, internals[owner], after[owner])
        if kind == "gravity":
            return Column(body=self._weight(quantity))
        if kind == "density":
            return Column(body=self._inertia_of(owner, step))
        return Column(unknowns=self._of_compliance(self._scene.compliant.index(owner), "xyz".index(quantity)))

    def _weight(self, axis: str) -> np.ndarray:
        """-M e for a unit of gravity along an axis, the same in all steps with the same masses."""
        system = self._scene.system
        if self._mass is not system.mass:
            self._mass, self._weights = system.mass, {}
        if axis not in self._weights:
            pull = np.zeros_like(system.x)
            pull[:, "xyz".index(axis)] = -1.0
            self._weights[axis] = np.asarray(system.mass @ pull)
        return self._weights[axis]

    def _inertia_of(self, body: str, step: StepContext) -> np.ndarray:
        """M_b (a - g) for a unit density of one body."""
        system, built = self._scene.system, self._scene.bodies[body]
        moved = np.zeros_like(system.x)
        if built.unit_mass is not None:
            if self._accelerations is None:
                self._accelerations = accelerations(system, step)
            moved[built.nodes] = built.unit_mass @ self._accelerations[built.nodes]
        return moved

    def _of_compliance(self, group: int, axis: int) -> np.ndarray:
        """Residual's derivative by a compliance: of the spring 1/c on the deflection."""
        system = self._scene.system
        zero = np.zeros_like(system.x)
        given = list(self._values.compliance.values())
        ends = []
        for sign in (1.0, -1.0):
            stepped = [c.copy() for c in given]
            stepped[group][axis] *= 1.0 + sign * RELATIVE_STEP
            system.set_compliance(stepped)
            ends.append(system.restrict(zero))
        system.set_compliance(given)
        return np.asarray((ends[0] - ends[1]) / (2.0 * RELATIVE_STEP * given[group][axis]))

    def _of_term(self, term: Any, quantity: str, step: StepContext, internals: Internals, after: Internals) -> Column:
        """One number of a term. A number of zero is stepped to the side of more of it, and so is a damping: forces are
        linear in it, and below zero there is none."""
        given = self._values.terms[term.name]
        value = given[quantity]
        wide = {"offset_m": GAP_STEP_M, "stiffness_damping_s": DAMPING_STEP * step.dt}
        h = wide.get(quantity) or RELATIVE_STEP * abs(value) or FROM_ZERO
        ends = [value + h, value if value == 0.0 or quantity == "stiffness_damping_s" else value - h]
        found = []
        for there in ends:
            term.configure({**given, quantity: there})
            term.begin_step(step, internals)
            force, kept = self._scene.system.gradient_of(term), term.end_step(step, internals)
            if term.name in self._aligning:
                kept = term.aligned(kept, after)
            found.append((force, flatten(kept), moment_on_body(term)))
        term.configure(given)
        term.begin_step(step, internals)
        width = ends[0] - ends[1]
        force, memory, moment = ((a - b) / width for a, b in zip(*found, strict=True))
        column = Column(force=force)
        return replace(column, memory={term.name: memory}, moment={term.name: moment} if moment.any() else {})


def accelerations(system: System, step: StepContext) -> np.ndarray:
    """Accelerations of all nodes at the end of a step, less gravity [m/s^2] ``(n, 3)``."""
    a = np.broadcast_to(-system.gravity, system.x.shape)
    if system.inertia:
        a = a + (system.x - (step.x_base + step.tau * step.v_base)) / step.tau**2
    return a


def borne_by_mass(
    scene: Scene, density: float, body: str, step: StepContext, exerted: np.ndarray, borne: np.ndarray
) -> list[tuple[np.ndarray | float, np.ndarray, np.ndarray]]:
    """Pairs of nodal vectors ``(n, 3)`` and factors of the elements ``(m,)`` before them, whose products by the masses
    of a body's elements, per unit of what the rig has for its ``density``, are the work of inertia and weight along
    ``borne``, and of damping by mass along ``exerted``."""
    pairs: list[tuple[np.ndarray | float, np.ndarray, np.ndarray]] = [
        (1.0, density * accelerations(scene.system, step), borne)
    ]
    damping = scene.fields[f"{body}.mass_damping_per_s"]
    if damping.any():
        pairs.append((damping, *damped_by_mass(scene.system, density, step, exerted)))
    return pairs


def damped_by_mass(
    system: System, density: float, step: StepContext, exerted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nodal vectors ``(n, 3)`` whose product by an element's mass, per unit of density, is the work of its damping by
    mass along ``exerted``, per unit of its alpha."""
    loose = ~system.prescribed.all(axis=1, keepdims=True)
    return density / step.tau * loose * (system.x - step.x_base), loose * exerted


def moment_on_body(term: Any) -> np.ndarray:
    """Moment [N m] ``(3,)`` of the surface forces of a contact with a rigid shape about the shape's node."""
    return np.asarray(term.moment()) if isinstance(term, RigidContact) else np.zeros(3)
