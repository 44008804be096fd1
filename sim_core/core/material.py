"""Material laws as formulas: energy and new internal variables of a point, with derivatives that nobody writes.

A law is a plain function in the language of :mod:`sim_core.core.lowering`. Of what a point sees in a step it takes what
it needs as arguments by these names, in any order: the strain ``e`` at its end and ``e_0`` at its start ``(k,)``, the
stiffness ``d`` of the body's own law ``(k, k)``, its length ``dt`` [s], and internal variables and parameters of the
effect by their own names. It returns the energy of the step per unit of area or volume, and after it the new internal
variables in their order. As with :class:`sim_core.core.pointwise.Law` it is compiled at its first use, and where there
is no compiler it runs in numpy, called back.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from sim_core.core.jets import Jet, Tensor, at_points
from sim_core.core.lowering import Library
from sim_core.core.pointwise import array_at, called_back, compiled, for_jets

__all__ = ["LANES", "MaterialFormula", "PointLayout"]

LANES = 8
"""Changes along which the compiled law is differentiated at once (``lanes`` of include/lanes.hpp)."""

ENTRY = """#define THINSHELL_ROLLED
#include "laws.hpp"
#include "material_point.hpp"
namespace thinshell {{
struct Point {{
  static constexpr int K = {size}, inputs = {inputs}, states = {states};
  using Number = {number};
  template <class D, class T> static void law(const D *e, const T *in, D *out) {{
    const auto found = {name}({arguments});
    {results}
  }}
  template <class R, class D, class T> static R energy(const D *e, const T *in) {{
    const auto found = {name}({arguments});
    return R({energy});
  }}
}};
}}
using P = thinshell::MaterialPoint<thinshell::Point>;
extern "C" void stress(long n, const double *in, double *out) {{ P::stress(n, in, out); }}
extern "C" void respond(long n, const double *in, double *out) {{ P::respond(n, in, out); }}
extern "C" void remember(long n, const double *in, double *out) {{ P::remember(n, in, out); }}
extern "C" void push_stress(long n, const double *in, const double *by, double *to) {{ P::push_stress(n, in, by, to); }}
extern "C" void push_memory(long n, const double *in, const double *by, double *to) {{ P::push_memory(n, in, by, to); }}
"""

FUNCTIONS = {"stress": 2, "respond": 2, "remember": 2, "push_stress": 3, "push_memory": 3}
"""Those of a compiled law, with how many tables of numbers they take."""


@dataclass(frozen=True)
class PointLayout:
    """What a law sees at a point as a row of numbers. ``size``: k; ``state``: names and shapes of the internal
    variables; ``numbers``: names of the parameters."""

    size: int
    state: tuple[tuple[str, tuple[int, ...]], ...]
    numbers: tuple[str, ...]

    @property
    def states(self) -> int:
        """Internal variables of a point, all numbers."""
        return sum(int(np.prod(shape)) for _, shape in self.state)

    @property
    def places(self) -> dict[str, tuple[int, tuple[int, ...]]]:
        """First number and shape of each argument."""
        k, at, found = self.size, 0, {}
        known = [("e", (k,)), ("e_0", (k,)), ("d", (k, k)), *self.state, ("dt", ())]
        for name, shape in (*known, *((n, ()) for n in self.numbers)):
            found[name] = at, shape
            at += int(np.prod(shape))
        return found

    @property
    def inputs(self) -> int:
        """Numbers of a row."""
        return 2 * self.size + self.size**2 + self.states + 1 + len(self.numbers)

    def rows(self, given: Mapping[str, Any], count: int) -> np.ndarray:
        """Rows ``(count, inputs)`` of arrays ``(count, *shape)``, or single numbers; what is not given is zero."""
        out = np.zeros((count, self.inputs))
        for name, (at, shape) in self.places.items():
            if name in given:
                value, size = np.asarray(given[name], dtype=float), int(np.prod(shape))
                if shape:
                    value = value.reshape(*value.shape[: value.ndim - len(shape)], size)
                out[..., at : at + size] = value if shape else value[..., None]
        return out


class MaterialFormula:
    """A material law, see the module. Raises :class:`sim_core.core.lowering.LoweringError` at its first use where it
    cannot be lowered or compiled."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        code = function.__code__
        self._arguments = code.co_varnames[: code.co_argcount]
        self._at = functools.cache(self._compile)

    def addresses(self, layout: PointLayout) -> list[int]:
        """Where its :data:`FUNCTIONS` of include/material_point.hpp are."""
        found = self._at(layout)
        return [ctypes.cast(getattr(found, name), ctypes.c_void_p).value or 0 for name in FUNCTIONS]

    def _compile(self, layout: PointLayout) -> Any:
        library = Library()
        law = library.law(self._function)
        places = layout.places
        arguments = []
        for name in self._arguments:
            at, shape = places[name]
            sizes = ", ".join(str(s) for s in shape)
            whole = "taken<D, {}>(e)" if name == "e" else f"taken<T, {{}}>(in + {at})"
            arguments.append(whole.format(sizes) if shape else f"in[{at}]")
        returned = [f"found.a{i}" for i in range(1 + len(layout.state))] if layout.state else ["found"]
        results = [f"give({part}, out);" for part in returned]
        main = ENTRY.format(
            size=layout.size,
            inputs=layout.inputs,
            states=layout.states,
            number="double" if law.branches else "thinshell::Pack",
            name=f"laws::{law.source.space}::{law.name}",
            arguments=", ".join(arguments),
            results=" ".join(results),
            energy=returned[0],
        )
        headers = ("small.hpp", "dual.hpp", "pack.hpp", "lanes.hpp", "material_point.hpp")
        loaded = compiled(law, library.text(), main, headers, "an energy, and the new internal variables after it")
        return self._by_numpy(layout) if loaded is None else loaded

    def _by_numpy(self, layout: PointLayout) -> SimpleNamespace:
        """The same functions in numpy."""
        k = layout.size
        parts = {"stress": slice(1 + k), "respond": slice(1 + k + k * k), "remember": slice(1 + k + k * k, None)}
        changing = {"push_stress": slice(k), "push_memory": slice(k, None)}

        def values(n: int, given: int, out: int, part: slice) -> None:
            rows = array_at(given, n, layout.inputs)
            found = self._in_numpy(layout, rows, np.zeros((1, *rows.shape)))[0][:, part]
            array_at(out, *found.shape)[:] = found

        def changes(n: int, given: int, by: int, out: int, part: slice) -> None:
            rows, moved = array_at(given, n, layout.inputs), array_at(by, n, layout.inputs, LANES)
            found = self._in_numpy(layout, rows, np.moveaxis(moved, -1, 0))[1][..., part]
            array_at(out, n, found.shape[-1], LANES)[:] = np.moveaxis(found, 0, -1)

        functions = {
            **{name: functools.partial(values, part=part) for name, part in parts.items()},
            **{name: functools.partial(changes, part=part) for name, part in changing.items()},
        }
        kinds = {name: [ctypes.c_long, *[ctypes.c_void_p] * count] for name, count in FUNCTIONS.items()}
        return SimpleNamespace(**{name: called_back(f, *kinds[name]) for name, f in functions.items()})

    def _in_numpy(self, layout: PointLayout, rows: np.ndarray, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What points respond ``(n, 1 + k + k^2 + states)``, and how stress and new internal variables change along
        ``changes`` ``(m, n, inputs)``."""
        count, n = changes.shape[:2]  # all at once: what it costs are calls
        each, by = np.tile(rows, (count, 1)), changes.reshape(count * n, -1)
        whole, pushed = at_points(lambda points: self._jets(layout, each[points], by[points]), count * n)
        return whole[:, :n].T, np.moveaxis(pushed.reshape(-1, count, n), 0, -1)

    def _jets(self, layout: PointLayout, rows: np.ndarray, change: np.ndarray) -> list[np.ndarray]:
        """What points respond, and how that changes ``(., n)``; directions of the jets: the strains, and the change."""
        k, n = layout.size, len(rows)
        units = np.zeros((layout.inputs, k + 1, n))
        units[np.arange(k), np.arange(k)] = 1.0
        units[:, k] = change.T
        none = np.zeros(((k + 1) * (k + 2) // 2, 1))
        jets = [Jet(v, d, none) for v, d in zip(rows.T, units, strict=True)]
        given = {}
        for name, (at, shape) in layout.places.items():
            given[name] = Tensor(jets[at : at + int(np.prod(shape))], shape) if shape else jets[at]
        found = for_jets(self._function)(*(given[name] for name in self._arguments))
        energy, *new = found if layout.state else (found,)
        energy = energy + 0.0 * jets[0]
        state = [z + 0.0 * jets[0] for part in new for z in (part.entries if isinstance(part, Tensor) else [part])]
        second = [energy.second(i, j) for i in range(k) for j in range(k)]
        whole = [energy.v, *energy.d[:k], *second, *(z.v for z in state)]
        pushed = [*(energy.second(k, i) for i in range(k)), *(z.d[k] for z in state)]
        return [np.stack([np.broadcast_to(p, (n,)) for p in part]) for part in (whole, pushed)]
