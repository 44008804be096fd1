"""Run kernels as Python and by the lowered header, on the same random arrays."""

import ast
import ctypes
import importlib
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.core.build import HERE, compiler
from sim_core.core.law_sources import decorators
from sim_core.core.lowering import Library

ROWS = 4
"""Rows that every array says that it has. It has many more, as neither side checks bounds and integers are random."""
SPARE = {"F1": (4096,), "F2": (64, 512), "F3": (64, 32, 48), "I1": (4096,), "I2": (64, 512)}
NARROW = {"nodes": 4, "weights": 4}
"""Columns of arrays over whose second axis kernels loop."""
FLAGS = {"exact", "foreseen"}


class Declared:
    """An array that says that it has few rows."""

    def __init__(self, values: np.ndarray) -> None:
        self._values, self.shape = values, (ROWS, *values.shape[1:])

    def __getitem__(self, at: int | tuple[int, ...]) -> Any:
        return self._values[at]

    def __setitem__(self, at: int | tuple[int, ...], value: float) -> None:
        self._values[at] = value


class Kernels:
    """Kernels of one module: as Python and as C++."""

    def __init__(self, folder: Path, module: str, path: Path | None = None) -> None:
        library = Library()
        source = library.source(module, path)
        assert source is not None
        self._module = importlib.import_module(module)
        self._kinds: dict[str, dict[str, str]] = {}
        entries = []
        for name in source.laws:
            node = source.functions[name]
            if "lang.kernel" in decorators(node):
                library.need(source, node)
                self._kinds[name] = {a.arg: ast.unparse(a.annotation) for a in node.args.args if a.annotation}
                entries.append(self._entry(source.space, name))
        (folder / "laws.hpp").write_text(library.text())
        (folder / "kernels.cpp").write_text('#include "laws.hpp"\nusing namespace thinshell;\n' + "".join(entries))
        # Without fused multiply-add, as Python computes: or what is exactly zero in one is not in the other.
        flags = ["-std=c++17", "-O1", "-ffp-contract=off", "-shared", "-fPIC", f"-I{HERE / 'include'}", f"-I{folder}"]
        target = folder / "kernels.so"
        subprocess.run([str(compiler()), *flags, str(folder / "kernels.cpp"), "-o", str(target)], check=True)
        self._compiled = ctypes.CDLL(str(target))

    @property
    def names(self) -> list[str]:
        return list(self._kinds)

    def _entry(self, space: str, name: str) -> str:
        """A C function of pointers to the arrays and of their sizes, one after the other."""
        views, at = [], 0
        for n, kind in enumerate(self._kinds[name].values()):
            number, axes = "double" if kind[0] == "F" else "int", int(kind[1])
            sizes = ", ".join(f"s[{at + i}]" for i in range(axes))
            views.append(f"View<{number}, {axes}>(static_cast<{number} *>(p[{n}]), {sizes})")
            at += axes
        call = f"laws::{space}::{name}({', '.join(views)});"
        return f'extern "C" void run_{name}(void **p, const long *s) {{\n  {call}\n}}\n'

    def arrays(self, name: str, random: np.random.Generator) -> list[np.ndarray]:
        """Arguments of a kernel: numbers of both signs, integers that are rows of any array."""
        return [self._array(argument, kind, random) for argument, kind in self._kinds[name].items()]

    def _array(self, name: str, kind: str, random: np.random.Generator) -> np.ndarray:
        size = SPARE[kind]
        if name in NARROW and len(size) == 2:
            size = (size[0], NARROW[name])
        if kind == "I1":
            return random.integers(0, 2 if name in FLAGS else ROWS, size).astype(np.int32)
        if kind == "I2":  # the corners of a triangle are not one node
            orders = np.argsort(random.uniform(size=(size[0], ROWS)), axis=1)
            return np.tile(orders, size[1] // ROWS).astype(np.int32)
        out = random.uniform(0.1, 1.1, size)
        if kind == "F2" or name == "deformation":
            out *= random.choice([1.0, 1.0, -1.0], size)
        if name == "shape":
            out[0] = random.integers(0, 4)
        return np.asarray(out)

    def by_python(self, name: str, arrays: list[np.ndarray]) -> None:
        kernel: Callable[..., None] = getattr(self._module, name)
        kernel(*(Declared(a) for a in arrays))

    def by_header(self, name: str, arrays: list[np.ndarray]) -> None:
        pointers = (ctypes.c_void_p * len(arrays))(*(a.ctypes.data for a in arrays))
        sizes = [n for a in arrays for n in (ROWS, *a.shape[1:])]
        getattr(self._compiled, f"run_{name}")(pointers, (ctypes.c_long * len(sizes))(*sizes))
