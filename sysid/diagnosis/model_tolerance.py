"""How well two careful simulations of one experiment agree: what a model may be off without anything being missing.

Two codes that solve the same problem (finite or small strain, a pad or a half space, a shell or a rod) differ by a
percent or so of the deformation, on recordings that conceal nothing. That is no noise: it is smooth in time, common to
neighbouring markers, and with thousands of samples any test finds it. It is therefore carried as one more error shape
of unknown size (:mod:`sysid.solve.discretisation_basis`), as wide as a share of the signal that the deformation makes:

- of a wrench ``DIAGNOSIS.model_tolerance`` of its change since the start;
- of markers the same share of what is left when the picture is shifted, turned and scaled back to the first one, since
  rigid motion is not what simulations differ in;
- of markers on a gel, seen from what the gel is fixed to, ``DIAGNOSIS.gel_marker_tolerance`` of all their motion, which
  is deformation. How far a surface is dragged along depends on the boundary far away, where forces do not: a pad of
  three or six times its thickness moves them by a third (:mod:`sysid.discretisation.gel_extent`), and while a ball
  slides, finite elements of the wider one differ by a tenth from boundary elements of a layer without end.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_core.rigs import Gel, Rig
from sysid.model.predictor import Prediction
from sysid.observations.observations import Measured, Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.discretisation_basis import MODEL, ErrorShape
from sysid.solve.outliers import DIMENSIONS


def model_tolerance(rig: Rig, runs: Sequence[Run], predictions: Sequence[Prediction]) -> ErrorShape:
    """The error shape of a model, measured units; its expected size is none."""
    fixed = _seen_from_mount(rig)
    shapes = tuple(
        {m.channel: _tolerated(m, p.values[m.channel], m.channel in fixed) for m in run.measured}
        for run, p in zip(runs, predictions, strict=True)
    )
    return ErrorShape(MODEL, shapes, mean=0.0, sd=1.0)


def _seen_from_mount(rig: Rig) -> set[str]:
    """Cameras that see nothing but points on gels which are fixed to what they are fixed to themselves."""
    found = set()
    for name, camera in rig.cameras.items():
        bodies = [rig.bodies[sight.body] for sight in camera.sees]
        if bodies and all(isinstance(b, Gel) and b.mount == camera.mount for b in bodies):
            found.add(name)
    return found


def _tolerated(measured: Measured, values: np.ndarray, fixed: bool) -> np.ndarray:
    """Standard deviation of what careful models differ in, measured units ``(n, m)``."""
    if fixed and measured.kind in DIMENSIONS:
        return np.asarray(DIAGNOSIS.gel_marker_tolerance * np.nan_to_num(values - _first(values)))
    return DIAGNOSIS.model_tolerance * deformation(measured, values)


def _first(values: np.ndarray) -> np.ndarray:
    """The first row ``(m,)`` in which anything is in sight."""
    return np.asarray(values[np.argmax(np.isfinite(values).any(axis=1))])


def deformation(measured: Measured, values: np.ndarray) -> np.ndarray:
    """Part of the predicted readings ``(n, m)`` that is not rigid motion of all points, measured units; 0 where a point
    is out of sight."""
    first = _first(values)
    if measured.kind not in DIMENSIONS:
        return np.asarray(np.nan_to_num(values - first))
    k = DIMENSIONS[measured.kind]
    points, start = values.reshape(len(values), -1, k), first.reshape(-1, k)
    out = np.zeros(points.shape)
    for here, left in zip(points, out, strict=True):
        seen = np.isfinite(here).all(axis=1) & np.isfinite(start).all(axis=1)
        if seen.sum() > k:
            left[seen] = here[seen] - _rigid(start[seen], here[seen])
    return np.asarray(out.reshape(values.shape))


def _rigid(start: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Points ``(n, k)`` shifted, turned and scaled to lie best on others (Umeyama, IEEE PAMI 13, 1991)."""
    centre, target = start.mean(axis=0), here.mean(axis=0)
    u, s, vt = np.linalg.svd((here - target).T @ (start - centre))
    sign = np.ones(len(s))
    sign[-1] = np.sign(np.linalg.det(u @ vt)) or 1.0
    spread = float(np.sum((start - centre) ** 2))
    scale = float(s @ sign) / spread if spread > 0.0 else 1.0
    return np.asarray(target + scale * (start - centre) @ ((u * sign) @ vt).T)
