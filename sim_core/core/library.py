"""The compiled core as Python sees it: its C functions, loaded once a process."""

from __future__ import annotations

import ctypes
import functools
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.core.build import cache_folder, find_or_build
from sim_core.solve.factor import pardiso_address

BUILT = Path(__file__).resolve().parent / "built"
"""Where the library is when it was compiled with the package."""

_SIZES = ("nodes", "triangles", "hinges", "couplings", "tetrahedra", "contacts", "samples", "corners",
          "mounts", "followers", "bearing", "columns", "surfaces", "surface_corners", "edge_pairs")  # fmt: skip
_ARRAYS = (
    ("prescribed", np.uint8), ("rank", np.int32), ("rest", np.float64), ("external", np.float64),
    ("mass_start", np.int32), ("mass_column", np.int32), ("mass", np.float64), ("mass_damping", np.float64),
    ("triangle", np.int32), ("hats", np.float64), ("stretch_stiffness", np.float64), ("stretch_damping", np.float64),
    ("hinge", np.int32), ("rest_angle", np.float64), ("coupling_start", np.int32), ("coupling_column", np.int32),
    ("bend_stiffness", np.float64), ("bend_damping", np.float64),
    ("tetrahedron", np.int32), ("gel_gradient", np.float64), ("gel_volume", np.float64), ("gel_number", np.float64),
    ("sample_start", np.int32), ("body_node", np.int32), ("body_mount", np.int32), ("body_rotation", np.float64),
    ("law", np.float64), ("shape", np.float64), ("sample_node", np.int32), ("sample_weight", np.float64),
    ("sample_area", np.float64),
    ("surface_sample_start", np.int32), ("surface_triangle_start", np.int32), ("surface_margin", np.float64),
    ("surface_law", np.float64), ("surface_node", np.int32), ("surface_used", np.int32),
    ("surface_weight", np.float64), ("surface_area", np.float64),
    ("surface_triangle", np.int32), ("surface_border", np.int32),
    ("edge_start", np.int32), ("edge_once", np.int32), ("edge_margin", np.float64), ("edge_law", np.float64),
    ("edge_node", np.int32), ("edge_area", np.float64), ("edge_square", np.float64),
    ("follower_node", np.int32), ("follower_mount", np.int32), ("follower_axes", np.uint8),
    ("follower_local", np.float64), ("bearing_node", np.int32),
)  # fmt: skip
_SEARCH = (("step_tolerance", ctypes.c_double), ("force_tolerance", ctypes.c_double),
           ("fast_iterations", ctypes.c_int64), ("second_order", ctypes.c_int64))  # fmt: skip
_BLOCKS = ("stretch_blocks", "bend_blocks", "gel_blocks", "mass_blocks")
_SLOPES = (
    ("stretch_of", np.int32), ("bend_of", np.int32), ("gel_of", np.int32), ("mass_of", np.int32),
    ("d_stretch_stiffness", np.float64), ("d_stretch_damping", np.float64),
    ("d_bend_stiffness", np.float64), ("d_bend_damping", np.float64),
    ("d_gel", np.float64), ("d_mass", np.float64), ("d_mass_damping", np.float64),
    ("d_external", np.float64), ("d_law", np.float64), ("d_surface_law", np.float64), ("d_edge_law", np.float64),
)  # fmt: skip


class RecordStruct(ctypes.Structure):
    """``Record`` of include/record.hpp."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in _SIZES),
        *((name, ctypes.c_void_p) for name, _ in _ARRAYS),
        *_SEARCH,
        *((name, ctypes.c_int64) for name in _BLOCKS),
        *((name, ctypes.c_void_p) for name, _ in _SLOPES),
    ]


COUNTS = np.dtype(
    [(name, np.int64) for name in ("iterations", "factorisations", "tries", "residuals", "contacts", "tightest")]
    + [(name, np.float64) for name in ("residual", "update", "gap")]
)
"""``StepCounts`` of include/record.hpp."""


class OutputsStruct(ctypes.Structure):
    """``Outputs`` of include/rollout.hpp."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("x", "force", "moment", "d_x", "d_force", "d_moment")]


@dataclass(frozen=True)
class Loaded:
    """The library, or the ``lack`` of it in a sentence; ``compile_s``: how long it took to have it [s]; ``supernodes``:
    whether it has a factor for wide meshes."""

    functions: Any
    lack: str
    compile_s: float
    supernodes: bool = False


@functools.cache
def load() -> Loaded:
    """Load the library, compiled first if need be. Where it cannot be had a warning says so, once a process."""
    begin = time.perf_counter()
    try:
        library = ctypes.CDLL(str(find_or_build((BUILT, cache_folder()))))
    except OSError as error:
        lack = f"The compiled core is not there ({error})."
        warnings.warn(f"{lack} Until it is, rollouts are launched from Python, 10 to 20 times as slowly.", stacklevel=2)
        return Loaded(None, lack, time.perf_counter() - begin)
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
        "past": (ctypes.c_double, [pointer]),
        "rest": (None, [pointer, integer]),
        "steps": (integer, [pointer, integer, pointer, pointer, pointer, integer, pointer, integer, pointer, pointer]),
        "potential": (None, [pointer, ctypes.c_double, pointer, pointer, integer, integer, pointer, pointer, pointer]),
        "accept": (None, [pointer, ctypes.c_double, pointer, pointer, pointer, integer, pointer]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, f"thinshell_{name}")
        function.restype, function.argtypes = result, arguments
    sizes = ctypes.sizeof(RecordStruct), COUNTS.itemsize
    if sizes != (library.thinshell_sizes(0), library.thinshell_sizes(1)):
        raise RuntimeError("the records of sim_core/core/library.py and include/record.hpp differ")
    function = pardiso_address()
    library.thinshell_pardiso(function)
    return Loaded(library, "", time.perf_counter() - begin, function is not None)


def pointer_to(array: np.ndarray) -> int:
    """Address of a contiguous array."""
    if not array.flags.c_contiguous:
        raise TypeError("arrays of the core are contiguous")
    return int(array.ctypes.data)


def filled(values: dict[str, Any]) -> tuple[RecordStruct, list[np.ndarray]]:
    """The record, and the arrays that it points to, which have to be kept for as long."""
    record, kept = RecordStruct(), []
    for name in (*_SIZES, *(n for n, _ in _SEARCH), *_BLOCKS):
        setattr(record, name, values.pop(name))
    for name, kind in (*_ARRAYS, *_SLOPES):
        array = np.ascontiguousarray(values.pop(name), dtype=kind)
        kept.append(array)
        setattr(record, name, pointer_to(array))
    if values:
        raise TypeError(f"the record of the core has no {', '.join(values)}")
    return record, kept
