"""Material laws at single points: the functions that the core calls, by their addresses."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim_core.core.material import FUNCTIONS, LANES, MaterialFormula, PointLayout
from sim_core.core.pointwise import raise_what_was_raised
from sim_core.effects.base import Values
from sim_core.effects.hooks import MaterialLaw

Array = np.ndarray


def called(formula: MaterialFormula, layout: PointLayout, name: str, *tables: Array) -> None:
    """Call one of the functions of a law for all points."""
    address = dict(zip(FUNCTIONS, formula.addresses(layout), strict=True))[name]
    function = ctypes.CFUNCTYPE(None, ctypes.c_long, *[ctypes.c_void_p] * len(tables))(address)
    function(len(tables[0]), *(t.ctypes.data for t in tables))
    raise_what_was_raised()


def responses(formula: MaterialFormula, layout: PointLayout, rows: Array) -> Array:
    """Energy, stress, tangent and new internal variables of points ``(n, 1 + k + k^2 + states)``, from rows of what
    they see ``(n, inputs)``."""
    out, new = (np.empty((len(rows), size)) for size in (1 + layout.size + layout.size**2, layout.states))
    called(formula, layout, "respond", rows, out)
    called(formula, layout, "remember", rows, new)
    return np.concatenate([out, new], axis=1)


def stresses(formula: MaterialFormula, layout: PointLayout, rows: Array) -> Array:
    """Energy and stress alone ``(n, 1 + k)``."""
    out = np.empty((len(rows), 1 + layout.size))
    called(formula, layout, "stress", rows, out)
    return out


def pushes(formula: MaterialFormula, layout: PointLayout, rows: Array, changes: Array) -> Array:
    """Changes of stress and new internal variables ``(m, n, k + states)`` along m ``changes`` of what points see
    ``(m, n, inputs)``."""
    parts = []
    for first in range(0, len(changes), LANES):
        part = changes[first : first + LANES]
        some = np.zeros((*rows.shape, LANES))
        some[..., : len(part)] = np.moveaxis(part, 0, -1)
        stress, new = (np.empty((len(rows), size, LANES)) for size in (layout.size, layout.states))
        called(formula, layout, "push_stress", rows, some, stress)
        called(formula, layout, "push_memory", rows, some, new)
        parts.append(np.moveaxis(np.concatenate([stress, new], axis=1), -1, 0)[: len(part)])
    return np.concatenate(parts)


@dataclass(frozen=True)
class Strained:
    """n points in one step of ``dt`` [s]: strains at its end and at its start ``(n, k)``, stiffness ``(n, k, k)`` and
    internal variables at the start, ``(n, ...)`` each; or changes of all that."""

    strain: Array
    before: Array
    stiffness: Array
    state: Mapping[str, Array]
    dt: float

    def rows(self, law: MaterialLaw, values: Values) -> Array:
        """What the points see, and the parameters of the law."""
        seen = {"e": self.strain, "e_0": self.before, "d": self.stiffness, **self.state, "dt": self.dt, **values}
        return law.layout(self.strain.shape[1]).rows(seen, len(self.strain))


@dataclass(frozen=True)
class Response:
    """What a law adds: energy ``(n,)``, stress ``(n, k)``, tangent ``(n, k, k)``, and the new internal variables."""

    energy: Array
    stress: Array
    tangent: Array
    state: Mapping[str, Array]


def respond(law: Any, at: Strained, values: Values) -> Response:
    """What a law adds at the end of a step."""
    n, k = at.strain.shape
    layout = law.layout(k)
    energy, stress, tangent, state = np.split(
        responses(law.formula, layout, at.rows(law, values)), np.cumsum([1, k, k * k]), axis=1
    )
    return Response(energy[:, 0], stress, tangent.reshape(n, k, k), by_name(law, state))


def push(law: Any, at: Strained, change: Strained, values: Values, by: Values) -> tuple[Array, Mapping[str, Array]]:
    """Changes of stress and of the new internal variables along changes of all that points see, and of the
    parameters, ``by``."""
    k = at.strain.shape[1]
    found = pushes(law.formula, law.layout(k), at.rows(law, values), change.rows(law, by)[None])[0]
    return found[:, :k], by_name(law, found[:, k:])


def by_name(law: MaterialLaw, rows: Array) -> dict[str, Array]:
    """Internal variables by name, from rows of them ``(n, q)``."""
    shapes = law.state()
    parts = np.split(rows, np.cumsum([int(np.prod(s)) for s in shapes.values()])[:-1], axis=1)
    return {name: part.reshape(len(rows), *shape) for (name, shape), part in zip(shapes.items(), parts, strict=False)}
