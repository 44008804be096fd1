"""Numbers with their first and second derivatives, as arrays: :file:`include/dual.hpp` for numpy.

A :class:`Jet` has the value ``v`` ``(n,)``, the derivatives ``d`` ``(k, n)`` in k directions and the second ones ``h``
``(k (k + 1) / 2, n)``, of which the pairs (i, j), j <= i, stand row by row. Comparisons are those of values. Where a
law branches by one (:class:`Truth`), points go on in two groups (:func:`at_points`).
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

__all__ = ["NAMES", "Jet", "Tensor", "Vector", "at_points"]

Array = np.ndarray


@functools.cache
def _pairs(k: int) -> tuple[Array, Array]:
    return np.tril_indices(k)


class Branches(Exception):
    """A law takes one way at some points, ``where`` ``(n,)``, and another at the rest."""

    def __init__(self, where: Array) -> None:
        super().__init__()
        self.where = where


class Truth(np.ndarray):
    """Which of the points a comparison holds at; as the condition of a branch it is that of all of them, or raises
    :class:`Branches`."""

    def __bool__(self) -> bool:
        plain = np.asarray(self)
        if plain.all() or not plain.any():
            return bool(plain.all())
        raise Branches(plain)


def at_points(function: Callable[[Array], list[Array]], count: int) -> list[Array]:
    """Arrays ``(..., count)`` that a function makes of all points. It is given some of them at once, by their numbers
    ``(n,)``: those that take the same way, or one by one where it branches by integers."""

    def of(points: Array) -> list[Array]:
        try:
            return function(points)
        except Branches as branches:
            groups = [points[branches.where], points[~branches.where]]
        except ValueError:  # the truth of an array of integers
            if len(points) == 1:
                raise
            groups = [points[:1], points[1:]]
        order = np.argsort(np.concatenate(groups))
        return [np.concatenate(each, axis=-1)[..., order] for each in zip(*map(of, groups), strict=True)]

    return of(np.arange(count))


class Jet:
    """See the module."""

    __array_ufunc__ = None  # numbers of numpy leave operators to this class
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, v: Array, d: Array, h: Array) -> None:
        self.v, self.d, self.h = v, d, h

    @classmethod
    def variables(cls, values: Array) -> list[Jet]:
        """Variables with values ``(k, n)``, each with a direction of its own."""
        k = len(values)
        none = np.zeros((k * (k + 1) // 2, 1))
        return [cls(v, e[:, None], none) for v, e in zip(values, np.eye(k), strict=True)]

    @property
    def parts(self) -> list[Array]:
        """Value and derivatives."""
        return [self.v, self.d, self.h]

    def second(self, i: int, j: int) -> Array:
        """Second derivative in two directions ``(n,)``."""
        i, j = max(i, j), min(i, j)
        return np.asarray(self.h[i * (i + 1) // 2 + j])

    def _with(self, other: Any) -> Jet:
        if isinstance(other, Jet):
            return other
        return Jet(np.asarray(other, dtype=float), np.zeros_like(self.d), np.zeros_like(self.h))

    def chain(self, f: Array, f1: Any, f2: Any) -> Jet:
        """A function of it, from its value and derivatives."""
        i, j = _pairs(len(self.d))
        return Jet(f, f1 * self.d, f1 * self.h + f2 * self.d[i] * self.d[j])

    def __add__(self, other: Any) -> Jet:
        b = self._with(other)
        return Jet(self.v + b.v, self.d + b.d, self.h + b.h)

    def __neg__(self) -> Jet:
        return Jet(-self.v, -self.d, -self.h)

    def __sub__(self, other: Any) -> Jet:
        return self + -self._with(other)

    def __rsub__(self, other: Any) -> Jet:
        return self._with(other) - self

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Tensor):
            return NotImplemented
        b = self._with(other)
        i, j = _pairs(len(self.d))
        mixed = self.d[i] * b.d[j] + self.d[j] * b.d[i]
        return Jet(self.v * b.v, self.v * b.d + b.v * self.d, self.v * b.h + b.v * self.h + mixed)

    __radd__, __rmul__ = __add__, __mul__

    def __truediv__(self, other: Any) -> Jet:
        b = self._with(other)
        quotient: Jet = self * b.chain(1.0 / b.v, -1.0 / b.v**2, 2.0 / b.v**3)
        return quotient

    def __rtruediv__(self, other: Any) -> Jet:
        return self._with(other) / self

    def __pow__(self, n: Any) -> Jet:
        if isinstance(n, Jet):
            found: Jet = NAMES["exp"](n * NAMES["log"](self))
            return found
        first, second = (c * self.v ** (n - k) if c else 0.0 for k, c in ((1, n), (2, n * (n - 1))))
        return self.chain(self.v**n, first, second)

    def __rpow__(self, base: Any) -> Jet:
        found: Jet = self._with(base) ** self
        return found

    def __floordiv__(self, other: Any) -> Array:
        return np.asarray(self.v // _value(other))

    def __mod__(self, other: Any) -> Jet:
        return self - self._with((self // other) * other)

    def __lt__(self, other: Any) -> Any:
        return _truth(self.v < _value(other))

    def __le__(self, other: Any) -> Any:
        return _truth(self.v <= _value(other))

    def __gt__(self, other: Any) -> Any:
        return _truth(self.v > _value(other))

    def __ge__(self, other: Any) -> Any:
        return _truth(self.v >= _value(other))

    def __eq__(self, other: object) -> Any:
        return _truth(self.v == _value(other))

    def __ne__(self, other: object) -> Any:
        return _truth(self.v != _value(other))


class Tensor:
    """A vector or matrix of jets and numbers, as far as laws use them."""

    def __init__(self, entries: list[Any], shape: tuple[int, ...]) -> None:
        self.entries, self.shape = entries, shape

    def _each(self, function: Callable[..., Any], *others: Any) -> Tensor:
        parts = (o.entries if isinstance(o, Tensor) else [o] * len(self.entries) for o in others)
        return Tensor([function(*each) for each in zip(self.entries, *parts, strict=True)], self.shape)

    def __getitem__(self, at: Any) -> Any:
        return self.entries[at if isinstance(at, int) else at[0] * self.shape[1] + at[1]]

    def __add__(self, other: Any) -> Tensor:
        return self._each(operator.add, other)

    def __sub__(self, other: Any) -> Tensor:
        return self._each(operator.sub, other)

    def __neg__(self) -> Tensor:
        return self._each(operator.neg)

    def __mul__(self, other: Any) -> Tensor:
        return self._each(operator.mul, other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Tensor:
        return self._each(operator.truediv, other)

    def __matmul__(self, other: Tensor) -> Tensor:
        rows, columns = self.shape[0], self.shape[1]
        row = (Tensor(self.entries[columns * i : columns * (i + 1)], other.shape) for i in range(rows))
        return Tensor([r.dot(other) for r in row], other.shape)

    def dot(self, other: Tensor) -> Any:
        """Sum of the products of the entries."""
        return functools.reduce(operator.add, (self * other).entries)


class Vector(Tensor):
    """A vector that a law makes of numbers."""

    def __init__(self, entries: list[Any]) -> None:
        super().__init__(entries, (len(entries),))


def _value(x: Any) -> Any:
    return x.v if isinstance(x, Jet) else x


def _truth(found: Any) -> Any:
    return np.asarray(found).view(Truth)


def _select(which: Any, yes: Any, no: Any) -> Any:
    if not isinstance(yes, Jet) and not isinstance(no, Jet):
        return np.where(which, yes, no)
    some = yes if isinstance(yes, Jet) else no
    a, b = some._with(yes), some._with(no)
    return Jet(*(np.where(which, x, y) for x, y in ((a.v, b.v), (a.d, b.d), (a.h, b.h))))


def _least(a: Any, *more: Any) -> Any:
    for b in more:
        a = _select(_value(b) < _value(a), b, a)
    return a


def _most(a: Any, *more: Any) -> Any:
    for b in more:
        a = _select(_value(a) < _value(b), b, a)
    return a


def _of(function: Callable[[Any], tuple[Any, Any, Any]]) -> Callable[[Any], Any]:
    """A function of numbers and jets, from one of values to value and derivatives."""
    return lambda x: x.chain(*function(x.v)) if isinstance(x, Jet) else function(np.asarray(x, dtype=float))[0]


def _atan2(y: Any, x: Any) -> Any:
    """The angle of values, and that between them and jets: its derivatives are those of an arctangent at zero."""
    b, a = np.asarray(_value(y), dtype=float), np.asarray(_value(x), dtype=float)
    return np.arctan2(b, a) + NAMES["atan"]((y * a - x * b) / (x * a + y * b))


def _sqrt(x: Array) -> tuple[Array, Array, Array]:
    f = np.sqrt(x)
    slope = np.where(f > 0.0, 0.5, 0.0) / np.where(f > 0.0, f, 1.0)
    return f, slope, np.where(f > 0.0, -0.5 * slope / np.where(f > 0.0, x, 1.0), 0.0)


NAMES: dict[str, Any] = {
    "abs": _of(lambda x: (np.abs(x), np.where(x < 0.0, -1.0, 1.0), 0.0)),
    "sqrt": _of(_sqrt),
    "exp": _of(lambda x: (f := np.exp(x), f, f)),
    "expm1": _of(lambda x: (np.expm1(x), f := np.exp(x), f)),
    "log": _of(lambda x: (np.log(x), 1.0 / x, -1.0 / x**2)),
    "sin": _of(lambda x: (np.sin(x), np.cos(x), -np.sin(x))),
    "cos": _of(lambda x: (np.cos(x), -np.sin(x), -np.cos(x))),
    "tan": _of(lambda x: (f := np.tan(x), 1.0 + f * f, 2.0 * f * (1.0 + f * f))),
    "asin": _of(lambda x: (np.arcsin(x), r := 1.0 / np.sqrt(1.0 - x * x), x * r**3)),
    "acos": _of(lambda x: (np.arccos(x), r := -1.0 / np.sqrt(1.0 - x * x), x * r**3)),
    "atan": _of(lambda x: (np.arctan(x), r := 1.0 / (1.0 + x * x), -2.0 * x * r * r)),
    "atan2": _atan2,
    "floor": lambda x: np.floor(_value(x)),
    "ceil": lambda x: np.ceil(_value(x)),
    "tanh": _of(lambda x: (f := np.tanh(x), 1.0 - f * f, -2.0 * f * (1.0 - f * f))),
    "pow": lambda a, b: a**b,
    "min": _least,
    "max": _most,
    "select": _select,
    "float": lambda x: x,
    "int": lambda x: np.trunc(_value(x)).astype(int),
}
"""What functions of laws are called, as they are for jets; ``math`` and ``ti`` have them as well."""
NAMES["math"] = NAMES["ti"] = SimpleNamespace(**{**vars(math), **NAMES})
