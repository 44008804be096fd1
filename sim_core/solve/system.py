"""The assembled mechanical system: nodes, mass, terms, and the sparse Hessian they share.

All nodes of all bodies are in one array. Components that are prescribed (clamps, driven bodies) are
not unknowns, the others are numbered; nodes that give way together share three unknowns, and embedded nodes
(:mod:`sim_core.solve.embedding`) have none of their own. The Hessian has
a place for every entry of every term (:mod:`sim_core.solve.sparsity`), so that assembly is addition in
place. Terms whose coupled nodes change (contact between deformable bodies) renew their part of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import scipy.sparse as sp

from sim_core.energies.term import (
    Buffers,
    DynamicTerm,
    ForeseeingTerm,
    GuardedTerm,
    Internals,
    RememberingTerm,
    StepContext,
    StraighteningTerm,
    Term,
    TurningTerm,
    check_term,
)
from sim_core.kernels import BoundKernel
from sim_core.solve.embedding import Embedding
from sim_core.solve.factor import Factor, factorise
from sim_core.solve.hessian_vector import nodal_product
from sim_core.solve.inertia import inertia_energy, inertia_gradient
from sim_core.solve.sparsity import Pattern
from sim_core.solve.unknowns import Compliant, Unknowns


class System:
    """Energies, gradient and Hessian of one incremental potential.

    ``nodes``: rest positions [m] ``(n, 3)``. ``mass``: csr ``(n, n)`` [kg]. ``prescribed``: bool
    ``(n, 3)``. ``gravity``: [m/s^2] ``(3,)``. ``inertia``: False makes every step a static
    equilibrium. ``compliant``: groups of prescribed nodes that give way together. ``second_order``: steps
    look back on the one before (:mod:`sim_core.solve.integrator`). ``embedding``: nodes that move with others; not
    prescribed.
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
        second_order: bool = False,
        embedding: Embedding | None = None,
    ) -> None:
        self.nodes = np.ascontiguousarray(nodes, dtype=float)
        self.mass = mass.tocsr()
        self.prescribed = prescribed
        self.terms = list(terms)
        self.gravity = np.asarray(gravity, dtype=float)
        self.inertia = inertia
        self.second_order = second_order
        self.embedding = embedding
        for term in self.terms:
            check_term(term)
        self._dynamic = [t for t in self.terms if isinstance(t, DynamicTerm)]
        self._static = [t for t in self.terms if not isinstance(t, DynamicTerm)]
        self._guarded = [t for t in self.terms if isinstance(t, GuardedTerm)]
        self._bulk = [t for t in self.terms if not isinstance(t, GuardedTerm)]
        self._foreseeing = [t for t in self.terms if isinstance(t, ForeseeingTerm)]
        self.remembering = {t.name: t for t in self.terms if isinstance(t, RememberingTerm)}
        """Terms whose forces depend on more than the end of a step, or that remember."""
        self._contact, self._contact_at = np.zeros_like(self.nodes), np.full_like(self.nodes, np.nan)
        self._turning = [t for t in self.terms if isinstance(t, TurningTerm)]
        self._straightening = [t for t in self.terms if isinstance(t, StraighteningTerm)]
        self._unknowns = Unknowns(prescribed, compliant, embedding)
        self._targets = np.zeros_like(self.nodes)
        self._x: np.ndarray = self.nodes.copy()
        self._energy = np.zeros(1)
        self._gradient: np.ndarray = np.zeros_like(self._x)
        self._predicted = self._x.copy()
        self._tau = 1.0
        self._stiffest = 0.0
        self._inertia_factor = np.zeros(1)
        self._external = np.zeros_like(self._x)
        self.loads = np.zeros_like(self._x)
        """Dead nodal loads [N], ``(n, 3)``, on top of gravity."""
        self._factor: dict[bool, Factor] = {}
        self._lay_out()

    def _lay_out(self) -> None:
        """Lay out the storage of the Hessian and bind everything that is not dynamic."""
        inertia = sp.csr_matrix(self.mass)
        inertia.sum_duplicates()
        rows = np.repeat(np.arange(len(self.nodes)), np.diff(inertia.indptr))
        self._mass_blocks = np.column_stack([rows, inertia.indices])
        self._mass_start = inertia.indptr.astype(np.int32)
        self._mass_column = inertia.indices.astype(np.int32)
        self._mass = np.zeros(len(rows))
        static = [(self._mass_blocks, True), *((t.blocks(), t.mirrored) for t in self._static)]
        self._pattern = Pattern(self._unknowns.number, self.n_unknowns, static, self.embedding)
        self._bind()

    def _bind(self) -> None:
        """Allocate the values and bind all terms to them."""
        self._hessian = np.zeros(self._pattern.n_values)
        self._mass_values = np.zeros(self._pattern.n_values)
        self._fill_mass()
        self._buffers = Buffers(self._x, self._energy, self._gradient, self._hessian, self._pattern.table)
        mass = (self._mass_start, self._mass_column, self._mass, self._inertia_factor)
        load = (self._x, self._predicted, self._external)
        self._inertia_energy = BoundKernel(inertia_energy, *load, *mass, self._energy)
        self._inertia_gradient = BoundKernel(inertia_gradient, *load, *mass, self._gradient)
        self._product_move, self._product_out = np.zeros_like(self._x), np.zeros_like(self._x)
        table = self._pattern.table
        self._product = BoundKernel(
            nodal_product, table.start, table.column, table.place, self._hessian, self._product_move, self._product_out
        )
        for term, slots in zip(self._static, self._pattern.static_slots()[1:], strict=True):
            term.bind(self._buffers, slots)
        for term in self._dynamic:
            term.bind(self._buffers, np.empty((0, 9), dtype=np.int32))

    @property
    def n_unknowns(self) -> int:
        return self._unknowns.count

    @property
    def deflections(self) -> np.ndarray:
        """How far each compliant group has given way [m], ``(n_groups, 3)``."""
        return self._unknowns.deflection.reshape(-1, 3)

    def set_targets(self, targets: np.ndarray) -> None:
        """Place prescribed nodes at ``targets`` [m] ``(n, 3)``, plus what their group has given way."""
        self._targets[:] = targets
        self._x[self.prescribed] = targets[self.prescribed]
        self._unknowns.give_way(self._targets, self._x)

    def embed(self, x: np.ndarray) -> None:
        """Write positions or motions ``(n, 3)`` of embedded nodes from those of the others, in place."""
        self._unknowns.embed(x)

    def prescribed_move(self, start: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Moves [m] ``(n, 3)`` from ``start`` to ``targets`` of what is prescribed, and of what is embedded in it."""
        move = np.where(self.prescribed, targets - start, 0.0)
        self.embed(move)
        return move

    def targets(self) -> np.ndarray:
        """Copy of where prescribed nodes are placed [m], ``(n, 3)``."""
        return np.array(self._targets)

    def unknowns(self) -> np.ndarray:
        """Copy of the unknowns: free components [m], then deflections [m]."""
        return self._unknowns.read(self._x)

    def set_unknowns(self, values: np.ndarray) -> None:
        """Write the unknowns into :attr:`x`."""
        self._unknowns.write(values, self._x)
        self._unknowns.give_way(self._targets, self._x)

    def stand_at(self, x: np.ndarray, unknowns: np.ndarray) -> None:
        """Be at the positions of all nodes [m] ``(n, 3)`` of a solution, with the deflections that its ``unknowns``
        had; targets stay what they were."""
        self._x[:] = x
        if self._unknowns.deflection.size:
            self._unknowns.deflection[:] = unknowns[-self._unknowns.deflection.size :]

    def residual(self) -> np.ndarray:
        """Derivative of the potential with respect to the unknowns [N]."""
        return self.restrict(self.gradient())

    def contact_residual(self) -> np.ndarray:
        """Derivative of the energy of contact alone with respect to the unknowns [N]."""
        return self._unknowns.gather(self._contact_gradient())

    def contact_load(self) -> float:
        """Largest force of contact on any node [N]."""
        return float(np.abs(self._contact_gradient()).max(initial=0.0))

    def _contact_gradient(self) -> np.ndarray:
        """Forces of contact; kept for as long as the positions stay."""
        if not np.array_equal(self._contact_at, self._x):
            self._gradient[:] = 0.0
            for term in self._guarded:
                term.add_gradient()
            self._contact[:] = self._gradient
            self._contact_at[:] = self._x
        return self._contact

    def restrict(self, gradient: np.ndarray) -> np.ndarray:
        """Part of a nodal gradient [N] ``(n, 3)`` that belongs to the unknowns, springs included."""
        out = self._unknowns.gather(gradient)
        self._unknowns.pull(out)
        return out

    def force_scale(self) -> float:
        """Largest force on any node at the last gradient [N]: reactions, imbalance, weights and loads."""
        return max(float(np.abs(self._gradient).max(initial=0.0)), self.largest_load())

    def force_noise(self) -> float:
        """What round-off of the positions makes of forces [N], eps max |x| max K_ii, with the Hessian K that was
        assembled last."""
        return float(np.finfo(float).eps * self._stiffest * np.abs(self._x).max(initial=0.0))

    def largest_load(self) -> float:
        """Largest weight or load on any node [N]."""
        return float(np.abs(self._external).max(initial=0.0))

    def spread(self, direction: np.ndarray) -> np.ndarray:
        """Change of all nodes ``(n, 3)`` for a change of the unknowns."""
        return self._unknowns.spread(direction)

    @property
    def spread_matrix(self) -> sp.csr_matrix:
        """:meth:`spread` as a matrix ``(3 n, n_unknowns)``; its transpose is :meth:`restrict` without springs."""
        return self._pattern.spread

    def reduced_mass(self) -> sp.csr_matrix:
        """Mass matrix over the unknowns [kg]."""
        spread = self.spread_matrix
        return (spread.T @ sp.kron(self.mass, sp.identity(3)) @ spread).tocsr()

    @property
    def x(self) -> np.ndarray:
        """Positions that the terms look at [m], ``(n, 3)``; written in place."""
        return self._x

    def _fill_mass(self) -> None:
        mass = sp.csr_matrix(self.mass)
        mass.sum_duplicates()
        if mass.nnz != len(self._mass) or np.any(mass.indices != self._mass_column):
            raise ValueError("the mass matrix has another pattern than the one given at first")
        self._mass[:] = mass.data
        self._mass_values[:] = 0.0
        upper = self._mass_blocks[:, 0] <= self._mass_blocks[:, 1]
        self._pattern.scatter_static(self._mass_blocks[upper], self._mass[upper], self._mass_values)

    def set_mass(self, mass: sp.csr_matrix) -> None:
        """Replace the mass matrix by one of the same pattern [kg]."""
        self.mass = mass
        self._fill_mass()

    def set_compliance(self, compliance_m_per_n: Sequence[np.ndarray]) -> None:
        """Change the compliances of the compliant groups, in their order [m/N]."""
        self._unknowns.set_compliance(compliance_m_per_n)

    def begin_step(self, step: StepContext, internals: dict[str, Internals], search: bool = True) -> None:
        """Freeze the constants of a step in all terms and predict inertial motion.

        Contact is looked for on the way that velocities and the targets (set before) let nodes go.
        Without ``search`` the candidates of contact stay as they are (replay of a neighbouring state).
        """
        self._step, self._internals = step, internals
        towards = None
        if search:
            towards = step.x_start + step.dt * step.v_start
            towards[self.prescribed] = self._targets[self.prescribed]
            self.embed(towards)
        self._begin(step, internals, towards)

    def carried(self, internals: dict[str, Internals], move: np.ndarray) -> dict[str, Internals]:
        """Internal variables at the start of the step that was begun last, if it began with all nodes moved by ``move``
        [m] ``(n, 3)`` and the springs of friction stretched by that: where the step ends they hold as before."""
        moved = {term.name: term.carried(internals[term.name], move) for term in self._guarded}
        return {**internals, **moved}

    @property
    def touchable(self) -> bool:
        """Whether there is any contact."""
        return bool(self._guarded)

    def guard(self, on: bool) -> None:
        """Let contact insist that nothing crosses, or bear overlap on the way to a solution."""
        for term in self._guarded:
            term.guard(on)
        self._contact_at[:] = np.nan

    def turn(self, share: float) -> None:
        """Turn rigid bodies to where they are after ``share`` of the step."""
        for term in self._turning:
            term.turn(share)
        self._contact_at[:] = np.nan

    @property
    def turns(self) -> bool:
        """Whether a rigid body turns in this step."""
        return any(term.turns for term in self._turning)

    def free_way(
        self, start: np.ndarray, move: np.ndarray, keep: float, turn: tuple[float, float]
    ) -> tuple[float, str]:
        """Share of ``move`` from ``start`` on (both [m] ``(n, 3)``) on which nothing touches
        (:class:`GuardedTerm`), and the name of the contact that ends it."""
        ways = [(term.free_way(start, move, keep, turn), term.name) for term in self._guarded]
        return min(ways, default=(1.0, ""))

    def cover(self) -> bool:
        """Look for contact again if the way to :attr:`x` leads beyond what was looked at; True when it does."""
        if not any(term.outran() for term in self._dynamic):
            return False
        self._begin(self._step, self._internals, self._x.copy(), more=True)
        return True

    def forget(self) -> None:
        """Look for contact afresh in the next step: what it finds then depends on the state alone."""
        for term in self._dynamic:
            term.forget()
        self._factor.clear()

    def _begin(
        self, step: StepContext, internals: dict[str, Internals], towards: np.ndarray | None, more: bool = False
    ) -> None:
        self._tau = step.tau
        self._contact_at[:] = np.nan
        if towards is not None:
            changed = [term.prepare(step, towards, more) for term in self._dynamic]
            if any(changed):
                for dynamic, done in zip(self._dynamic, changed, strict=True):
                    if not done:
                        dynamic.recouple(step, towards)
                self._factor.clear()
                if self._pattern.renew([term.blocks() for term in self._dynamic]):
                    self._bind()
        self._external[:] = self.mass @ np.broadcast_to(self.gravity, self._x.shape) + self.loads
        self._predicted[:] = step.x_base + step.tau * step.v_base
        for term in self.terms:
            term.begin_step(step, internals[term.name])

    @contextmanager
    def tethered(self, tau: float) -> Iterator[None]:
        """Within this context inertia holds the system where it is now, over a time ``tau`` [s]."""
        kept = self._tau, self.inertia, self._predicted.copy()
        self._tau, self.inertia = tau, True
        self._predicted[:] = self._x
        try:
            yield
        finally:
            self._tau, self.inertia, self._predicted[:] = kept

    def energy(self) -> float:
        """Incremental potential [J] at :attr:`x`."""
        self._energy[0] = 0.0
        self._inertia_factor[0] = 1.0 / self._tau**2 if self.inertia else 0.0
        self._inertia_energy()
        for term in self.terms:
            term.add_energy()
        return float(self._energy[0]) + self._unknowns.spring_energy()

    def gradient(self) -> np.ndarray:
        """Derivative of the potential [N], ``(n, 3)``; on prescribed components the reaction's negative.

        The returned array is reused by the next call.
        """
        contact = self._contact_gradient() if self._guarded else None
        self._inertia_factor[0] = 1.0 / self._tau**2 if self.inertia else 0.0
        self._inertia_gradient()
        for term in self._bulk:
            term.add_gradient()
        if contact is not None:
            self._gradient += contact
        return self._gradient

    def static_gradient(self) -> np.ndarray:
        """As :meth:`gradient` but without gravity, loads and inertia: what the terms exert [N]."""
        self._gradient[:] = 0.0
        for term in self.terms:
            term.add_gradient()
        return np.array(self._gradient)

    def force_of(self, terms: Iterable[Term]) -> np.ndarray:
        """Force [N] ``(n, 3)`` that some of the terms exert on every node at :attr:`x`."""
        kept = self._gradient.copy()
        self._gradient[:] = 0.0
        for term in terms:
            term.add_gradient()
        out = -self._gradient
        self._gradient[:] = kept
        return np.asarray(out)

    def fold(self, gradient: np.ndarray) -> np.ndarray:
        """A nodal gradient ``(n, 3)`` with that of embedded nodes carried to those that they are embedded in."""
        return self._unknowns.fold(gradient)

    def gradient_of(self, term: Term) -> np.ndarray:
        """What one term exerts, dE/dx [N] ``(n, 3)``."""
        self._gradient[:] = 0.0
        term.add_gradient()
        return np.array(self._gradient)

    def hessian_data(self, exact: bool = False, shift: float = 0.0) -> np.ndarray:
        """Entries of :meth:`hessian` in the order of its pattern."""
        used = self._pattern.n_used
        if self.inertia:
            np.multiply(self._mass_values[:used], 1.0 / self._tau**2, out=self._hessian[:used])
        else:
            self._hessian[:used] = 0.0
        for term in self.terms:
            term.add_hessian(exact)
        data: np.ndarray = self._pattern.data(self._hessian)
        self._stiffest = self.largest_stiffness(data)
        diagonal = self._pattern.indptr[:-1]
        if self._unknowns.deflection.size:
            stiff = data[diagonal]
            self._unknowns.stiffen(stiff)
            data[diagonal] = stiff
        if shift:
            data[diagonal] += shift
        return data

    def hessian(self, exact: bool = False, shift: float = 0.0) -> sp.csr_matrix:
        """Upper triangle over the unknowns; ``shift`` [N/m] is added to the diagonal."""
        return self._pattern.matrix(self.hessian_data(exact, shift))

    def foresee(self, move: np.ndarray | None) -> None:
        """Let the stress part of the next Hessians be that which ``move`` [m] ``(n, 3)``, at whose end they are taken,
        has to first order, where a term can (None: the true one)."""
        for term in self._foreseeing:
            term.foresee(move)

    def straighten(self, start: np.ndarray) -> bool:
        """Let stiff bodies turn where the straight move from ``start`` [m] ``(n, 3)`` to :attr:`x` stretched them,
        as far as all their nodes are free; False when there are none."""
        if not self._straightening:
            return False
        for term in self._straightening:
            term.straighten(start, self._unknowns.number.reshape(-1, 3) >= 0)
        self.embed(self._x)
        return True

    def follow(self, move: np.ndarray) -> np.ndarray:
        """Force [N] on the unknowns due to moves [m] ``(n, 3)`` of what is prescribed: H_fp dx_p, with the
        Hessian that was assembled last."""
        return self._pattern.coupling(self._hessian, move)

    def nodal_product(self, move: np.ndarray) -> np.ndarray:
        """Change of :meth:`gradient` [N], on prescribed components too, for a move of the nodes [m], ``(n, 3)`` both,
        with the Hessian that was assembled last."""
        self._product_move[:] = move
        self._product()
        return np.array(self._product_out)

    def factor(self, matrix: sp.csr_matrix, definite: bool) -> Factor:
        """Factorise a matrix from :meth:`hessian`, reusing the symbolic analysis of the pattern."""
        return self.factor_data(matrix.data, definite)

    def factor_data(self, data: np.ndarray, definite: bool) -> Factor:
        """Factorise entries from :meth:`hessian_data`."""
        factor = self._factor.get(definite)
        if factor is None:
            factor = self._factor[definite] = factorise(self._pattern.matrix(data), definite)
        else:
            factor.refactor(data)
        return factor

    def largest_stiffness(self, data: np.ndarray) -> float:
        """Largest diagonal entry [N/m] of what :meth:`hessian_data` returned."""
        return float(np.abs(data[self._pattern.indptr[:-1]]).max(initial=0.0))

    def end_step(self, step: StepContext, internals: dict[str, Internals]) -> dict[str, Internals]:
        """Internal variables after the step that ended at :attr:`x`."""
        return {term.name: term.end_step(step, internals[term.name]) for term in self.terms}

    def initial_internals(self) -> dict[str, Internals]:
        return {term.name: term.initial_internals() for term in self.terms}

    def contacts(self) -> tuple[int, float]:
        """Loaded contact samples and smallest gap [m] at the last gradient."""
        found = [term.contacts() for term in self._guarded]
        return sum(c for c, _ in found), min((g for _, g in found), default=np.inf)

    def gap_of(self, name: str) -> float:
        """Smallest gap [m] of one contact at the last gradient."""
        return min(term.contacts()[1] for term in self._guarded if term.name == name)

    def tightest(self) -> str:
        """Name of the contact with the smallest gap at the last gradient, empty without any."""
        gaps = [(term.contacts()[1], term.name) for term in self._guarded]
        return min(gaps, default=(0.0, ""))[1]
