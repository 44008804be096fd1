"""What the angles of hinges make of the curvatures of all triangles that bend, for derivatives on the way back."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sim_core.core.gradings import start_of
from sim_core.core.layout import layout_of
from sim_core.core.materials import bent_by_laws
from sim_core.core.record_layout import pointer_to
from sim_core.energies.bending import Bending
from sim_core.scene.scene import Scene


class CurvingStruct(ctypes.Structure):
    """``Curving`` of include/contact_pull.hpp."""

    _fields_ = [
        ("triangles", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("start", "hinge", "weight", "graded", "bent")),
    ]


@dataclass(frozen=True)
class Curving:
    """``pairs``: triangles and hinges, both of all sheets, ``(2, k)`` int, sorted; ``weight``: what the angle makes of
    the curvature ``(k, 3)``; ``start``: where a triangle's pairs begin; ``graded``, ``bent``: the triangles' numbers
    among those that change in time and those that bend by laws, -1: none; ``own``: by the names of the terms, their
    triangles and their pairs."""

    pairs: np.ndarray
    weight: np.ndarray
    start: np.ndarray
    graded: np.ndarray
    bent: np.ndarray
    own: Mapping[str, tuple[slice, slice]]

    def struct(self) -> tuple[CurvingStruct, list[np.ndarray]]:
        """For the core, with the arrays that it points to."""
        whole = (self.start, self.pairs[1], self.graded, self.bent)
        start, hinge, graded, bent = (np.ascontiguousarray(a, dtype=np.int32) for a in whole)
        kept = [start, hinge, np.ascontiguousarray(self.weight), graded, bent]
        return CurvingStruct(len(graded), *(pointer_to(a) for a in kept)), kept


def curving_of(scene: Scene, pairs: Mapping[str, np.ndarray]) -> Curving:
    """Of all sheets of a scene. ``pairs``: by the name of a term, its triangles and hinges ``(2, k)`` where others are
    wanted in addition to those on which its curvatures depend."""
    layout, bent = layout_of(scene), bent_by_laws(scene)
    found, weights, graded, laws = [np.empty((2, 0), dtype=int)], [np.empty((0, 3))], [], []
    own: dict[str, tuple[slice, slice]] = {}
    triangle = hinge = 0
    for term in layout.bendings:
        mine, count = pairs.get(term.name, _seen(term)), len(term.sizes)
        weights.append(
            np.stack([np.asarray(term.operator[3 * mine[0] + k, mine[1]]).ravel() for k in range(3)], axis=-1)
        )
        first = sum(len(a) for a in weights[:-1])
        own[term.name] = slice(triangle, triangle + count), slice(first, first + mine.shape[1])
        found.append(mine + [[triangle], [hinge]])
        graded.append(_numbered(start_of(layout, term), count))
        laws.append(_numbered(next((k for t, k in bent if t is term), None), count))
        triangle, hinge = triangle + count, hinge + len(term.hinge_nodes)
    both = np.concatenate(found, axis=1)
    start = np.searchsorted(both[0], np.arange(triangle + 1))
    none = [np.empty(0, dtype=int)]
    return Curving(
        both, np.concatenate(weights), start, np.concatenate(none + graded), np.concatenate(none + laws), own
    )


def _seen(term: Bending) -> np.ndarray:
    """Triangles and hinges on which the curvatures of a term depend ``(2, k)``."""
    around = sp.csr_matrix(sum(abs(term.operator[k::3]) for k in range(3)))
    around.sort_indices()
    return np.stack([np.repeat(np.arange(around.shape[0]), np.diff(around.indptr)), around.indices])


def _numbered(first: int | None, count: int) -> np.ndarray:
    return np.full(count, -1) if first is None else first + np.arange(count)
