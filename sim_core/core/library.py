"""The compiled core as Python sees it: its C functions, loaded once a process."""

from __future__ import annotations

import ctypes
import functools
import time
from dataclasses import dataclass
from typing import Any

from sim_core.core.build import BUILT, cache_folder, find_or_build
from sim_core.core.pardiso import pardiso_address
from sim_core.core.record_layout import COUNTS, RecordStruct
from sim_core.errors import ConfigError


class OutputsStruct(ctypes.Structure):
    """``Outputs`` of include/rollout.hpp."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("x", "force", "moment", "d_x", "d_force", "d_moment", "motion")]


@dataclass(frozen=True)
class Loaded:
    """The library; ``compile_s``: how long it took to have it [s]; ``supernodes``: whether it has a factor for wide
    meshes."""

    functions: Any
    compile_s: float
    supernodes: bool


@functools.cache
def load() -> Loaded:
    """Load the library, compiled first if need be. Raises ``ConfigError`` where it cannot be had."""
    begin = time.perf_counter()
    try:
        library = ctypes.CDLL(str(find_or_build((BUILT, cache_folder()))))
    except OSError as error:
        raise ConfigError(
            f"The compiled core, on which all rollouts run, is not there ({error}).",
            "Install a C++ compiler (g++, clang++, or set CXX), with which it is built at first use, or a wheel of the "
            "package, which holds it.",
        ) from error
    pointer, integer = ctypes.c_void_p, ctypes.c_int64
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "sizes": (integer, [integer]),
        "lanes": (integer, []),
        "make": (pointer, [pointer]),
        "free": (None, [pointer]),
        "pardiso": (None, [pointer]),
        "supernodes": (integer, [pointer]),
        "state": (pointer, [pointer, integer, ctypes.POINTER(integer)]),
        "held": (pointer, [pointer, integer, integer, ctypes.POINTER(integer)]),
        "material": (pointer, [pointer, integer, integer, ctypes.POINTER(integer)]),
        "past": (ctypes.c_double, [pointer]),
        "keep": (pointer, [pointer]),
        "put_back": (None, [pointer, pointer]),
        "drop": (None, [pointer]),
        "rest": (None, [pointer, integer]),
        "iterations": (None, [pointer, integer]),
        "resume": (None, [pointer, ctypes.c_double]),
        "hold_pairs": (None, [pointer, integer, integer]),
        "advance": (
            integer,
            [pointer, ctypes.c_double, pointer, pointer, pointer, integer, pointer, pointer, pointer],
        ),
        "look": (
            None,
            [pointer, ctypes.c_double, pointer, pointer, pointer, integer, integer, pointer, pointer, pointer, pointer],
        ),
        "end": (None, [pointer, ctypes.c_double, pointer, pointer, pointer, integer]),
        "blocks": (integer, [pointer, pointer, pointer, pointer]),
        "steps": (
            integer,
            [pointer, integer, pointer, pointer, pointer, integer, pointer, pointer, integer, pointer, pointer],
        ),
        "stand": (None, [pointer, ctypes.c_double, pointer, pointer, pointer, integer, pointer]),
        "step": (integer, [pointer, ctypes.c_double, pointer, pointer, pointer, integer, pointer, pointer]),
        "keep_forces": (None, [pointer]),
        "amend": (None, [pointer, pointer, integer]),
        "yield": (None, [pointer, integer, integer, pointer, integer, pointer]),
        "potential": (None, [pointer, ctypes.c_double, pointer, pointer, integer, integer, pointer, pointer, pointer]),
        "tape": (pointer, [pointer, integer]),
        "tape_free": (None, [pointer]),
        "tape_bytes": (integer, [pointer]),
        "tape_positions": (None, [pointer, integer, integer, pointer]),
        "adjoint": (pointer, [pointer]),
        "adjoint_free": (None, [pointer]),
        "adjoint_want": (None, [pointer, pointer, integer]),
        "adjoint_elements": (pointer, [pointer, integer, ctypes.POINTER(integer)]),
        "adjoint_weights": (pointer, [pointer, integer, ctypes.POINTER(integer)]),
        "adjoint_held": (pointer, [pointer, integer, integer, ctypes.POINTER(integer)]),
        "adjoint_material": (pointer, [pointer, integer, ctypes.POINTER(integer)]),
        "adjoint_begin": (None, [pointer, pointer]),
        "adjoint_sweep": (None, [pointer, pointer, integer, pointer, pointer, pointer, pointer]),
        "adjoint_stand": (
            None,
            [pointer] * 4 + [ctypes.c_double, pointer, integer] + [pointer] * 4,
        ),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, f"thinshell_{name}")
        function.restype, function.argtypes = result, arguments
    sizes = ctypes.sizeof(RecordStruct), COUNTS.itemsize
    if sizes != (library.thinshell_sizes(0), library.thinshell_sizes(1)):
        raise RuntimeError("the records of sim_core/core/library.py and include/record.hpp differ")
    function = pardiso_address()
    library.thinshell_pardiso(function)
    return Loaded(library, time.perf_counter() - begin, function is not None)
