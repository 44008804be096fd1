"""The baseline: which parameters of a rig are left open, its fit, and the simulator's own error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_core.errors import ConfigError
from sim_core.rigs import Gel, Rig, Sheet
from sysid.fit.engine import Prediction
from sysid.fit.parameters import fit_parameters
from sysid.fit.pool import PooledEngine
from sysid.fit.problem import Direction, Fitted
from sysid.fit.runs import Run


def open_parameters(rig: Rig) -> list[str]:
    """Material parameters and friction coefficients that a baseline fit adjusts."""
    names: list[str] = []
    for name, body in rig.bodies.items():
        if isinstance(body, Sheet):
            names.append(f"{name}.E_pa")
            # A quasi-static pull shows the lateral contraction, motion shows the mass.
            names.append(f"{name}.density_kg_m3" if rig.solver.inertia else f"{name}.nu")
        elif isinstance(body, Gel):
            names += [f"{name}.E_pa", f"{name}.nu"]
    names += [f"contacts.{c.name}.friction" for c in rig.contacts if c.friction > 0.0]
    if not names:
        raise ConfigError("The rig has nothing to adjust.", "A diagnosis needs a sheet or a gel.")
    return [p.name for p in fit_parameters(rig, names)]


def discretisation(engine: PooledEngine, rig: Rig, runs: Sequence[Run]) -> list[Direction]:
    """How the predictions change when the mesh, and when the time step, is refined once.

    The true error is about 4/3 (mesh, order two) and twice (step, order one) of these differences; the
    direction of the step is scaled accordingly and the sizes stay uncertain.
    """
    plain = [engine.submit(rig, run) for run in runs]
    fine = [engine.submit(rig, run, 2) for run in runs]
    short = [engine.submit(rig, run, 1, 0.5 * rig.solver.dt_s) for run in runs]
    base = [f.result() for f in plain]
    return [
        Direction("mesh", tuple(_difference(f.result(), b, 4.0 / 3.0) for f, b in zip(fine, base, strict=True))),
        Direction("time step", tuple(_difference(s.result(), b, 2.0) for s, b in zip(short, base, strict=True))),
    ]


def _difference(refined: Prediction, base: Prediction, factor: float) -> dict[str, np.ndarray]:
    return {c: factor * np.nan_to_num(refined.values[c] - v) for c, v in base.values.items()}


def corrected(fitted: Fitted, directions: Sequence[Direction], run: int, channel: str) -> np.ndarray:
    """Prediction of a channel with the estimated discretisation error added, measured units ``(n, m)``."""
    values = fitted.predictions[run].values[channel]
    for d in directions:
        values = values + fitted.sizes.get((d.label, run, channel), d.mean) * d.shapes[run].get(channel, 0.0)
    return values
