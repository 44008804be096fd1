"""The assembled mechanical system: nodes, mass, terms, and the sparse Hessian they share.

All nodes of all bodies are in one array. Components that are prescribed (clamps, driven bodies) are
not unknowns; the others are numbered, and the upper triangle of the Hessian in that numbering has a
fixed pattern with a place for every entry of every term, so that assembly is addition in place. A
term whose coupled nodes change (contact between deformable bodies) says so and the pattern is rebuilt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sim_core.energies.term import Buffers, Internals, StepContext, Term
from sim_core.solve.factor import Factor, factorise


@dataclass(frozen=True)
class Compliant:
    """Prescribed nodes that give way together by a translation. ``nodes``: ``(k,)``;
    ``compliance_m_per_n``: along the world axes ``(3,)``, all positive."""

    nodes: np.ndarray
    compliance_m_per_n: np.ndarray


class System:
    """Energies, gradient and Hessian of one incremental potential.

    ``nodes``: rest positions [m] ``(n, 3)``. ``mass``: csr ``(n, n)`` [kg]. ``prescribed``: bool
    ``(n, 3)``. ``gravity``: [m/s^2] ``(3,)``. ``inertia``: False makes every step a static
    equilibrium. ``compliant``: groups of prescribed nodes that give way together.
    """

    def __init__(
        self,
        nodes: np.ndarray,
        mass: sp.csr_matrix,
        prescribed: np.ndarray,
        terms: Sequence[Term],
        gravity: np.ndarray,
        inertia: bool = True,
        compliant: Sequence[Compliant] = (),
    ) -> None:
        self.nodes = np.ascontiguousarray(nodes, dtype=float)
        self.mass = mass.tocsr()
        self.prescribed = prescribed
        self.terms = list(terms)
        self.gravity = np.asarray(gravity, dtype=float)
        self.inertia = inertia
        self._set_unknowns(compliant)
        self._targets = np.zeros_like(self.nodes)
        self._x = self.nodes.copy()
        self._energy = np.zeros(1)
        self._gradient = np.zeros_like(self._x)
        self._predicted = self._x.copy()
        self._dt = 1.0
        self._external = np.zeros_like(self._x)
        self.loads = np.zeros_like(self._x)
        """Dead nodal loads [N], ``(n, 3)``, on top of gravity."""
        self.build_pattern()

    def _set_unknowns(self, compliant: Sequence[Compliant]) -> None:
        """Number the stored components, and map the unknowns to them when groups give way."""
        self._compliant = list(compliant)
        stored = ~self.prescribed.copy()
        for group in self._compliant:
            stored[group.nodes] = True
        self._stored = np.flatnonzero(stored.ravel())
        self._number = np.full(stored.size, -1)
        self._number[self._stored] = np.arange(len(self._stored))
        self._own = np.flatnonzero(~self.prescribed.ravel())
        self._reduction: sp.csr_matrix | None = None
        self._spring = np.concatenate([1.0 / g.compliance_m_per_n for g in self._compliant] or [np.empty(0)])
        if self._compliant:
            rows = [self._number[self._own]]
            columns = [np.arange(len(self._own))]
            for k, group in enumerate(self._compliant):
                for axis in range(3):
                    rows.append(self._number[3 * group.nodes + axis])
                    columns.append(np.full(len(group.nodes), len(self._own) + 3 * k + axis))
            row, column = np.concatenate(rows), np.concatenate(columns)
            shape = (len(self._stored), len(self._own) + 3 * len(self._compliant))
            self._reduction = sp.csr_matrix((np.ones(len(row)), (row, column)), shape=shape)
        self._deflection = np.zeros(3 * len(self._compliant))

    @property
    def n_unknowns(self) -> int:
        return len(self._own) + len(self._deflection)

    @property
    def deflections(self) -> np.ndarray:
        """How far each compliant group has given way [m], ``(n_groups, 3)``."""
        return self._deflection.reshape(-1, 3)

    def set_targets(self, targets: np.ndarray) -> None:
        """Place prescribed nodes at ``targets`` [m] ``(n, 3)``, plus what their group has given way."""
        self._targets[:] = targets
        self._x[self.prescribed] = targets[self.prescribed]
        for group, deflection in zip(self._compliant, self.deflections, strict=True):
            self._x[group.nodes] = targets[group.nodes] + deflection

    def unknowns(self) -> np.ndarray:
        """Copy of the unknowns: free components [m], then deflections [m]."""
        return np.concatenate([self._x.reshape(-1)[self._own], self._deflection])

    def set_unknowns(self, values: np.ndarray) -> None:
        """Write the unknowns into :attr:`x`."""
        self._x.reshape(-1)[self._own] = values[: len(self._own)]
        if self._compliant:
            self._deflection[:] = values[len(self._own) :]
            for group, deflection in zip(self._compliant, self.deflections, strict=True):
                self._x[group.nodes] = self._targets[group.nodes] + deflection

    def residual(self) -> np.ndarray:
        """Derivative of the potential with respect to the unknowns [N]."""
        gradient = self.gradient().reshape(-1)
        if self._reduction is None:
            return gradient[self._own]
        reduced = self._reduction.T @ gradient[self._stored]
        reduced[len(self._own) :] += self._spring * self._deflection
        return np.asarray(reduced)

    def force_scale(self) -> float:
        """Largest force on any node at the last gradient [N]: reactions and imbalance."""
        return float(np.max(np.abs(self._gradient), initial=0.0))

    def spread(self, direction: np.ndarray) -> np.ndarray:
        """Change of all nodes ``(n, 3)`` for a change of the unknowns."""
        out = np.zeros(self._x.size)
        if self._reduction is None:
            out[self._own] = direction
        else:
            out[self._stored] = self._reduction @ direction
        return out.reshape(-1, 3)

    @property
    def x(self) -> np.ndarray:
        """Positions that the terms look at [m], ``(n, 3)``; written in place."""
        return self._x

    def build_pattern(self) -> None:
        """(Re)build the sparse pattern and bind all terms to it."""
        n = len(self._stored)
        inertia = sp.coo_matrix(sp.triu(self.mass))
        entries = [self._entries(np.column_stack([inertia.row, inertia.col]), True)]
        for term in self.terms:
            entries.append(self._entries(term.blocks(), term.mirrored))
        diagonal = np.arange(n, dtype=np.int64)
        keys = np.concatenate([(e[e >= 0]).ravel() for e in entries] + [diagonal * n + diagonal])
        unique = np.unique(keys)
        rows, columns = unique // n, unique % n
        indptr = np.zeros(n + 1, dtype=np.int32)
        np.add.at(indptr, rows + 1, 1)
        self._indptr = np.cumsum(indptr).astype(np.int32)
        self._indices = columns.astype(np.int32)
        self._hessian = np.zeros(len(unique) + 1)
        self._buffers = Buffers(self._x, self._energy, self._gradient, self._hessian)
        self._factor: dict[bool, Factor] = {}
        self._mass_values = np.zeros(len(unique) + 1)
        self._mass_pattern = (inertia.row, inertia.col)
        slots = [np.where(e >= 0, np.searchsorted(unique, e), len(unique)).astype(np.int32) for e in entries]
        self._mass_slots = slots[0].reshape(-1, 3, 3)[:, range(3), range(3)]
        self._fill_mass()
        for term, places in zip(self.terms, slots[1:], strict=True):
            term.bind(self._buffers, np.ascontiguousarray(places))

    def _fill_mass(self) -> None:
        values = np.asarray(self.mass[self._mass_pattern]).reshape(-1, 1)
        self._mass_values[:] = 0.0
        np.add.at(self._mass_values, self._mass_slots, values)
        self._mass_values[-1] = 0.0

    def set_mass(self, mass: sp.csr_matrix) -> None:
        """Replace the mass matrix by one of the same pattern [kg]."""
        self.mass = mass
        self._fill_mass()

    def set_compliance(self, compliance_m_per_n: Sequence[np.ndarray]) -> None:
        """Change the compliances of the compliant groups, in their order [m/N]."""
        if len(compliance_m_per_n) != len(self._compliant):
            raise ValueError("one compliance a group")
        self._spring = np.concatenate([1.0 / c for c in compliance_m_per_n] or [np.empty(0)])

    def _entries(self, blocks: np.ndarray, mirrored: bool) -> np.ndarray:
        """Key row * n + column of every entry of every node block, -1 where it is not stored."""
        n = np.int64(len(self._stored))
        axis = np.arange(3)
        rows = self._number[3 * blocks[:, 0, None].astype(np.int64) + np.repeat(axis, 3)]
        columns = self._number[3 * blocks[:, 1, None].astype(np.int64) + np.tile(axis, 3)]
        missing = (rows < 0) | (columns < 0)
        if mirrored:
            rows, columns = np.minimum(rows, columns), np.maximum(rows, columns)
        else:
            missing |= rows > columns
        return np.where(missing, -1, rows * n + columns)

    def begin_step(self, step: StepContext, internals: dict[str, Internals]) -> None:
        """Freeze the constants of a step in all terms and predict inertial motion."""
        self._dt = step.dt
        changed = [term.prepare(step.x_start) for term in self.terms if hasattr(term, "prepare")]
        if any(changed):
            self.build_pattern()
        self._external[:] = self.mass @ np.broadcast_to(self.gravity, self._x.shape) + self.loads
        self._predicted[:] = step.x_start + step.dt * step.v_start
        for term in self.terms:
            term.begin_step(step, internals[term.name])

    def energy(self) -> float:
        """Incremental potential [J] at :attr:`x`."""
        self._energy[0] = 0.0
        for term in self.terms:
            term.add_energy()
        total = self._energy[0] - float(np.vdot(self._external, self._x))
        if self.inertia:
            away = self._x - self._predicted
            total += 0.5 / self._dt**2 * float(np.vdot(away, self.mass @ away))
        total += 0.5 * float(self._spring @ self._deflection**2)
        return float(total)

    def gradient(self) -> np.ndarray:
        """Derivative of the potential [N], ``(n, 3)``; on prescribed components the reaction's negative.

        The returned array is reused by the next call.
        """
        self._gradient[:] = -self._external
        if self.inertia:
            self._gradient += self.mass @ (self._x - self._predicted) / self._dt**2
        for term in self.terms:
            term.add_gradient()
        return self._gradient

    def static_gradient(self) -> np.ndarray:
        """As :meth:`gradient` but without gravity, loads and inertia: what the terms exert [N]."""
        self._gradient[:] = 0.0
        for term in self.terms:
            term.add_gradient()
        return self._gradient.copy()

    def hessian(self, exact: bool = False, shift: float = 0.0) -> sp.csr_matrix:
        """Upper triangle over the unknowns; ``shift`` [N/m] is added to the diagonal."""
        self._hessian[:] = self._mass_values / self._dt**2 if self.inertia else 0.0
        for term in self.terms:
            term.add_hessian(exact)
        values = self._hessian[:-1].copy()
        if shift:
            values[self._indptr[:-1]] += shift
        n = len(self._stored)
        upper = sp.csr_matrix((values, self._indices, self._indptr), shape=(n, n))
        if self._reduction is None:
            return upper
        full = upper + sp.triu(upper, 1).T
        reduced = (self._reduction.T @ full @ self._reduction).tolil()
        k = len(self._own)
        reduced[range(k, k + len(self._spring)), range(k, k + len(self._spring))] += self._spring
        out = sp.triu(reduced).tocsr()
        out.sort_indices()
        return out

    def factor(self, matrix: sp.csr_matrix, definite: bool) -> Factor:
        """Factorise a matrix from :meth:`hessian`, reusing the symbolic analysis of the pattern."""
        factor = self._factor.get(definite)
        if factor is None:
            factor = self._factor[definite] = factorise(matrix, definite)
        else:
            factor.refactor(matrix.data)
        return factor

    def end_step(self, step: StepContext, internals: dict[str, Internals]) -> dict[str, Internals]:
        """Internal variables after the step that ended at :attr:`x`."""
        return {term.name: term.end_step(step, internals[term.name]) for term in self.terms}

    def initial_internals(self) -> dict[str, Internals]:
        return {term.name: term.initial_internals() for term in self.terms}

    def contacts(self) -> tuple[int, float]:
        """Loaded contact samples and smallest gap [m] at the last gradient."""
        found = [term.contacts() for term in self.terms if hasattr(term, "contacts")]
        return sum(c for c, _ in found), min((g for _, g in found), default=np.inf)
