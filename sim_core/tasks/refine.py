"""A rig on a finer mesh, to see what of a result is the mesh's."""

from __future__ import annotations

from typing import Any

from sim_core.rigs import Rig, Rigid


def refined(rig: Rig, finer: int) -> Rig:
    """The rig with so many cells in the place of each, along each axis, of sheets and gels, and with edges as much
    shorter of what is meshed by their length."""
    if finer == 1:
        return rig
    bodies: dict[str, Any] = {}
    for name, body in rig.bodies.items():
        if isinstance(body, Rigid):
            bodies[name] = body
            continue
        update: dict[str, Any] = {}
        shape: Any = body.shape
        if getattr(shape, "cells", None) is not None:
            update["shape"] = shape.model_copy(update={"cells": tuple(finer * count for count in shape.cells)})
        elif getattr(shape, "edge_m", None) is not None:
            update["shape"] = shape.model_copy(update={"edge_m": shape.edge_m / finer})
        if (edge := getattr(body, "edge_m", None)) is not None:
            update["edge_m"] = edge / finer
        bodies[name] = body.model_copy(update=update)
    return rig.model_copy(update={"bodies": bodies})
