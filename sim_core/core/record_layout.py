"""The record of a rollout as C sees it (include/record.hpp): fields, their order and types. Imports nothing of the
project."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

SIZES = ("nodes", "triangles", "hinges", "couplings", "tetrahedra", "contacts", "samples", "corners", "mounts",
          "followers", "bearing", "columns", "bodies", "embedded", "surfaces", "surface_corners", "edge_pairs",
          "material_laws", "bent", "drags", "loads", "graded", "shared", "guides", "yielding",
          "couples")  # fmt: skip
ARRAYS = (
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
    ("added_start", np.int32), ("bond_reach", np.float64), ("added_kind", np.int32), ("added_function", np.int64),
    ("added_number_start", np.int32), ("added_number", np.float64),
    ("material_kind", np.int32), ("material_inputs", np.int32), ("material_states", np.int32),
    ("material_function", np.int64), ("material_start", np.int32), ("material_row_start", np.int32),
    ("material_element", np.int32), ("material_area", np.float64), ("material_row", np.float64),
    ("bent_start", np.int32), ("bent_hinge", np.int32), ("bent_weight", np.float64),
    ("graded_kind", np.int32), ("graded_first", np.int32), ("graded_start", np.int32), ("graded_place", np.float64),
    ("graded_map_start", np.int32), ("graded_function", np.int64), ("graded_number_start", np.int32),
    ("graded_number", np.float64), ("material_graded", np.int32),
    ("shared_element", np.int32), ("shared_coupling", np.int32), ("shared_stiffness", np.float64),
    ("shared_damping", np.float64),
    ("drag_triangle", np.int32), ("drag_factor", np.float64),
    ("load_table_start", np.int32), ("load_time", np.float64), ("load_value", np.float64),
    ("load_number", np.float64), ("dead_start", np.int32), ("dead_node", np.int32), ("dead_weight", np.float64),
    ("face_start", np.int32), ("face_node", np.int32),
    ("rule_weight", np.float64), ("rule_shape", np.float64), ("rule_slope", np.float64),
    ("body_control", np.int32), ("body_slope", np.float64), ("body_stiffness", np.float64),
    ("embedded_node", np.int32), ("embedded_start", np.int32), ("embedded_in", np.int32),
    ("embedded_weight", np.float64),
    ("guide_node", np.int32), ("guide_weight", np.float64), ("guide_stiffness", np.float64),
    ("couple_node", np.int32), ("couple_axis", np.float64), ("couple_moment", np.float64),
    ("yield_of", np.int32), ("yield_spring", np.float64),
    ("follower_node", np.int32), ("follower_mount", np.int32), ("follower_axes", np.uint8),
    ("follower_local", np.float64), ("bearing_node", np.int32),
)  # fmt: skip
SEARCH = (("step_tolerance", ctypes.c_double), ("force_tolerance", ctypes.c_double),
           ("fast_iterations", ctypes.c_int64), ("slow_iterations", ctypes.c_int64),
           ("second_order", ctypes.c_int64))  # fmt: skip
BLOCKS = ("stretch_blocks", "bend_blocks", "gel_blocks", "mass_blocks")
SLOPES = (
    ("stretch_of", np.int32), ("bend_of", np.int32), ("gel_of", np.int32), ("mass_of", np.int32),
    ("d_stretch_stiffness", np.float64), ("d_stretch_damping", np.float64),
    ("d_bend_stiffness", np.float64), ("d_bend_damping", np.float64),
    ("d_gel", np.float64), ("d_mass", np.float64), ("d_mass_damping", np.float64),
    ("d_external", np.float64), ("d_law", np.float64), ("d_surface_law", np.float64), ("d_edge_law", np.float64),
    ("d_added_number", np.float64),
    ("d_drag_factor", np.float64), ("d_load_number", np.float64),
    ("material_block_start", np.int32), ("material_of", np.int32), ("material_block_row", np.int32),
    ("d_material_row", np.float64), ("d_yield_spring", np.float64), ("d_graded_number", np.float64),
    ("d_shared_stiffness", np.float64), ("d_shared_damping", np.float64),
)  # fmt: skip


MODULATED = (("modulated_from", np.int32), ("modulated_to", np.int32))


class RecordStruct(ctypes.Structure):
    """``Record`` of include/record.hpp."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in SIZES),
        *((name, ctypes.c_void_p) for name, _ in ARRAYS),
        *SEARCH,
        *((name, ctypes.c_int64) for name in BLOCKS),
        *((name, ctypes.c_void_p) for name, _ in SLOPES),
        ("modulations", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name, _ in MODULATED),
    ]


_COUNTED = ("iterations", "factorisations", "tries", "residuals", "contacts", "tightest", "parts", "made", "failure")
COUNTS = np.dtype(
    [(name, np.int64) for name in _COUNTED] + [(name, np.float64) for name in ("residual", "update", "gap")]
)
"""``StepCounts`` of include/record.hpp."""


def pointer_to(array: np.ndarray) -> int:
    """Address of a contiguous array."""
    if not array.flags.c_contiguous:
        raise TypeError("arrays of the core are contiguous")
    return int(array.ctypes.data)


def filled(values: dict[str, Any]) -> tuple[RecordStruct, dict[str, np.ndarray]]:
    """The record, and the arrays that it points to, by name, which have to be kept for as long."""
    record, kept = RecordStruct(), {}
    for name in (*SIZES, *(n for n, _ in SEARCH), *BLOCKS, "modulations"):
        setattr(record, name, values.pop(name))
    for name, kind in (*ARRAYS, *SLOPES, *MODULATED):
        array = np.array(values.pop(name), dtype=kind, order="C")  # a copy: terms of a scene may be configured anew
        kept[name] = array
        setattr(record, name, pointer_to(array))
    if values:
        raise TypeError(f"the record of the core has no {', '.join(values)}")
    return record, kept
