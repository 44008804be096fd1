"""Host of the material laws that effects add to a body: from generalised strains to nodes, and back.

A law (:class:`sim_core.effects.hooks.MaterialLaw`) says what stress s it adds to an element of area A by the strain e
at the end of a step, the strain e_0 at its start and its internal variables z, and what these are then, z'. With the
strains e(x') and L = de/dx', the term of all laws of one strain measure is

    E = sum_T A_T w(e_T; e_0, z),    dE/dx' = L^T A s,    d2E/dx'^2 = L^T A (ds/de) L + A s . d2e/dx'^2

and its derivatives by anything else are those of the law, by :meth:`~sim_core.effects.hooks.MaterialLaw.push`, and of
the strains, by the measure (:mod:`sim_core.energies.membrane_strain`, :mod:`sim_core.energies.bending_strain`,
:mod:`sim_core.energies.solid_strain`). Without ``exact`` the tangents are made positive semidefinite one by one, so
that any law may be added to any other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import scipy.sparse as sp

from sim_core.effects.hooks import MaterialLaw, Response, Strained
from sim_core.energies.grading import Grading
from sim_core.energies.linearised import ByNumber, Linearised, placed, places, size_of
from sim_core.energies.term import Buffers, Internals, Quantity, StepContext
from sim_core.materials.elastic import applied

if TYPE_CHECKING:
    from sim_core.effects.base import Effect


class StrainMeasure(Protocol):
    """Strains ``(m, k)`` of the m triangles of a sheet, or quadrature points of a gel, and what they do to nodes ``(n,
    3)``. ``areas``: of the triangles times the factors of their stiffness [m^2], ``whole_areas`` without, of points
    volumes [m^3]; ``stiffness``: of the body's own law, ``(m, k, k)``; all change in place."""

    components: int
    """k."""
    quantities: tuple[Quantity, ...]
    """Of the numbers of the body's own law those that its stiffness depends on."""

    @property
    def areas(self) -> np.ndarray: ...

    @property
    def whole_areas(self) -> np.ndarray: ...

    @property
    def stiffness(self) -> np.ndarray: ...

    @property
    def grading(self) -> Grading | None: ...

    def stiffness_by(self, quantity: str) -> np.ndarray:
        """Derivative of ``stiffness`` by one of the body's numbers ``(m, k, k)``."""
        ...

    def at_points(self, values: np.ndarray) -> np.ndarray:
        """Values of the body's elements, each at all that it has strains of, ``(m,)``."""
        ...

    def of_elements(self, values: np.ndarray) -> np.ndarray:
        """Sums of values ``(m,)`` over the elements."""
        ...

    def blocks(self) -> np.ndarray:
        """As of a term."""
        ...

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        """As of a term."""
        ...

    @property
    def here(self) -> np.ndarray:
        """The positions at hand, of all nodes."""
        ...

    def strains(self) -> np.ndarray:
        """At the positions at hand."""
        ...

    def strains_at(self, x: np.ndarray) -> np.ndarray:
        """At other positions."""
        ...

    def foreseen(self, strains: np.ndarray, move: np.ndarray) -> np.ndarray:
        """What the ``move`` that ends at the positions at hand makes of strains to first order."""
        ...

    def along(self, vectors: np.ndarray) -> np.ndarray:
        """Change of the strains along nodal vectors."""
        ...

    def by_positions(self, x: np.ndarray) -> sp.csr_matrix:
        """Derivative of all strains by all positions at ``x``, ``(k m, 3 n)``."""
        ...

    def by_rest_angles(self, weights: np.ndarray) -> np.ndarray:
        """Derivative of strains with the weights ``(m, k)`` by the rest angles of the sheet's hinges."""
        ...

    def add_gradient(self, stress: np.ndarray) -> None:
        """Add the forces of stresses times areas, ``(m, k)``, to the gradient."""
        ...

    def add_hessian(self, stress: np.ndarray, tangent: np.ndarray, exact: bool) -> None:
        """Add L^T A ``tangent`` L, and what the strains' second derivatives make of ``stress``, without what would
        soften unless ``exact``."""
        ...


@dataclass(frozen=True)
class RestWeights:
    """What the work of forces along nodal vectors and the weighted new internal variables know of the shape at rest:
    weights of the strains at the end, at the start, and along the vectors ``(m, k)``, and derivatives by the areas
    ``(m,)``."""

    end: np.ndarray
    start: np.ndarray
    along: np.ndarray
    by_area: np.ndarray


