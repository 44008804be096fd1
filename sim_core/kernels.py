"""The thin layer between the physics and Taichi: start-up, and launches that cost microseconds.

All kernels are written for ``ti.types.ndarray`` arguments and run serially on one core (one process
a core is the parallelism, see README), so results do not depend on the number of threads.

A plain Taichi call inspects every argument and costs 100 to 300 us for the small arrays used here;
:class:`BoundKernel` prepares the launch at the first call, once for a fixed set of arrays, and
repeats it in about 3 us.
"""

import ast
import contextlib
import functools
import io
from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti
from taichi.lang import impl, kernel_impl
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext

F1 = ti.types.ndarray(dtype=ti.f64, ndim=1)
F2 = ti.types.ndarray(dtype=ti.f64, ndim=2)
F3 = ti.types.ndarray(dtype=ti.f64, ndim=3)
I1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
I2 = ti.types.ndarray(dtype=ti.i32, ndim=2)

vec3 = ti.types.vector(3, ti.f64)
mat3 = ti.types.matrix(3, 3, ti.f64)


@ti.func
def row(values: ti.template(), i: ti.i32):
    """Row of an array ``(n, 3)`` as a vector."""
    return vec3(values[i, 0], values[i, 1], values[i, 2])


@ti.func
def times3(c: ti.template(), e: ti.i32, v):
    """Product of matrix ``e`` of an array ``(n, 3, 3)`` with a vector."""
    out = vec3(0.0, 0.0, 0.0)
    for i in ti.static(range(3)):
        out[i] = c[e, i, 0] * v[0] + c[e, i, 1] * v[1] + c[e, i, 2] * v[2]
    return out


@ti.func
def add_block(start: ti.template(), column: ti.template(), place: ti.template(), out: ti.template(), i, j, m):
    """Add the 3 x 3 block d2E/dx_i dx_j, listed once for i != j, to the Hessian's values at pair (i, j)."""
    low = ti.min(i, j)
    high = ti.max(i, j)
    left = start[low]
    right = start[low + 1] - 1
    while left < right:
        middle = (left + right) // 2
        if column[middle] < high:
            left = middle + 1
        else:
            right = middle
    if column[left] == high:
        base = 9 * place[left]
        for a in range(3):
            for b in range(3):
                if i < j:
                    out[base + 3 * a + b] = out[base + 3 * a + b] + m[a, b]
                elif i > j:
                    out[base + 3 * b + a] = out[base + 3 * b + a] + m[a, b]
                elif a <= b:
                    out[base + 3 * a + b] = out[base + 3 * a + b] + m[a, b]


def _place(context: Any, node: ast.stmt | ast.expr) -> str:
    """Where a node of a kernel stands, for Taichi's messages: file, line and the line's text."""
    line, name = node.lineno + context.lineno_offset, context.func.func.__name__
    return f'File "{context.file}", line {line}, in {name}:\n{context.src[node.lineno - 1].strip()}\n'


def start() -> None:
    """Start Taichi on the CPU in double precision, once a process. Further calls do nothing.

    Most of the time in which a process builds its first scene Taichi 1.7 would spend on the text of its messages (it
    wraps and underlines the source of every node of every kernel) and on looking up, for every call in a kernel, the
    source of what is called. :func:`_place` is brief, and sources are looked up once.
    """
    if impl.get_runtime().prog is None:
        ASTTransformerContext.get_pos_info = _place
        kernel_impl.getsourcelines = functools.cache(kernel_impl.getsourcelines)
        kernel_impl.getsourcefile = functools.cache(kernel_impl.getsourcefile)
        with contextlib.redirect_stdout(io.StringIO()):  # it prints a greeting
            ti.init(
                arch=ti.cpu,
                default_fp=ti.f64,
                default_ip=ti.i32,
                cpu_max_num_threads=1,
                offline_cache=True,
                fast_math=False,
                log_level=ti.ERROR,
                verbose=False,
            )


class BoundKernel:
    """A Taichi kernel together with the arrays that it will always be run on.

    The arrays are read and written in place, so their contents may change between calls but the
    arrays themselves may not be replaced. All must be C-contiguous ``float64`` or ``int32``.

    The kernel is compiled when it is first called. Taichi walks through its source in every process, even if
    its machine code is in the cache, and many kernels of a scene (exact Hessians, contact of edges) are not used by
    every run.
    """

    def __init__(self, kernel: Callable[..., None], *arrays: np.ndarray) -> None:
        for array in arrays:
            if not array.flags.c_contiguous or array.dtype not in (np.float64, np.int32):
                raise TypeError(f"kernel arrays must be contiguous float64 or int32, got {array.dtype}")
        self._kernel, self._arrays = kernel, arrays
        self._launch: Callable[[Any, Any], None] | None = None

    def _prepare(self) -> None:
        start()
        primal: Any = self._kernel._primal  # type: ignore[attr-defined]
        program = impl.get_runtime().prog
        compiled = primal.compiled_kernels[primal.ensure_compiled(*self._arrays)]
        self._context = compiled.make_launch_context()
        for index, array in enumerate(self._arrays):
            self._context.set_arg_external_array_with_shape(
                (index,), int(array.ctypes.data), array.nbytes, array.shape, 0
            )
        self._compiled = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
        self._launch = program.launch_kernel

    def __call__(self) -> None:
        if self._launch is None:
            self._prepare()
        self._launch(self._compiled, self._context)  # type: ignore[misc]
