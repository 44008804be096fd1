"""What terms know of their numbers on the way back: closed forms, element by element.

They are products with the weights of a step (:class:`sim_core.gradients.step.Pulled`): of forces along ``exerted``
``(n, 3)``, and of the term's new internal variables, flattened, with ``kept``. :mod:`sim_core.gradients.fields` says
what they are. A number of the whole body has the sum over its elements, each times its share of the number where it has
one, so it costs a kernel and no step of a difference. Anisotropy is stepped
(:mod:`sim_core.gradients.parameter_jacobian`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sim_core.energies.term import Along, Declaring, GradedTerm, Internals, StepContext
from sim_core.gradients.directions import Key
from sim_core.gradients.step import Pulled
from sim_core.scene.scene import Scene, Values


class Alongs:
    """The end of a step on the way back, where the system is: each term looks at it once, whoever asks."""

    def __init__(
        self, step: StepContext, internals: Mapping[str, Internals], pulled: Pulled, kept: Mapping[str, np.ndarray]
    ) -> None:
        """Take a step: ``internals`` before it, and weights ``kept`` of those after it."""
        self.step, self.internals, self.pulled, self.kept = step, internals, pulled, kept
        self._seen: dict[str, Along] = {}
        self._works: dict[str, np.ndarray] = {}

    def _of(self, term: Any) -> Along:
        """What a term knows along the weights: derivatives by the values of its elements, or of the whole body."""
        name = term.name
        if name not in self._seen:
            self._seen[name] = term.along(self.pulled.exerted, self.kept[name], self.step, self.internals[name])
        return self._seen[name]

    def work(self, term: Any) -> np.ndarray:
        """Work of the forces dE/dx of each element ``(m,)``: a factor f of its energy has the derivative work / f."""
        if term.name not in self._works:
            self._works[term.name] = self._of(term).work()
        return self._works[term.name]

    def by(self, term: Any, quantity: str) -> np.ndarray:
        """Derivatives by the values that the elements have of a quantity that is more than a factor of their
        energies."""
        return np.asarray(self._of(term).by(quantity))


class OwnNumbers:
    """Derivatives by those of ``keys`` that are numbers of such terms: ``rows``, their places in it."""

    def __init__(self, scene: Scene, values: Values, keys: Sequence[Key]) -> None:
        self._scene, self._values = scene, values
        terms: dict[str, Any] = {t.name: t for t in scene.system.terms}
        self.rows = [k for k, key in enumerate(keys) if _is_own(key, terms)]
        self._by_term: dict[str, list[tuple[int, str]]] = {}
        for place, row in enumerate(self.rows):
            _, name, quantity = keys[row]
            self._by_term.setdefault(name, []).append((place, quantity))
        self._terms = {name: terms[name] for name in self._by_term}

    def __bool__(self) -> bool:
        return bool(self.rows)

    def of_step(self, alongs: Alongs) -> np.ndarray:
        """Derivatives ``(len(rows),)`` that a step adds."""
        found = np.zeros(len(self.rows))
        for name, wanted in self._by_term.items():
            term, given = self._terms[name], self._values.terms[name]
            body, declared = name.rpartition(".")[0], {q.name: q for q in term.quantities}
            for place, quantity in wanted:
                if _is_graded(term, quantity):
                    found[place] = float(alongs.work(term) @ term.grading.by(quantity))
                    continue
                of = declared[quantity]
                if not of.closed:
                    found[place] = of.power * float(alongs.work(term).sum()) / given[quantity]
                    continue
                values = alongs.by(term, quantity)
                found[place] = float(np.sum(values * self._scene.fields.share(body, quantity) if of.shares else values))
        return found


def _is_own(key: Key, terms: Mapping[str, Any]) -> bool:
    """Whether a number is one that its term differentiates itself along weights."""
    kind, owner, quantity = key
    term = terms.get(owner)
    if kind != "terms" or not isinstance(term, Declaring):
        return False
    return any(q.name == quantity for q in term.quantities) or _is_graded(term, quantity)


def _is_graded(term: Any, quantity: str) -> bool:
    """Whether a number is one by which effects scale the elements of a term."""
    return isinstance(term, GradedTerm) and term.grading is not None and quantity in term.grading.numbers
