"""Sheets that are strained beyond the range of their membrane law.

The law of sheets is linear in Green strain (:mod:`sim_core.energies.membrane`), which stiffens in tension and softens
in compression more than any material: along a strip the nominal stress is E s (s^2 - 1) / 2 at the stretch s. At 20 %
it is a third above Hooke's E (s - 1) and half as much again as that of rubber, E (s - 1/s^2) / 3; at -20 % it is a
third below Hooke's, and beyond -42 % it falls.
"""

from __future__ import annotations

import warnings

import numpy as np

from sim_core.energies.membrane import Membrane
from sim_core.geometry.sheets import SheetMesh
from sim_core.rigs import Sheet
from sim_core.scene.scene import Scene

LARGEST_STRAIN = 0.2
"""Of the stretch of the law, to both sides."""


class StrainBeyondLaw(UserWarning):
    """A sheet is strained beyond the range of its membrane law."""


def check_strains_at(scene: Scene, times: np.ndarray, x: np.ndarray) -> None:
    """Warn, once a sheet and scene, where a sheet is strained beyond the range of its law, at times [s] ``(t,)`` since
    the start at positions ``x`` [m] ``(t, n, 3)``."""
    for name, body in scene.bodies.items():
        if name in scene.strained:
            continue
        for term in body.terms:
            if isinstance(term, Membrane) and isinstance(body.spec, Sheet) and body.spec.law != "neo_hookean":
                _check(scene, name, term, times, x)


def _check(scene: Scene, name: str, term: Membrane, times: np.ndarray, x: np.ndarray) -> None:
    largest = _largest_stretches(term, x)
    beyond = np.flatnonzero((np.abs(largest) > LARGEST_STRAIN).any(axis=1))
    if not len(beyond):
        return
    largest, time = largest[beyond[0]], float(times[beyond[0]])
    worst = int(np.argmax(np.abs(largest)))
    scene.strained.add(name)
    body = scene.bodies[name]
    assert isinstance(body.layout, SheetMesh)
    place = body.local[body.layout.triangles[worst]].mean(axis=0)
    verb = "stretched" if largest[worst] > 0.0 else "compressed"
    warnings.warn(
        f"The sheet {name} is {verb} by {100.0 * abs(largest[worst]):.0f} % at x = {place[0]:.4g} m, y = "
        f"{place[1]:.4g} m of its own coordinates at {time:.4g} s, and its membrane law (St. Venant-Kirchhoff) is for "
        f"strains up to {100.0 * LARGEST_STRAIN:.0f} %: forces are too {'large' if largest[worst] > 0.0 else 'small'} "
        "beyond. Write 'law: neo_hookean' and 'nu: 0.5' if it is a rubber film.",
        StrainBeyondLaw,
        stacklevel=2,
    )


def _largest_stretches(term: Membrane, x: np.ndarray) -> np.ndarray:
    """Of the two principal stretches of each triangle less one the larger one by size ``(t, m)``."""
    sides = x[:, term.triangles[:, 1:]] - x[:, term.triangles[:, :1]]
    hats = term.hats()[:, 1:]
    f, g = (hats[:, 0, k, None] * sides[:, :, 0] + hats[:, 1, k, None] * sides[:, :, 1] for k in range(2))
    first, second, across = ((a * b).sum(axis=-1) for a, b in ((f, f), (g, g), (f, g)))
    mean, radius = 0.5 * (first + second), np.hypot(0.5 * (first - second), across)
    high, low = (np.sqrt(np.maximum(mean + sign * radius, 0.0)) - 1.0 for sign in (1.0, -1.0))
    return np.asarray(np.where(high > -low, high, low))
