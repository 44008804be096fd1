"""The language of the laws, as plain Python.

Laws are functions in restricted Python that :mod:`sim_core.core.lowering` translates to C++. What they call beyond
Python's own operators stands here, so that the same text also runs as it is, on numpy's arrays: slowly, as the
reference that the translation is compared with. Vectors and matrices are values: a function gets a copy of what it is
given, but for arguments that are declared ``template()``, which it may write to.
"""

from __future__ import annotations

import builtins
import functools
import itertools
import operator
from collections.abc import Callable, Iterable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

f64: Any = float
i32: Any = int
F1: Any = "F1"
F2: Any = "F2"
F3: Any = "F3"
I1: Any = "I1"
I2: Any = "I2"
"""Arrays of numbers and of integers with one to three axes, as arguments of kernels."""


class _Template:
    """Declares an argument that is passed as it is."""


template: Any = _Template


class Mat(np.ndarray):
    """A small vector or matrix, whose sums are rounded in the order of the translated laws."""

    def dot(self, other: Mat) -> float:  # type: ignore[override]
        """Inner product."""
        return _sum(a * b for a, b in zip(self.flat, other.flat, strict=True))

    def __matmul__(self, other: Mat) -> Mat:  # type: ignore[override]
        columns = other.reshape(len(other), -1)
        rows = [[_sum(a * b for a, b in zip(row, column, strict=True)) for column in columns.T] for row in self]
        return np.array(rows).reshape(len(self), *other.shape[1:]).view(Mat)

    def norm_sqr(self) -> float:
        """Sum of the squares."""
        return _sum(a * a for a in self.flat)

    def norm(self) -> float:
        """Euclidean length."""
        return float(np.sqrt(self.norm_sqr()))

    def normalized(self) -> Mat:
        """Of unit length."""
        return (self / self.norm()).view(Mat)

    def cross(self, other: Mat) -> Mat:
        """Vector product."""
        return np.cross(self, other).view(Mat)

    def outer_product(self, other: Mat) -> Mat:
        """Dyadic product."""
        return np.outer(self, other).view(Mat)

    def determinant(self) -> float:
        """Of a square matrix."""
        return float(np.linalg.det(self))

    def inverse(self) -> Mat:
        """Of a square matrix."""
        return np.linalg.inv(self).view(Mat)


def _sum(terms: Iterable[float]) -> float:
    return functools.reduce(operator.add, terms)


def _vector(values: Sequence[Any]) -> Mat:
    """A vector of these numbers."""
    return np.array(values, dtype=float).view(Mat)


class Matrix:
    """Ways to make a matrix."""

    def __new__(cls, rows: Sequence[Sequence[Any]]) -> Mat:  # type: ignore[misc]
        return np.array(rows, dtype=float).view(Mat)

    @staticmethod
    def zero(_: type, *shape: int) -> Mat:
        """Of zeros."""
        return np.zeros(shape).view(Mat)

    @staticmethod
    def identity(_: type, size: int) -> Mat:
        """With ones on the diagonal."""
        return np.eye(size).view(Mat)

    @staticmethod
    def cols(columns: Sequence[Mat]) -> Mat:
        """With these columns."""
        return np.stack(columns, axis=1).view(Mat)


Vector: Any = _vector
Vector.zero = Matrix.zero


def _matrix(rows: int, columns: int, *numbers: Any) -> Mat:
    flat = [n for row in numbers for n in (row if isinstance(row, list) else [row])]
    return np.array(flat * (rows * columns if len(flat) == 1 else 1), dtype=float).reshape(rows, columns).view(Mat)


types: Any = SimpleNamespace(
    vector=lambda size, kind: lambda *numbers: _vector(numbers * (size if len(numbers) == 1 else 1)),
    matrix=lambda rows, columns, kind: functools.partial(_matrix, rows, columns),
)
"""Kinds of small vectors and matrices, to be made from their numbers row by row."""

vec3 = types.vector(3, f64)
mat3 = types.matrix(3, 3, f64)


def func(law: Callable[..., Any]) -> Callable[..., Any]:
    """Declares a law."""
    code = law.__code__
    passed = {name for name, kind in law.__annotations__.items() if isinstance(kind, _Template)}
    by_value = [name not in passed for name in code.co_varnames[: code.co_argcount]]

    @functools.wraps(law)
    def called(*arguments: Any) -> Any:
        copied = (a.copy() if value and isinstance(a, Mat) else a for a, value in zip(arguments, by_value, strict=True))
        return law(*copied)

    return called


def kernel(law: Callable[..., None]) -> Callable[..., None]:
    """Declares a law of whole arrays, into which it writes."""
    return law


def static(*values: Any) -> Any:
    """What is known when the law is translated."""
    return values[0] if len(values) == 1 else values


def ndrange(*ends: int) -> Iterable[Any]:
    """All combinations of integers below these."""
    return range(*ends) if len(ends) == 1 else itertools.product(*(range(n) for n in ends))


def loop_config(**_: Any) -> None:
    """Says how a loop may be run; means nothing here."""


def cast(value: Any, kind: type) -> Any:
    """A number of another kind."""
    return kind(value)


def select(which: Any, yes: Any, no: Any) -> Any:
    """One of two."""
    return yes if which else no


max: Any = builtins.max
min: Any = builtins.min
abs: Any = builtins.abs
sqrt, exp, log, sin, cos, tan = np.sqrt, np.exp, np.log, np.sin, np.cos, np.tan
tanh, asin, acos, atan2, floor, ceil = np.tanh, np.arcsin, np.arccos, np.arctan2, np.floor, np.ceil
