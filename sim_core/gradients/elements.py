"""What an elastic term knows of its isotropic numbers on the way back: closed forms, element by element.

They are products with the weights of a step (:class:`sim_core.gradients.step.Pulled`): of forces along ``exerted``
``(n, 3)``, and of the term's new internal variables, flattened, with ``kept``. :mod:`sim_core.gradients.fields` says
what they are. A number of the whole body has the sum over its elements, each times its share of the number where it has
one, so it costs a kernel and no step of a difference. Anisotropy is stepped (:mod:`sim_core.gradients.columns`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sim_core.energies.term import Internals, StepContext
from sim_core.gradients.directions import Key
from sim_core.gradients.step import Pulled
from sim_core.scene.fields import FLOW, HARDENING, NU, POWERS, RELAXATION, STIFFNESS_DAMPING, YIELD
from sim_core.scene.scene import Scene, Values

YOUNG = "E_pa"


def by_element(
    term: Any, quantity: str, exerted: np.ndarray, kept: np.ndarray, step: StepContext, before: Internals
) -> np.ndarray:
    """Derivatives by the values that the elements ``(m,)`` of a term have of a quantity that is more than a factor of
    their energies. The term is at the end of a step that it began from ``before``."""
    if quantity == YOUNG:
        found = term.by_modulus(exerted, kept, step, before)
    elif quantity == NU:
        found = term.by_nu(exerted, kept, step, before)
    elif quantity == STIFFNESS_DAMPING:
        found = term.by_damping(exerted, step)
    elif quantity in RELAXATION:
        found = term.by_relaxation(quantity, exerted, kept, step, before)
    elif quantity == YIELD:
        found = term.by_yield(exerted, kept, before)
    elif quantity == HARDENING:
        found = term.by_hardening(exerted, kept, before)
    else:
        raise ValueError(f"{term.name} has no closed form by {quantity}")
    return np.asarray(found)


class OwnNumbers:
    """Derivatives by those of ``keys`` that are numbers of elastic terms: ``rows``, their places in it."""

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

    def of_step(
        self, step: StepContext, internals: Mapping[str, Internals], pulled: Pulled, kept: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Derivatives ``(len(rows),)`` that a step adds, at the end of which the system is. ``internals``: before it;
        ``kept``: weights of the internal variables after it."""
        found = np.zeros(len(self.rows))
        for name, wanted in self._by_term.items():
            term, given, before = self._terms[name], self._values.terms[name], internals[name]
            body, _, part = name.rpartition(".")
            term.begin_step(step, before)
            powers = {quantity: _power(quantity, part) for _, quantity in wanted}
            work = float(term.work(pulled.exerted, before).sum()) if any(powers.values()) else 0.0
            for place, quantity in wanted:
                if powers[quantity]:
                    found[place] = powers[quantity] * work / given[quantity]
                    continue
                values = by_element(term, quantity, pulled.exerted, kept[name], step, before)
                shared = quantity in (*FLOW, *RELAXATION)
                found[place] = float(np.sum(values * self._scene.fields.share(body, quantity) if shared else values))
        return found


def _power(quantity: str, part: str) -> int:
    """Power of a quantity in the energy of a part of a sheet; 0: it is more than a factor, as all are in gels, in which
    the stress that relaxes knows the modulus, too."""
    return 0 if part == "elastic" else POWERS.get(quantity, {}).get(part, 0)


def _is_own(key: Key, terms: Mapping[str, Any]) -> bool:
    """Whether a number is one of an elastic term that it has a closed form by."""
    kind, owner, quantity = key
    if kind != "terms" or not hasattr(terms.get(owner), "work"):
        return False
    more = (YOUNG, NU, STIFFNESS_DAMPING, *RELAXATION, *FLOW)
    return quantity in more or _power(quantity, owner.rpartition(".")[2]) > 0
