"""A system that was put together by hand, on the compiled core: its steps, and its potential where nothing moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from sim_core.core.failure import RESULTS
from sim_core.core.record import ContactTerm, contacts_of, dead_loads, edges_of, moments, surfaces_of
from sim_core.core.record_layout import COUNTS, pointer_to
from sim_core.core.slopes import NumberSlopes
from sim_core.core.state import CoreState
from sim_core.energies.term import changes_of
from sim_core.solve.report import NewtonSettings, Result, StepReport
from sim_core.solve.state import State
from sim_core.solve.system import System


@dataclass(frozen=True)
class Alone:
    """The mechanics of a system without mounts: what is prescribed is given node by node."""

    system: System
    followers: Sequence[Any] = ()

    @property
    def start(self) -> Mapping[str, Any]:
        """One mount for each rigid body, which turns it."""
        return {str(term.body_node): None for term in contacts_of(self)}

    @property
    def bodies(self) -> Mapping[str, Any]:
        """None, by whose density one differentiates."""
        return {}

    @property
    def compliant(self) -> Sequence[str]:
        """Names of the groups that give way."""
        return [str(k) for k in range(len(self.system.compliant))]

    @property
    def contacts(self) -> Mapping[str, Sequence[Any]]:
        """Each term of contact by its name."""
        terms: list[ContactTerm] = [*contacts_of(self), *surfaces_of(self), *edges_of(self)]
        return {term.name: [term] for term in terms}

    def placed_on(self, node: int) -> tuple[str, np.ndarray]:
        """The mount of a rigid body, which turns as that does."""
        return str(node), np.eye(3)


@dataclass(frozen=True)
class Potential:
    """What a step would make least, at some positions. ``energy`` [J]; ``gradient`` [N] ``(n, 3)``; ``exerted``: of
    that what the terms have, without gravity, loads and inertia; ``hessian``: over all nodes [N/m] csr ``(3 n, 3 n)``;
    ``contacts``: loaded points; ``gap``: the smallest one [m]; ``forces``: of contacts on the nodes, by their names [N]
    ``(n, 3)``."""

    energy: float
    gradient: np.ndarray
    exerted: np.ndarray
    hessian: sp.csr_matrix
    contacts: int
    gap: float
    forces: Mapping[str, np.ndarray]


class SystemOnCore(CoreState):
    """Steps of a system, with the numbers that its terms, its masses and its loads have at each call. ``x`` [m]
    ``(n, 3)``, ``energy`` [J], ``exerted`` [N] ``(n, 3)``: at the end of the last step, at first at rest."""

    def __init__(self, system: System, settings: NewtonSettings) -> None:
        self.settings, self._system = settings, system
        super().__init__(Alone(system), settings, NumberSlopes(), np.zeros(0, dtype=int))
        self.x, self.energy, self.exerted = system.nodes, 0.0, np.zeros_like(system.nodes)
        self._last: State | None = None

    def _make(self) -> None:
        super()._make()
        self.keep_forces()
        self._made_of_numbers, self._mass = self._changes(), self._system.mass

    def _changes(self) -> list[int]:
        return [changes_of(term) for term in self._system.terms]

    def advance(
        self, state: State, targets: np.ndarray, dt: float, guess: np.ndarray | None
    ) -> tuple[State, StepReport]:
        """As :func:`sim_core.solve.step.advance`, whether the step converges or not."""
        places, held = self._begin(state, targets)
        energy, exerted, counts = np.zeros(1), np.zeros_like(self._system.nodes), np.zeros(1, dtype=COUNTS)
        near = None if guess is None else np.ascontiguousarray(guess, dtype=float)
        at = (pointer_to(places), pointer_to(held), None if near is None else pointer_to(near))
        out = (pointer_to(energy), pointer_to(exerted), pointer_to(counts))
        found = self._library.thinshell_advance(self._handle, dt, *at, int(self._system.inertia), *out)
        after = self._last = self.state_now(state.t + dt)
        self.x, self.energy, self.exerted = after.x, float(energy[0]), exerted
        result = Result.CONVERGED if found else RESULTS.get(int(counts["failure"][0]), Result.ITERATION_LIMIT)
        if not (np.isfinite(after.x).all() and np.isfinite(exerted).all()):
            result = Result.NOT_FINITE
        return after, self._report(result, counts[0].item())

    def potential(
        self, state: State, x: np.ndarray, targets: np.ndarray, dt: float, inertia: bool, exact: bool
    ) -> Potential:
        """As :func:`sim_core.solve.step.potential`."""
        places, held = self._begin(state, targets)
        self._last = None  # contact has been looked for anew
        there, counts = np.ascontiguousarray(x, dtype=float), np.zeros(1, dtype=COUNTS)
        energy, gradient, exerted = np.zeros(1), np.zeros_like(there), np.zeros_like(there)
        at = (pointer_to(places), pointer_to(held), pointer_to(there))
        out = (pointer_to(energy), pointer_to(gradient), pointer_to(exerted), pointer_to(counts))
        self._library.thinshell_look(self._handle, dt, *at, int(inertia), int(exact), *out)
        found, gap = int(counts["contacts"][0]), float(counts["gap"][0])
        return Potential(float(energy[0]), gradient, exerted, self._hessian(), found, gap, self.pair_forces())

    def ended(self, state: State, x: np.ndarray, targets: np.ndarray, dt: float, inertia: bool) -> State:
        """As :func:`sim_core.solve.step.ended`."""
        places, held = self._begin(state, targets)
        there = np.ascontiguousarray(x, dtype=float)
        at = (pointer_to(places), pointer_to(held), pointer_to(there))
        self._library.thinshell_end(self._handle, dt, *at, int(inertia))
        self._last = self.state_now(state.t + dt)
        return self._last

    def _begin(self, state: State, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Be in a state, with the numbers that the system has now; frames of the mounts and targets, for the core."""
        if self._made_of_numbers != self._changes() or self._mass is not self._system.mass:
            self.renew()
        self._arrays["external"][: len(self._system.nodes)] = dead_loads(self._system)
        self._arrays["couple_moment"][:] = moments(self.scene)
        if state is not self._last:
            self.put(state)
        turns = {term.body_node: term.rotation_target for term in self.contacts}
        places = np.array([[0.0, 0.0, 0.0, *turn.ravel()] for turn in turns.values()]).reshape(-1, 12)
        return places, np.ascontiguousarray(targets, dtype=float)

    def _hessian(self) -> sp.csr_matrix:
        """The Hessian that was assembled last, over all nodes."""
        count = self._library.thinshell_blocks(self._handle, None, None, None)
        row, column, value = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64), np.zeros((count, 3, 3))
        self._library.thinshell_blocks(self._handle, *(pointer_to(a) for a in (row, column, value)))
        size, axes = self._system.nodes.size, np.arange(3)
        rows = np.broadcast_to(3 * row[:, None, None] + axes[:, None], value.shape)
        columns = np.broadcast_to(3 * column[:, None, None] + axes, value.shape)
        both = row != column
        entries = np.concatenate([value.ravel(), value[both].ravel()])
        first = np.concatenate([rows.ravel(), columns[both].ravel()])
        second = np.concatenate([columns.ravel(), rows[both].ravel()])
        return sp.csr_matrix((entries, (first, second)), shape=(size, size))

    def _report(self, result: Result, counts: tuple[Any, ...]) -> StepReport:
        its, factors, tries, _, contacts, at, _, _, _, residual, update, gap = counts
        names = [*self.scene.contacts, ""]
        return StepReport(result, its, factors, tries, residual, update, contacts, gap, names[at])


def on_core(system: System, settings: NewtonSettings | None = None) -> SystemOnCore:
    """The steps of a system on the core, made when they are first asked for, and anew with other ``settings`` (None: as
    before)."""
    known: SystemOnCore | None = system.on_core
    if known is None or (settings is not None and settings != known.settings):
        known = system.on_core = SystemOnCore(system, settings or NewtonSettings())
    return known
