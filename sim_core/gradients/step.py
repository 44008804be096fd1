"""One solved step, linearised: what its outcome changes by, forwards, and what depends on it, backwards.

With the positions x' of all nodes, of which the unknowns make R(x'; s, theta) = 0 and the rest follow the mounts,

    forwards    dx' = -H^-1 [dR/ds ds + dR/dtheta + H dm] + dm, dxi' = dG/dx' dx' + dG/ds ds + dG/dtheta
    backwards   lambda = -H^-1 [xbar' + dG/dx'^T xibar'],      sbar = dR/ds^T lambda + dG/ds^T xibar',
                thetabar = dR/dtheta^T lambda + dG/dtheta^T xibar'

s = (x, v, the state before for BDF2, internal variables xi), H the true Hessian at the solution, factorised once; dm:
motion of what follows the mounts (:mod:`sim_core.gradients.boundary_motion`), of which the inverse takes the unknowns'
rows. dR/ds and dG/ds come from the terms (:meth:`sim_core.energies.term.RememberingTerm.linearise`), inertia is linear,
and dR/dtheta, dG/dtheta are columns (:mod:`sim_core.gradients.parameter_jacobian`). Readings depend on x' and on the
forces of the terms on the nodes, so a weight w on these forces joins lambda.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim_core.energies.linearised import Linearised, size_of, times, times_back
from sim_core.energies.term import StepContext
from sim_core.gradients.boundary_motion import Driven
from sim_core.gradients.parameter_jacobian import Column
from sim_core.scene.scene import Scene
from sim_core.solve.hessian_store import Keeper
from sim_core.solve.integrator import Past, step_context
from sim_core.solve.reactions import passed_on, passed_on_by
from sim_core.solve.step import State
from sim_core.solve.system import System


@dataclass
class Motion:
    """Derivatives of a state by p parameters, last axis: ``x``, ``v`` ``(n, 3, p)``; ``memory``: of each term's
    internal variables, flattened ``(q, p)``; ``past``: of the state before."""

    x: np.ndarray
    v: np.ndarray
    memory: dict[str, np.ndarray]
    past: tuple[np.ndarray, np.ndarray] | None = None


@dataclass
class Outcome:
    """Derivatives of what readings depend on at the end of a step: ``x`` ``(n, 3, p)``; ``force``: of dE/dx of all
    terms, and of what prescribed nodes bear beside (:func:`sim_core.solve.reactions.passed_on`), ``(n, 3, p)``;
    ``moment``: of rigid contacts ``(3, p)``; ``unknowns`` ``(., p)``."""

    x: np.ndarray
    force: np.ndarray
    moment: dict[str, np.ndarray]
    unknowns: np.ndarray


@dataclass
class Weights:
    """Derivatives of a loss by a state at the end of a step and by the readings' causes there: as in
    :class:`Motion`, without the last axis; ``force``, ``moment``: by what the terms exert; ``unknowns``: by
    deflections of compliant mounts (None: by none)."""

    x: np.ndarray
    v: np.ndarray
    memory: dict[str, np.ndarray]
    past: tuple[np.ndarray, np.ndarray] | None = None
    force: np.ndarray | None = None
    moment: dict[str, np.ndarray] = field(default_factory=dict)
    unknowns: np.ndarray | None = None


@dataclass
class Pulled:
    """What one step passes back: ``state``: weights of the state before; ``targets``: of where prescribed and compliant
    nodes were sent ``(n, 3)``; ``turns``: of turns of the rigid bodies that can, by term ``(3)``; ``numbers``: one a
    column; ``exerted``, ``borne``: of the forces of the terms, and of inertia and weight ``(n, 3)``."""

    state: Weights
    targets: np.ndarray
    turns: dict[str, np.ndarray]
    numbers: np.ndarray
    exerted: np.ndarray
    borne: np.ndarray


class LinearStep:
    """The step from ``before`` to ``after``, linearised while the scene's system holds the end of it; may be used
    when it has gone on."""

    def __init__(self, scene: Scene, keeper: Keeper, before: State, after: State, dt: float) -> None:
        system = scene.system
        self._system = system
        self._before = before
        self.inertia = system.inertia
        """Whether the system had inertia in the step."""
        self._dt = dt
        self.step: StepContext = step_context(before.x, before.v, dt, before.past, before.t)
        self._hessian = keeper.keep()
        self.terms = linearised_terms(system, self.step, before, after)
        """What the terms with memory know of themselves in this step."""
        self._sizes = {name: size_of(internals) for name, internals in after.internals.items()}

    @property
    def remembers(self) -> bool:
        """Whether the outcome depends on where the step began, or on what was remembered there, other than by
        inertia."""
        return any(term.remembers for term in self.terms.values())

    def size_bytes(self) -> int:
        """Memory of what is kept."""
        return self._hessian.size_bytes + sum(term.size_bytes() for term in self.terms.values())

    def _restrict(self, gradient: np.ndarray) -> np.ndarray:
        """Transpose of :meth:`System.spread`."""
        return np.asarray(self._system.restrict(gradient) - self._system.restrict(np.zeros_like(gradient)))

    def _stiffness(self, move: np.ndarray) -> np.ndarray:
        """Change of what the terms exert for a move of the nodes ``(n, 3)``."""
        system, out = self._system, self._hessian.product(move)
        return np.asarray(out - system.mass @ move / self.step.tau**2) if self.inertia else out

    def _carried(self, moves: np.ndarray) -> np.ndarray:
        """What inertia adds to the residual for moves of the nodes ``(n, 3, k)``."""
        return np.asarray(self._system.mass @ moves.reshape(len(moves), -1) / self.step.tau**2).reshape(moves.shape)

    def foresee(self) -> None:
        """Let what :meth:`pull` solves with be factorised on a second core meanwhile."""
        self._hessian.foresee()

    # Forwards

    def push(
        self, motion: Motion, columns: list[Column], slopes: np.ndarray, driven: Driven | None = None
    ) -> tuple[Motion, Outcome]:
        """Derivatives at the end of the step; ``slopes``: of the columns' numbers by the parameters ``(k, p)``;
        ``driven``: of what follows the mounts, if they move by the parameters."""
        system, count = self._system, slopes.shape[1]
        shape = (*system.x.shape, count)
        step = self._linear(motion)
        start, whole = step.x_start.reshape(-1, count), system.x.size
        memory = {name: np.zeros((size, count)) for name, size in self._sizes.items()}
        moment: dict[str, np.ndarray] = {}
        force = np.zeros((whole, count))
        for name, term in self.terms.items():
            old = motion.memory[name]
            force += times(term.force_start, start) + times(term.force_memory, old)
            if term.force_past is not None and step.x_past is not None:
                force += times(term.force_past, step.x_past.reshape(-1, count))
            memory[name] += times(term.memory_start, start) + times(term.memory_memory, old)
            if term.moment_end is not None:
                moment[name] = times(term.moment_start, start) + times(term.moment_memory, old) + np.zeros((3, count))
            if driven is not None and name in driven.turns:
                turn = driven.turns[name]
                force += times(term.force_turn, turn)
                memory[name] += times(term.memory_turn, turn)
                if term.moment_turn is not None:
                    moment[name] = moment[name] + times(term.moment_turn, turn)
        body, unknowns = np.zeros((whole, count)), np.zeros((system.n_unknowns, count))
        if self.inertia:
            begun = (step.x_base + step.tau * step.v_base).reshape(-1, 3 * count)
            body -= (system.mass @ begun / step.tau**2).reshape(-1, count)
        force += _combined([c.force for c in columns], slopes, whole)
        body += _combined([c.body for c in columns], slopes, whole)
        unknowns += _combined([c.unknowns for c in columns], slopes, len(unknowns))
        for column, slope in zip(columns, slopes, strict=True):
            for name, kept in column.memory.items():
                memory[name] += np.outer(kept, slope)
            for name, turned in column.moment.items():
                moment[name] = moment.get(name, 0.0) + np.outer(turned, slope)
        total = (force + body).reshape(shape)
        if driven is not None:
            total = total + self._hessian.products(driven.x)
        spread = system.spread_matrix
        moved = -self._hessian.solve(spread.T @ total.reshape(whole, count) + unknowns)
        x = np.asarray(spread @ moved).reshape(shape)
        if driven is not None:
            x += driven.x
        force, body = force.reshape(shape) + self._hessian.products(x), body.reshape(shape)
        if self.inertia:
            carried = self._carried(x)
            force, body = force - carried, body + carried
        force += passed_on(system, force, body)
        for name, term in self.terms.items():
            memory[name] += times(term.memory_end, x.reshape(-1, count))
            if term.moment_end is not None:
                moment[name] = moment[name] + times(term.moment_end, x.reshape(-1, count))
        v = np.zeros_like(x)
        if self.inertia:
            v = (x - step.x_base) / step.tau
        past = (motion.x, motion.v) if self.inertia and system.second_order else None
        return Motion(x, v, memory, past), Outcome(x, force, moment, moved)

    def _linear(self, motion: Motion) -> StepContext:
        """Derivatives of what a step is measured from, which is linear in the states."""
        past = None
        if self._before.past is not None:
            assert motion.past is not None
            past = Past(*motion.past, self._before.past.dt)
        return step_context(motion.x, motion.v, self._dt, past)

    # Backwards

    def pull(self, weights: Weights, columns: list[Column], turning: Container[str]) -> Pulled:
        """Weights of everything that the step depended on. ``turning``: terms of the rigid bodies that can turn."""
        system, step = self._system, self.step
        x, past, zero = weights.x.copy(), weights.past, np.zeros_like(weights.x)
        moving = self.inertia
        if moving:
            x += weights.v / step.tau
        for name, term in self.terms.items():
            x += self._back(term.memory_end, weights.memory[name])
            if term.moment_end is not None and name in weights.moment:
                x += self._back(term.moment_end, weights.moment[name])
        by_terms, by_body = zero, zero
        if weights.force is not None:
            by_terms, by_body = passed_on_by(system, weights.force)
            x += self._stiffness(by_terms)
            if moving:
                x += system.mass @ by_body / step.tau**2
        pulled = self._restrict(x)
        if weights.unknowns is not None:
            pulled += weights.unknowns
        answer = -self._hessian.solve(pulled)
        spread = system.spread(answer)
        borne, exerted = spread + by_body, spread + by_terms
        start, memory = np.zeros_like(x), {}
        turns: dict[str, np.ndarray] = {}
        for name, internals in self._before.internals.items():
            old = np.zeros(size_of(internals))
            if name in self.terms:
                term = self.terms[name]
                start, old = self._through(term, name, weights, exerted, start, old)
                if name in turning:
                    turns[name] = self._turn(term, weights.memory[name], exerted, weights.moment.get(name))
            memory[name] = old
        before = self._measured_from(borne, weights if moving else None)
        before.x += start
        for term in self.terms.values():
            if term.force_past is not None and before.past is not None:
                before.past[0][:] += self._back(term.force_past, exerted.ravel())
        if past is not None:
            before.x, before.v = before.x + past[0], before.v + past[1]
        before.memory = memory
        targets = system.fold(x + self._hessian.product(spread))
        numbers = np.array([self._along(c, weights, exerted, borne, answer) for c in columns])
        return Pulled(before, targets, turns, numbers, exerted, borne)

    def _through(
        self,
        term: Linearised,
        name: str,
        weights: Weights,
        exerted: np.ndarray,
        start: np.ndarray,
        old: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Add what one term passes back to the start of the step and to its memory."""
        flat, kept, moment = exerted.ravel(), weights.memory[name], weights.moment.get(name)
        start = start + self._back(term.force_start, flat) + self._back(term.memory_start, kept)
        old = old + self._back(term.force_memory, flat, False) + self._back(term.memory_memory, kept, False)
        if moment is not None:
            start = start + self._back(term.moment_start, moment)
            old = old + self._back(term.moment_memory, moment, False)
        return start, old

    def _turn(self, term: Linearised, kept: np.ndarray, exerted: np.ndarray, moment: np.ndarray | None) -> np.ndarray:
        """Weights of the turn of a rigid body."""
        turn = self._back(term.memory_turn, kept, False) + self._back(term.force_turn, exerted.ravel(), False)
        if moment is not None:
            turn = turn + self._back(term.moment_turn, moment, False)
        return np.asarray(turn + np.zeros(3))

    @staticmethod
    def _back(matrix: Any, vector: np.ndarray, nodal: bool = True) -> Any:
        """Product with a transpose, as nodal vectors ``(n, 3)`` if ``nodal``."""
        out = times_back(matrix, vector)
        return out.reshape(-1, 3) if nodal and isinstance(out, np.ndarray) else out

    def _measured_from(self, borne: np.ndarray, weights: Weights | None) -> Weights:
        """Weights of the states that velocity and acceleration are measured from. ``borne``: weights of inertia;
        ``weights``: None where the end of the step has no velocity."""
        system, step = self._system, self.step
        zero = np.zeros_like(borne)
        if not self.inertia:
            return Weights(zero, zero.copy(), {})
        assert weights is not None
        held = system.mass @ borne / step.tau**2
        x_base, v_base = -weights.v / step.tau - held, -held * step.tau
        if self._before.past is None:
            return Weights(x_base, v_base, {})
        # The coefficients of the two states, read off the linear map itself.
        one, none = np.ones(1), np.zeros(1)
        now = step_context(one, none, self._dt, Past(none, none, self._before.past.dt)).x_base[0]
        then = step_context(none, none, self._dt, Past(one, none, self._before.past.dt)).x_base[0]
        return Weights(now * x_base, now * v_base, {}, (then * x_base, then * v_base))

    def _along(
        self, column: Column, weights: Weights, exerted: np.ndarray, borne: np.ndarray, answer: np.ndarray
    ) -> float:
        """Product of one number's column with the weights."""
        out = 0.0
        if column.force is not None:
            out += float(np.vdot(column.force, exerted))
        if column.body is not None:
            out += float(np.vdot(column.body, borne))
        if column.unknowns is not None:
            out += float(column.unknowns @ answer)
        out += sum(float(kept @ weights.memory[name]) for name, kept in column.memory.items())
        out += sum(float(m @ weights.moment[name]) for name, m in column.moment.items() if name in weights.moment)
        return out


def _combined(columns: Sequence[np.ndarray | None], slopes: np.ndarray, size: int) -> np.ndarray:
    """Sum of columns of ``size``, None being zero, with slopes ``(k, p)``: ``(size, p)``."""
    given = [k for k, column in enumerate(columns) if column is not None]
    table = np.array([columns[k] for k in given]).reshape(len(given), size)
    return np.asarray(table.T @ slopes[given])


def linearised_terms(system: System, step: StepContext, before: State, after: State) -> dict[str, Linearised]:
    """What the terms with memory know of themselves at the end of a step, where the system is."""
    terms = {}
    for name, term in system.remembering.items():
        found = term.linearise(step, before.internals[name], after.internals[name])
        if found is not None:
            terms[name] = found
    return terms


def no_memory(state: State, count: int | None = None) -> dict[str, np.ndarray]:
    """Zero derivatives of all internal variables of a state by ``count`` parameters; None: zero weights of them."""
    last = () if count is None else (count,)
    return {name: np.zeros((size_of(internals), *last)) for name, internals in state.internals.items()}
