"""Natural vibrations of a system about where it is."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh

from sim_core.errors import ConfigError
from sim_core.solve.integrator import step_context
from sim_core.solve.system import System


def natural_vibrations(system: System, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Slowest undamped vibrations about the equilibrium in which the system is: K u = omega^2 M u.

    Returns angular frequencies [rad/s] ``(count,)``, ascending, and the shapes ``(count, n, 3)``, of unit modal
    mass [kg^-1/2]. K is the true Hessian with everything that acts now (weight, prestress, contact). Raises
    ``ConfigError`` where something is not held, or is not in stable equilibrium.
    """
    if len(system.deflections):
        raise ConfigError("Vibrations on compliant mounts are not computed.", "Leave the compliance out.")
    step = step_context(system.x.copy(), np.zeros_like(system.x), 1.0)
    inertia, system.inertia = system.inertia, False
    try:
        system.begin_step(step, system.initial_internals(), search=False)
        upper = system.hessian(exact=True)
    finally:
        system.inertia = inertia
    stiffness = upper + sp.triu(upper, 1).T
    mass = system.reduced_mass()
    if not 0 < count < system.n_unknowns - 1:
        raise ConfigError(f"There are {system.n_unknowns} unknowns and not {count} vibrations.", "Ask for fewer.")
    try:
        squared, shapes = eigsh(stiffness.tocsc(), k=count, M=mass.tocsc(), sigma=0.0)
    except RuntimeError as error:
        raise ConfigError(
            "The stiffness matrix is singular: something can move without resistance.", "Hold every body."
        ) from error
    order = np.argsort(squared)
    if squared[order[0]] <= 0.0:
        raise ConfigError("The equilibrium is unstable: the softest vibration grows.", "Settle the system first.")
    return np.sqrt(squared[order]), np.stack([system.spread(shapes[:, k]) for k in order])
