"""Gel pads that are wider than a rig says.

Of a pad that is wide compared with what touches it, a rig has a piece, the sides of which are free. While a ball slides
on it, markers on a piece 3.2 times as wide as it is thick move by over a fifth more than those on a wide pad, for which
``tests/discretisation/test_gel_extent.py`` has the Fourier integral. A pad of ``DISCRETISATION.wide_pad_ratio`` times
its thickness is as good as an infinite one. Which of both the recordings follow they tell themselves, as of cells
(:mod:`sysid.discretisation.followed_model`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from sim_core.rigs import Gel, Rig
from sim_core.rigs.gel_shapes import Block, Grading
from sim_core.rigs.observers import MarkerSensor
from sim_core.rigs.points import marker_positions
from sysid.settings.discretisation import DISCRETISATION


@dataclass(frozen=True)
class Widened:
    """``rig``: with wide pads; ``notes``: what is wider than in the rig, in words."""

    rig: Rig
    notes: tuple[str, ...]


def widened(rig: Rig) -> Widened | None:
    """The rig with blocks of gel that are bonded by their bottom or top made wide; None where there are none, where
    clamps hold them, or where the places of their markers follow from their size, which is then known."""
    bodies, notes = {}, []
    for name, gel in rig.bodies.items():
        if not isinstance(gel, Gel) or not isinstance(gel.shape, Block) or gel.bonded not in ("bottom", "top"):
            continue
        shape = _wide(gel.shape)
        if shape is None or any(clamp.body == name for clamp in rig.clamps):
            continue
        wide = gel.model_copy(update={"shape": shape})
        if not _markers_stay(rig, name, gel, wide):
            continue
        bodies[name] = wide
        own, now = (" x ".join(f"{1e3 * s:.3g}" for s in b.size_m[:2]) for b in (gel.shape, shape))
        notes.append(
            f"The recordings are those of a wider pad than {name} is in the rig, {own} mm with free sides: it is taken "
            f"as {now} mm. If its sides are held or it goes on there, say so in the rig."
        )
    return Widened(rig.model_copy(update={"bodies": {**rig.bodies, **bodies}}), tuple(notes)) if bodies else None


def _wide(block: Block) -> Block | None:
    """The block as wide as ``DISCRETISATION.wide_pad_ratio`` times its thickness; None where it is, or has planes of
    symmetry or graded or refined cells."""
    reach = DISCRETISATION.wide_pad_ratio * block.size_m[2]
    if (
        block.symmetry
        or block.graded
        or block.refine
        or min(block.size_m[:2]) > DISCRETISATION.wide_enough_share * reach
    ):
        return None
    size, cells, graded = list(block.size_m), list(block.cells), []
    for axis, letter in enumerate("xy"):
        if block.size_m[axis] >= reach:
            continue
        size[axis], cells[axis] = reach, block.cells[axis] + DISCRETISATION.added_cells
        ratio = _grading(cells[axis], reach * block.cells[axis] / block.size_m[axis])
        if ratio < 1.0:
            graded.append(Grading(towards=f"{letter}_middle", ratio=ratio))
    return block.model_copy(update={"size_m": tuple(size), "cells": tuple(cells), "graded": tuple(graded)})


def _grading(count: int, length: float) -> float:
    """Ratio of the width of the cells in the middle to those at the ends, at which ``count`` of them make up a
    ``length`` in units of the middle one (:func:`sim_core.geometry.lattice.graded_lines`); at most 1."""
    away = np.abs((np.arange(count) + 0.5) / count - 0.5)
    share = (away - away.min()) / max(float(np.ptp(away)), 1e-300)
    if count >= length:
        return 1.0
    return float(1.0 / brentq(lambda wider: float(np.sum(wider**share)) - length, 1.0, 1e3))


def _markers_stay(rig: Rig, name: str, before: Gel, after: Gel) -> bool:
    """Whether what follows points of a body has them at the same places of a wider one."""
    points = [s.points for camera in rig.cameras.values() for s in camera.sees if s.body == name]
    points += [s.points for s in rig.sensors.values() if isinstance(s, MarkerSensor) and s.body == name]
    pairs = [(marker_positions(p, before)[0], marker_positions(p, after)[0]) for p in points]
    return all(a.shape == b.shape and np.allclose(a, b, atol=1e-12) for a, b in pairs)
