"""What every term of the incremental potential offers.

A time step minimises, over the positions ``x`` of all nodes at the end of the step,

    Phi(x) = 1/2 (x - xhat)^T M (x - xhat) / tau^2  +  sum_terms E_term(x; step constants)

A term has its elements and their numbers; the compiled core (:mod:`sim_core.core`) has its law. Whatever a term
remembers from step to step (plastic curvature, relaxation stress, friction anchors) lives in named arrays outside of
it, so that a state is a value that can be copied, perturbed and replayed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

Internals = dict[str, np.ndarray]
"""Internal variables of one term by name."""


@dataclass(frozen=True)
class Quantity:
    """A number that a term is configured with.

    ``power``: of the value that an element has of it in the element's energy, if it is a factor there; else 0.
    ``shares``: what the elements have is their share of it, which the term was told.
    """

    name: str
    unit: str
    power: int = 0
    shares: bool = False


class Term(Protocol):
    """One law's elements."""

    name: str

    def configure(self, parameters: Mapping[str, float]) -> None:
        """Take material values by name (without the body prefix). Must be cheap: no re-meshing."""
        ...

    def initial_internals(self) -> Internals:
        """Internal variables of a virgin body at rest."""
        ...


class Memoryless:
    """The part of a term that has no internal variables."""

    def initial_internals(self) -> Internals:
        """None."""
        return {}


@runtime_checkable
class Declaring(Protocol):
    """A term that declares its numbers, and what its elements may have of them."""

    quantities: tuple[Quantity, ...]
