"""What every term of the incremental potential offers to the time step.

A time step minimises, over the positions ``x`` of all nodes at the end of the step,

    Phi(x) = 1/2 (x - xhat)^T M (x - xhat) / tau^2  +  sum_terms E_term(x; step constants)

A term owns its elements. It is bound once to the shared buffers and then reads positions and adds
to energy, gradient and Hessian in place. Whatever a term remembers from step to step (plastic
curvature, relaxation stress, friction anchors) lives in named arrays outside of it, so that a state
is a value that can be copied, perturbed and replayed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

if TYPE_CHECKING:
    from sim_core.energies.linearised import Linearised

Internals = dict[str, np.ndarray]
"""Internal variables of one term by name."""


@dataclass(frozen=True)
class PairTable:
    """Where the Hessian blocks of node pairs are, for terms whose pairs change.

    Row ``i`` lists the partners ``j >= i`` in ``column[start[i]:start[i + 1]]``, ascending; the nine
    values of pair ``k`` begin at ``9 * place[k]``. All int32, rewritten in place.
    """

    start: np.ndarray
    column: np.ndarray
    place: np.ndarray


@dataclass(frozen=True)
class Buffers:
    """Arrays shared by all terms; contents change, the arrays themselves do not.

    ``x``: positions [m], shape ``(n_nodes, 3)``. ``energy``: [J], shape ``(1,)``. ``gradient``:
    dPhi/dx [N], shape ``(n_nodes, 3)``. ``hessian``: values of the upper triangle of the sparse
    Hessian [N/m], shape ``(n_values,)``; the last slot swallows the lower triangle. ``pairs``: for dynamic terms.
    """

    x: np.ndarray
    energy: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    pairs: PairTable | None = None


@dataclass(frozen=True)
class StepContext:
    """Constants of one step: positions and velocities at its start, its length [s], and what the velocity
    (``x_base``, ``tau`` [s]) and the acceleration (``v_base``) at its end are measured from
    (:func:`sim_core.solve.integrator.step_context`). ``x_past``: positions at the start of the step before, where the
    integrator looks back; ``weights``: of start and past in ``x_base``."""

    x_start: np.ndarray
    v_start: np.ndarray
    dt: float
    x_base: np.ndarray
    v_base: np.ndarray
    tau: float
    x_past: np.ndarray | None = None
    weights: tuple[float, float] = (1.0, 0.0)

    def base(self, quantity: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """What the rate of a quantity q(x) at the end of the step is measured from: dq/dt = (q(x') - base) / tau.

        A strain that is weighed as a strain, and not taken at ``x_base``, has no rate while a body turns rigidly.
        """
        now, before = self.weights
        found = now * quantity(self.x_start)
        return found if self.x_past is None else found + before * quantity(self.x_past)


class Term(Protocol):
    """One law: its energy, its derivatives, its internal variables."""

    name: str
    mirrored: bool
    """Entries below the diagonal are folded onto their mirror image (the term lists each pair once)
    instead of being dropped (the term lists both partners)."""

    def blocks(self) -> np.ndarray:
        """Node pairs coupled by the Hessian, in storage order: int32, shape ``(n_blocks, 2)``.

        Each pair ``(i, j)`` stands for the full 3 x 3 block d2E/dx_i dx_j. Symmetric partners are
        listed too (the assembly drops the lower triangle).
        """
        ...

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        """Prepare the kernels. ``slots``: int32 ``(n_blocks, 9)``, place of each entry of each block."""
        ...

    def configure(self, parameters: Mapping[str, float]) -> None:
        """Take material values by name (without the body prefix). Must be cheap: no re-meshing."""
        ...

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        """Freeze what is constant during the step."""
        ...

    def add_energy(self) -> None:
        """Add the energy at ``buffers.x`` to ``buffers.energy``."""
        ...

    def add_gradient(self) -> None:
        """Add dE/dx at ``buffers.x`` to ``buffers.gradient``."""
        ...

    def add_hessian(self, exact: bool) -> None:
        """Add d2E/dx2 to ``buffers.hessian``; positive semidefinite by construction unless ``exact``."""
        ...

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        """Internal variables after the step that ended at ``buffers.x``."""
        ...

    def initial_internals(self) -> Internals:
        """Internal variables of a virgin body at rest."""
        ...


class Memoryless:
    """The part of a term that has no internal variables; one that depends on the start of the step overrides
    ``begin_step``."""

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        del step, internals

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        del step
        return internals

    def initial_internals(self) -> Internals:
        return {}


class RememberingTerm(Term, Protocol):
    """A term whose force depends on more than the positions at the end of the step, or that remembers them."""

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised | None:
        """Derivatives of dE/dx and of the new internal variables ``after`` at ``buffers.x``, at the end of a step that
        ``begin_step`` began from ``internals``; None where the term has no memory after all."""
        ...


class DynamicTerm(Term, Protocol):
    """A term whose coupled nodes change: contact between deformable bodies.

    Its ``blocks`` may come in any order, and ``bind`` gets no slots: blocks are added where
    ``buffers.pairs`` says (:func:`sim_core.kernels.add_block`).
    """

    def prepare(self, step: StepContext, towards: np.ndarray, more: bool = False) -> bool:
        """Look for partners from the start of a step on, in which nodes are foreseen to go to ``towards`` [m]
        ``(n, 3)``, beside those at hand if ``more``; True when ``blocks`` changed."""
        ...

    def recouple(self, step: StepContext, towards: np.ndarray) -> None:
        """Renew ``blocks`` too, because those of another term changed: all at once costs one new pattern."""
        ...

    def forget(self) -> None:
        """Look for partners afresh next time."""
        ...

    def outran(self) -> bool:
        """True when the step has moved further than partners were looked for."""
        ...


@runtime_checkable
class ByAreas(Term, Protocol):
    """A term on the triangles of a sheet, in their order, that knows the shape at rest by their areas alone."""

    def by_areas(self, along: np.ndarray) -> np.ndarray:
        """Derivative of the work of the forces dE/dx along nodal vectors ``(n, 3)`` by the areas at rest ``(m,)``."""
        ...


class GuardedTerm(Term, Protocol):
    """A term whose surfaces never cross: every kind of contact."""

    def guard(self, on: bool) -> None:
        """Off: bear positions in which surfaces overlap, with forces that part them again."""
        ...

    def free_way(self, start: np.ndarray, move: np.ndarray, keep: float, turn: tuple[float, float]) -> float:
        """Share of ``move`` from ``start`` on, straight paths of all nodes [m] ``(n, 3)``, on which every gap keeps
        the share ``keep`` of what it was, while rigid bodies turn from one share of the step to another."""
        ...

    def carried(self, internals: Internals, move: np.ndarray) -> Internals:
        """Internal variables at the start of the step that was begun last, if it began with all nodes moved by
        ``move`` [m] ``(n, 3)`` and the springs of friction stretched by that: where the step ends they hold as before.
        """
        ...

    def contacts(self) -> tuple[int, float]:
        """Number of loaded points and smallest gap [m] at the last gradient."""
        ...
