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
    from sim_core.energies.grading import Grading
    from sim_core.energies.linearised import Linearised

Internals = dict[str, np.ndarray]
"""Internal variables of one term by name."""


@dataclass(frozen=True)
class Quantity:
    """A number that a term is configured with, and differentiates itself.

    ``power``: of the value that an element has of it in the element's energy, if it is a factor there; else 0.
    ``closed``: what the term knows :class:`Along` weights has the derivative by it; a number that is a factor of all
    that the term does needs none. ``shares``: what the elements have is their share of it, which the term was told.
    """

    name: str
    unit: str
    power: int = 0
    closed: bool = True
    shares: bool = False


class Along(Protocol):
    """What a term knows along the weights of forces and of new internal variables at the end of a step."""

    def work(self) -> np.ndarray:
        """Work of the forces dE/dx of each element ``(m,)``: a factor f of its energy has the derivative work / f."""
        ...

    def by(self, quantity: str) -> np.ndarray:
        """Derivatives by the values that the elements have of a number of the term ``(m,)``; by one that all of the
        body has, as much as a number."""
        ...


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
    integrator looks back; ``weights``: of start and past in ``x_base``; ``time`` [s]: since the start of the rollout,
    at that of the step; below zero in steps that settle bodies, which end at the start of the rollout."""

    x_start: np.ndarray
    v_start: np.ndarray
    dt: float
    x_base: np.ndarray
    v_base: np.ndarray
    tau: float
    x_past: np.ndarray | None = None
    weights: tuple[float, float] = (1.0, 0.0)
    time: float = 0.0

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
    measured_at_rest: bool
    """Whether its forces depend on the shape at rest, beyond masses: then it has a derivative by it."""

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


@runtime_checkable
class RememberingTerm(Protocol):
    """A term whose force depends on more than the positions at the end of the step, or that remembers them."""

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised | None:
        """Derivatives of dE/dx and of the new internal variables ``after`` at ``buffers.x``, at the end of a step that
        ``begin_step`` began from ``internals``; None where the term has no memory after all."""
        ...


@runtime_checkable
class Declaring(Protocol):
    """A term that declares its numbers, and what its elements may have of them."""

    quantities: tuple[Quantity, ...]

    def along(self, vectors: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals) -> Along:
        """What forces along nodal ``vectors`` ``(n, 3)``, and new internal variables with the weights ``kept``,
        flattened, know of these numbers at the end of a step from ``internals``."""
        ...


@runtime_checkable
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
class ByRestAngles(Protocol):
    """A term that knows the rest angles of a sheet's hinges."""

    name: str

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        """As of any term."""
        ...

    def by_rest_angles(
        self, along: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals
    ) -> np.ndarray:
        """Derivative by the rest angles ``(n_hinges,)`` of the work of the forces along nodal vectors ``(n, 3)``, and
        of the product of the new internal variables, flattened, with ``kept``."""
        ...


@runtime_checkable
class GradedTerm(Term, Protocol):
    """A term whose elements effects scale from place to place and in time (None: none does)."""

    grading: Grading | None

    def grade(self, grading: Grading) -> None:
        """Take the factors of effects."""
        ...


@runtime_checkable
class ByAreas(Term, Protocol):
    """A term on the triangles of a sheet, in their order, that knows the shape at rest by their areas alone."""

    def by_areas(self, along: np.ndarray) -> np.ndarray:
        """Derivative of the work of the forces dE/dx along nodal vectors ``(n, 3)`` by the areas at rest ``(m,)``."""
        ...


@runtime_checkable
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


@runtime_checkable
class TurningTerm(Protocol):
    """A term of a rigid body that turns within a step."""

    @property
    def turns(self) -> bool:
        """Whether it turns in this step."""
        ...

    def turn(self, share: float) -> None:
        """Turn it to where it is after ``share`` of the step."""
        ...


@runtime_checkable
class StraighteningTerm(Protocol):
    """A term of bodies that turn along curved paths."""

    def straighten(self, start: np.ndarray, free: np.ndarray) -> None:
        """Let bodies turn where the straight move from ``start`` [m] ``(n, 3)`` stretched them; ``free``: bool
        ``(n, 3)``."""
        ...


@runtime_checkable
class ForeseeingTerm(Protocol):
    """A term whose Hessian can have the stress that a move makes to first order."""

    def foresee(self, move: np.ndarray | None) -> None:
        """Take the stress of ``move`` [m] ``(n, 3)``, at whose end the Hessian is taken (None: the true one)."""
        ...


@runtime_checkable
class AligningTerm(Protocol):
    """A term whose internal variables are those of pairs that come and go."""

    def aligned(self, internals: Internals, like: Internals) -> Internals:
        """Internal variables in the order of others."""
        ...


_CAPABILITIES = (RememberingTerm, DynamicTerm, ByAreas, ByRestAngles, GuardedTerm, TurningTerm, Declaring)

_REST_DERIVATIVES = ("by_rest", "by_areas", "rest_weights", "measures")


def check_term(term: Term) -> None:
    """Raise ``TypeError`` where the class of a term lacks a derivative that what it does asks for, or a part of what it
    began to declare. Called for every term when a system is built."""
    kind = type(term)

    def has(name: str) -> bool:
        return getattr(term, name, None) is not None

    for name in ("begin_step", "initial_internals"):
        if getattr(kind, name, None) is not getattr(Memoryless, name) and not has("linearise"):
            what = "depends on the start of its step" if name == "begin_step" else "keeps internal variables"
            raise TypeError(
                f"The term {term.name} ({kind.__name__}) {what} ({name}) and has no method linearise: gradients would "
                "lack that. Write linearise, which returns None where neither forces nor memory depend on it."
            )
    if not has("measured_at_rest"):
        raise TypeError(
            f"The term {term.name} ({kind.__name__}) does not say whether its forces depend on the shape at rest: set "
            "measured_at_rest."
        )
    if term.measured_at_rest and not any(has(name) for name in _REST_DERIVATIVES):
        raise TypeError(
            f"The term {term.name} ({kind.__name__}) is measured at rest and has no derivative by the shape at rest: "
            f"write one of {', '.join(_REST_DERIVATIVES)}."
        )
    common = {*vars(Term), *Term.__annotations__}
    for capability in _CAPABILITIES:
        names = [n for n in (*vars(capability), *capability.__annotations__) if n not in common and n[0] != "_"]
        lacking = [n for n in names if not has(n)]
        if 0 < len(lacking) < len(names):
            raise TypeError(
                f"The term {term.name} ({kind.__name__}) has a part of {capability.__name__} and lacks "
                f"{', '.join(lacking)}."
            )
