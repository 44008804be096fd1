"""The state of a system between two steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.energies.term import Internals
from sim_core.solve.integrator import Past


@dataclass(frozen=True)
class State:
    """A value: copy it, perturb it, replay from it. ``x`` [m], ``v`` [m/s] ``(n, 3)``; ``t`` [s]; ``past``:
    the state before, where the integrator looks back."""

    t: float
    x: np.ndarray
    v: np.ndarray
    internals: dict[str, Internals]
    past: Past | None = None
