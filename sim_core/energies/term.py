"""What every term of the incremental potential offers.

A time step minimises, over the positions ``x`` of all nodes at the end of the step,

    Phi(x) = 1/2 (x - xhat)^T M (x - xhat) / tau^2  +  sum_terms E_term(x; step constants)

A term has its elements and their numbers; the compiled core (:mod:`sim_core.core`) has its law. Whatever a term
remembers from step to step (plastic curvature, relaxation stress, friction anchors) lives in named arrays outside of
it, so that a state is a value that can be copied, perturbed and replayed.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar, cast, runtime_checkable

import numpy as np

Internals = dict[str, np.ndarray]
"""Internal variables of one term by name."""

CHANGES = "changes_of_numbers"

Method = TypeVar("Method", bound=Callable[..., None])


@dataclass(frozen=True)
class Quantity:
    """A number that a term is configured with.

    ``power``: of the value that an element has of it in the element's energy, if it is a factor there; else 0.
    ``shares``: what the elements have is their share of it, which the term was given.
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


def counted(change: Method) -> Method:
    """A method of a term that changes its numbers: how often that was is known, so that what was made of them can be
    made anew."""

    @functools.wraps(change)
    def counting(term: object, *given: object, **named: object) -> None:
        change(term, *given, **named)
        setattr(term, CHANGES, changes_of(term) + 1)

    return cast(Method, counting)


def changes_of(term: object) -> int:
    """How often the numbers of a term were changed."""
    return int(getattr(term, CHANGES, 0))


class Memoryless:
    """The part of a term that has no internal variables."""

    def initial_internals(self) -> Internals:
        """None."""
        return {}


@runtime_checkable
class Declaring(Protocol):
    """A term that declares its numbers, and what its elements may have of them."""

    quantities: tuple[Quantity, ...]