class StrainLaws:
    """Term of all material laws of one strain ``measure`` of a body. Its numbers are those of the body's stiffness, and
    ``<key>.<parameter>`` of each law."""

    mirrored = True
    measured_at_rest = True

    def __init__(self, name: str, measure: StrainMeasure) -> None:
        self.name, self.measure = name, measure
        self._laws: dict[str, MaterialLaw] = {}
        self._values: dict[str, dict[str, float]] = {}
        self._given: dict[str, float] = {}
        self._internals: Internals = {}
        self._move: np.ndarray | None = None
        self._found: dict[str, Response] | None = None

    def add(self, key: str, effect: Effect) -> None:
        """Take a law whose numbers are called ``<key>.<parameter>``."""
        if isinstance(effect, MaterialLaw):
            self._laws[key] = effect

    def numbers(self, body: Mapping[str, float], laws: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
        """What to configure the term with: of the numbers of the ``body``'s own term those of its stiffness, and the
        values of the laws by their keys."""
        graded = () if self.measure.grading is None else self.measure.grading.numbers
        own = {name: body[name] for name in (*(q.name for q in self.measure.quantities), *graded) if name in body}
        return {**own, **{f"{key}.{name}": value for key in self._laws for name, value in laws[key].items()}}

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What its elements differ in, and its other numbers."""
        laws = (Quantity(f"{key}.{p.name}", p.unit) for key, law in self._laws.items() for p in law.parameters)
        graded = {} if self.measure.grading is None else self.measure.grading.numbers
        return (*self.measure.quantities, *(Quantity(name, unit) for name, unit in graded.items()), *laws)

    def blocks(self) -> np.ndarray:
        return self.measure.blocks()

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._x, self._total = buffers.x, buffers.energy
        self._seen = np.full_like(buffers.x, np.nan)
        self.measure.bind(buffers, slots)

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._given = dict(parameters)
        self._values = {
            key: {p.name: parameters[f"{key}.{p.name}"] for p in law.parameters} for key, law in self._laws.items()
        }
        self._found = None

    def foresee(self, move: np.ndarray | None) -> None:
        """As :meth:`sim_core.energies.membrane.Membrane.foresee`."""
        self._move = None if move is None else move.copy()

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        self._before, self._internals, self._dt = self.measure.strains_at(step.x_start), internals, step.dt
        self._found = None

    def _strained(self, key: str, strain: np.ndarray) -> Strained:
        """What the law of one instance sees."""
        return Strained(strain, self._before, self.measure.stiffness, self._state(self._internals, key), self._dt)

    def _state(self, internals: Internals, key: str) -> dict[str, np.ndarray]:
        return {name: internals[f"{key}.{name}"] for name in self._laws[key].state()}

    def _responses(self) -> dict[str, Response]:
        """Of all laws at the positions at hand."""
        if self._found is None or not np.array_equal(self._seen, self._x):
            self._seen[:] = self._x
            self._found = self._at(self.measure.strains())
        return self._found

    def _at(self, strain: np.ndarray) -> dict[str, Response]:
        return {key: law.respond(self._strained(key, strain), self._values[key]) for key, law in self._laws.items()}

    def _stress(self) -> np.ndarray:
        first, *others = (r.stress for r in self._responses().values())
        return np.asarray(sum(others, first))

    def add_energy(self) -> None:
        for found in self._responses().values():
            self._total[0] += float(self.measure.areas @ found.energy)

    def add_gradient(self) -> None:
        self.measure.add_gradient(self.measure.areas[:, None] * self._stress())

    def add_hessian(self, exact: bool) -> None:
        found = self._responses()
        stress, tangent = self._stress(), sum(r.tangent for r in found.values())
        if not exact:
            values, axes = np.linalg.eigh(tangent)
            if values.min(initial=0.0) < 0.0:
                tangent = (axes * np.maximum(values, 0.0)[:, None]) @ axes.swapaxes(-1, -2)
            if self._move is not None:
                there = self._at(self.measure.foreseen(self.measure.strains(), self._move))
                stress = np.asarray(sum((r.stress for r in there.values()), np.zeros_like(stress)))
        self.measure.add_hessian(stress, np.asarray(tangent), exact)

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        del step, internals
        return {f"{key}.{name}": value for key, r in self._responses().items() for name, value in r.state.items()}

    @property
    def lasting(self) -> tuple[str, ...]:
        """Names of the internal variables that last."""
        return tuple(f"{key}.{name}" for key, law in self._laws.items() for name in law.lasting)

    def initial_internals(self) -> Internals:
        count = len(self.measure.areas)
        return {
            f"{key}.{name}": np.zeros((count, *shape))
            for key, law in self._laws.items()
            for name, shape in law.state().items()
        }

    def _pushed(
        self, key: str, change: Mapping[str, np.ndarray], by: Mapping[str, float] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes of stress ``(..., m, k)`` and of the new state of one law, a row an element ``(..., m, q)``, along
        changes of what it sees; what is not named does not change."""
        at = self._strained(key, self.measure.strains())
        state = {name: change.get(name, np.zeros_like(z)) for name, z in at.state.items()}
        strain, before = (change.get(name, np.zeros_like(at.strain)) for name in ("strain", "before"))
        moved = Strained(strain, before, change.get("stiffness", np.zeros_like(at.stiffness)), state, 0.0)
        numbers = {**dict.fromkeys(self._values[key], 0.0), **(by or {})}
        stress, new = self._laws[key].push(at, moved, self._values[key], numbers)
        count = len(at.strain)
        lead = np.broadcast_shapes(
            strain.shape[:-2],
            before.shape[:-2],
            *(z.shape[: z.ndim - at.state[name].ndim] for name, z in state.items()),
        )
        rows = [np.broadcast_to(z, (*lead, *at.state[name].shape)).reshape(*lead, count, -1) for name, z in new.items()]
        stress = np.broadcast_to(stress, (*lead, *at.strain.shape))
        return stress, np.concatenate([*rows, np.empty((*lead, count, 0))], axis=-1)

    def _by_strain(self, key: str, which: str) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of stress ``(m, k, k)`` and state ``(m, q, k)`` by the strain at the end or ``before``."""
        count = len(self.measure.areas)
        units = np.repeat(np.eye(self.measure.components)[:, None], count, axis=1)
        stress, state = self._pushed(key, {which: units})
        return np.moveaxis(stress, 0, -1), np.moveaxis(state, 0, -1)

    def _by_state(self, key: str) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of stress ``(m, k, q)`` and state ``(m, q, q)`` by the state of the same element."""
        parts, count = [], len(self.measure.areas)
        for name, shape in self._laws[key].state().items():
            size = int(np.prod(shape))
            units = np.broadcast_to(np.eye(size).reshape(size, 1, *shape), (size, count, *shape))
            parts.append(self._pushed(key, {name: units}))
        if not parts:
            return np.zeros((count, self.measure.components, 0)), np.zeros((count, 0, 0))
        stress, state = (np.concatenate([np.moveaxis(p[k], 0, -1) for p in parts], axis=-1) for k in range(2))
        return stress, state

    def _rows(self, internals: Internals, key: str) -> np.ndarray:
        """Places of the state of one law in the flattened internal variables, a row an element ``(m, q)``."""
        place = places(internals)
        count = len(self.measure.areas)
        rows = [place[f"{key}.{name}"].reshape(count, -1) for name in self._laws[key].state()]
        return np.concatenate(rows, axis=1) if rows else np.empty((count, 0), dtype=int)

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised:
        """Derivatives by the start of the step, by the internal variables, and by all numbers of the term."""
        self.begin_step(step, internals)
        area, size = self.measure.areas[:, None, None], size_of(internals)
        end, start = self.measure.by_positions(self._x), self.measure.by_positions(step.x_start)
        count = len(self.measure.areas)
        strains = np.arange(self.measure.components * count).reshape(count, -1)
        by_start, by_memory = _Sum((strains.size, strains.size)), _Sum((strains.size, size))
        kept_end, kept_start = _Sum((size, strains.size)), _Sum((size, strains.size))
        kept_kept = _Sum((size, size))
        for key in self._laws:
            rows = self._rows(internals, key)
            kept_end.add(self._by_strain(key, "strain")[1], rows, strains)
            stress, state = self._by_strain(key, "before")
            by_start.add(area * stress, strains, strains)
            kept_start.add(state, rows, strains)
            stress, state = self._by_state(key)
            by_memory.add(area * stress, strains, rows)
            kept_kept.add(state, rows, rows)
        numbers = {}
        for quantity in self._given:
            stress, kept = self._by_number(quantity, internals)
            force = end.T @ (self.measure.areas[:, None] * stress).ravel()
            numbers[quantity] = ByNumber(force, kept, np.zeros(3))
        return Linearised(
            numbers=numbers,
            force_start=(end.T @ by_start.matrix() @ start).tocoo(),
            force_memory=(end.T @ by_memory.matrix()).tocoo(),
            memory_start=(kept_start.matrix() @ start).tocoo(),
            memory_memory=kept_kept.matrix().tocoo(),
            memory_end=(kept_end.matrix() @ end).tocoo(),
        )

    def _changes(self, quantity: str) -> Iterator[tuple[str, tuple[np.ndarray, np.ndarray]]]:
        """What a number of the term changes: keys of laws, with stress and state as of :meth:`_pushed`."""
        if self.measure.grading is not None and quantity in self.measure.grading.numbers:
            grown = self.measure.at_points(self.measure.grading.by(quantity))[:, None]
            for key, found in self._responses().items():
                yield key, (grown * found.stress, np.zeros((len(grown), self._rows(self._internals, key).shape[1])))
            return
        owner, _, parameter = quantity.rpartition(".")
        if owner:
            yield owner, self._pushed(owner, {}, {parameter: 1.0})
            return
        slope = self.measure.stiffness_by(quantity)
        for key in self._laws:
            yield key, self._pushed(key, {"stiffness": slope})

    def _by_number(self, quantity: str, internals: Internals) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the stresses ``(m, k)`` and of the new internal variables, flattened, by one number."""
        stress, kept = np.zeros_like(self._before), np.zeros(size_of(internals))
        for key, (more, state) in self._changes(quantity):
            stress = stress + more
            kept[self._rows(internals, key)] += state
        return stress, kept

    def along(self, vectors: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals) -> StrainLawsAlong:
        """What forces along nodal ``vectors`` ``(n, 3)``, and new internal variables with the weights ``kept``,
        flattened, know of the body's numbers at the end of a step from ``internals``, element by element."""
        self.begin_step(step, internals)
        virtual = self.measure.areas[:, None] * self.measure.along(vectors)

        def by(quantity: str) -> np.ndarray:
            total = np.zeros(len(virtual))
            for key, (stress, state) in self._changes(quantity):
                total += (virtual * stress).sum(axis=1) + (kept[self._rows(internals, key)] * state).sum(axis=1)
            return self.measure.of_elements(total)

        return StrainLawsAlong(self.measure.of_elements((virtual * self._stress()).sum(axis=1)), by)

    def rest_weights(self, along: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals) -> RestWeights:
        """Of a step that ends at the positions at hand; ``along``, ``kept`` as of :meth:`along`."""
        self.begin_step(step, internals)
        straining, stress = self.measure.along(along), self._stress()
        virtual = self.measure.areas[:, None] * straining
        ends = []
        for which in ("strain", "before"):
            total = np.zeros_like(virtual)
            for key in self._laws:
                by_stress, by_state = self._by_strain(key, which)
                total += applied(by_stress.swapaxes(-1, -2), virtual)
                total += np.einsum("mqk,mq->mk", by_state, kept[self._rows(internals, key)])
            ends.append(total)
        share = self.measure.areas / self.measure.whole_areas
        work = (stress * straining).sum(axis=1)
        return RestWeights(ends[0], ends[1], self.measure.areas[:, None] * stress, share * work)

    def by_rest_angles(
        self, along: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals
    ) -> np.ndarray:
        """As of :class:`sim_core.energies.term.ByRestAngles`."""
        weights = self.rest_weights(along, kept, step, internals)
        return self.measure.by_rest_angles(weights.end + weights.start)


@dataclass(frozen=True)
class StrainLawsAlong:
    """Element by element ``(m,)``: the work of the forces, and what gives the derivative of it, and of the weighted
    new internal variables, by a number. Good for as long as the term does not go on."""

    _work: np.ndarray
    _by: Callable[[str], np.ndarray]

    def work(self) -> np.ndarray:
        """Work of the forces dE/dx."""
        return self._work

    def by(self, quantity: str) -> np.ndarray:
        """Derivative by a number of the term."""
        return self._by(quantity)


class _Sum:
    """A sparse matrix that is a sum of dense blocks."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, values: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> None:
        """Add blocks ``(n, a, b)`` at rows ``(n, a)`` and columns ``(n, b)``."""
        self._parts.append((values, rows, columns))

    def matrix(self) -> sp.csr_matrix:
        """The sum."""
        return placed(*self._parts, shape=self._shape).tocsr()
