"""Laws of one's own: plain functions of numbers, with derivatives that nobody writes.

A law is a Python function of numbers in the language of :mod:`sim_core.core.lowering`. At its first use it is lowered
to C++, compiled, and kept in the user's cache under the hash of its text and of all that it calls; later processes load
it. Wheels hold the laws of the package's own effects (:mod:`sim_core.shipped_laws`). Where there is neither a library
nor a compiler the same function runs in numpy (:mod:`sim_core.core.jets`), called back by the core where that calls a
compiled one, and a warning says so.
"""

from __future__ import annotations

import ctypes
import functools
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from types import FunctionType
from typing import Any

import numpy as np

from sim_core.core.build import BUILT, HERE, LAWS_OF_EFFECTS, build, cache_folder, compiler, digest_of
from sim_core.core.jets import NAMES, Jet, at_points
from sim_core.core.lowering import Function, Library, LoweringError

__all__ = ["Law", "compiled", "for_jets"]

SECOND = "for (int i = 0; i < {count} * ({count} + 1) / 2; ++i) *(at += n) = f.h[i];"
ENTRY = """#include "laws.hpp"
extern "C" void evaluate(long n, double *x) {{
  using D = thinshell::{kind}<double, {count}>;
  for (long k = 0; k < n; ++k) {{
    const D f = thinshell::{name}({arguments});
    double *at = x + {count} * n + k;
    *at = f.v;
    for (int i = 0; i < {count}; ++i) *(at += n) = f.d[i];
    {second}
  }}
}}
"""


@functools.cache
def _warn_of_numpy() -> None:
    warnings.warn(
        "No C++ compiler was found: the laws of effects run in numpy, far more slowly. "
        "Install g++ or clang++, or set CXX.",
        stacklevel=5,
    )


class _Raised(threading.local):
    """What was raised on a thread."""

    def __init__(self) -> None:
        self.errors: list[BaseException] = []


_raised = _Raised()


def called_back(function: Callable[..., None], *arguments: Any) -> Any:
    """A C function of ``arguments`` that runs one of Python, for as long as it is kept. What that raises
    :func:`raise_what_was_raised` raises."""

    def run(*given: Any) -> None:
        try:
            function(*given)
        except BaseException as error:
            _raised.errors.append(error)

    return ctypes.CFUNCTYPE(None, *arguments)(run)


def raise_what_was_raised() -> None:
    """Raise the first error of a function that C has called back, if there was one."""
    if _raised.errors:
        first = _raised.errors[0]
        _raised.errors.clear()
        raise first


def array_at(address: int, *shape: int) -> np.ndarray:
    """The numbers in memory at an address."""
    return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_double)), shape)


def compiled(law: Function, laws: str, main: str, included: Sequence[str], returns: str) -> ctypes.CDLL | None:
    """The library of a ``law`` with the C++ source ``main``, which includes the header of ``laws`` and those
    ``included``: the one of the package or of the cache if it was compiled before. ``returns``: what the law is to
    return. None where there is none and no compiler; the first time a warning says so."""
    headers = [(HERE / "include" / h).read_text() for h in included]
    name = f"{law.source.space}_{law.name}_{digest_of(*headers, laws, main)}.so"
    folders = [folder / LAWS_OF_EFFECTS for folder in (BUILT, cache_folder())]
    path = next((folder / name for folder in folders if (folder / name).exists()), None)
    if path is None and compiler() is None:
        _warn_of_numpy()
        return None
    try:
        return ctypes.CDLL(str(path or build(folders[-1] / name, laws, main)))
    except OSError as error:
        raise LoweringError(
            f"The law {law.name} of {law.source.path} could not be compiled: {error}.",
            f"Have it return {returns}; if it does, remove {(path or folders[-1] / name).parent} and try again.",
        ) from error


class Law:
    """A law y = f(x_1, ..., x_k), called with numbers or arrays ``(n,)``, of which the first is one, for its
    :class:`Jet`: values and the derivatives by all arguments. ``order``: 2, or 1 for the first derivatives alone.

    Raises :class:`LoweringError` at its first use where it cannot be lowered or compiled.
    """

    def __init__(self, function: Callable[..., float], order: int = 2) -> None:
        self._function, self._order = function, order
        code = function.__code__
        self.arguments = code.co_varnames[: code.co_argcount]
        """Names of the arguments."""

    def __call__(self, *arguments: Any) -> Jet:
        k, n = len(self.arguments), len(arguments[0])
        rows = np.empty((2 * k + 1 + (k * (k + 1) // 2 if self._order == 2 else 0), n))
        for i, argument in enumerate(arguments):
            rows[i] = argument
        self._evaluate(n, rows.ctypes.data)
        raise_what_was_raised()
        return Jet(rows[k], rows[k + 1 : 2 * k + 1], rows[2 * k + 1 :])

    def at(self, values: Mapping[str, float], *arguments: np.ndarray) -> Jet:
        """The law at its first arguments, the rest taken from ``values`` by their names."""
        return self(*arguments, *(values[name] for name in self.arguments[len(arguments) :]))

    @property
    def address(self) -> int:
        """Where its function is: ``evaluate(n, x)`` of k + 1 + k rows of ``n`` numbers, and k (k + 1) / 2 more of
        second order: arguments, value, derivatives."""
        return ctypes.cast(self._evaluate, ctypes.c_void_p).value or 0

    @functools.cached_property
    def _evaluate(self) -> Any:
        """``evaluate`` of its library, or one that runs in numpy where there is none."""
        library = Library()
        law = library.law(self._function)
        count = len(self.arguments)
        inputs = ", ".join(f"D::variable(x[{i} * n + k], {i})" for i in range(count))
        name = f"laws::{law.source.space}::{law.name}"
        kind, second = ("Dual2", SECOND.format(count=count)) if self._order == 2 else ("Dual", "")
        laws = library.text()
        main = ENTRY.format(name=name, count=count, arguments=inputs, kind=kind, second=second)
        loaded = compiled(law, laws, main, ("small.hpp", "dual.hpp"), "one number")
        if loaded is None:
            return called_back(self._in_numpy, ctypes.c_long, ctypes.c_void_p)
        evaluate = loaded.evaluate
        evaluate.argtypes, evaluate.restype = (ctypes.c_long, ctypes.c_void_p), None
        return evaluate

    def _in_numpy(self, n: int, address: int) -> None:
        """As the compiled function."""
        k = len(self.arguments)
        rows = array_at(address, 2 * k + 1 + (k * (k + 1) // 2 if self._order == 2 else 0), n)
        v, d, h = at_points(lambda points: self._jet(rows[:k, points]).parts, n)
        rows[k], rows[k + 1 : 2 * k + 1] = v, d
        if self._order == 2:
            rows[2 * k + 1 :] = h

    def _jet(self, x: np.ndarray) -> Jet:
        k, n = x.shape
        variables = Jet.variables(x)
        found = for_jets(self._function)(*variables) + 0.0 * variables[0]  # a jet even if it is a number
        sizes = {"v": (n,), "d": (k, n), "h": (k * (k + 1) // 2, n)}
        return Jet(*(np.broadcast_to(getattr(found, part), size) for part, size in sizes.items()))


@functools.cache
def for_jets(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, and the plain functions that it calls, with functions of jets in place of those of numbers."""
    known = dict(function.__globals__)
    for name in function.__code__.co_names:
        called = known.get(name)
        if isinstance(called, FunctionType) and called is not function:
            known[name] = for_jets(getattr(called, "__wrapped__", called))
    return FunctionType(function.__code__, {**known, **NAMES})
