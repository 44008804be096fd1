"""Small motions of a system about where it is: natural vibrations, and the answer to small loads."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh, splu

from sim_core.core.system import on_core
from sim_core.errors import ConfigError
from sim_core.solve.state import State
from sim_core.solve.step import potential
from sim_core.solve.system import System

SLACK = 1e-13
"""Square of the slowest vibration over that of a node on its own, below which it is round-off: nothing resists."""

LEAST_PIVOT = 1e-12
"""Pivot over the entry on the diagonal below which it is round-off: a plate that is held has none below 1e-4."""

UNHELD = "The stiffness matrix is singular: something can move without resistance."


def tangent_stiffness(system: System, x: np.ndarray | None = None) -> sp.csr_matrix:
    """The true Hessian [N/m] over the unknowns with everything that acts now (weight, prestress, contact), without
    inertia, at positions ``x`` [m] ``(n, 3)`` (None: where the last step of the system ended)."""
    there = on_core(system).x if x is None else x
    state = State(-1.0, there, np.zeros_like(there), system.initial_internals())
    spread = system.spread_matrix
    return sp.csr_matrix(spread.T @ potential(system, state).hessian @ spread)


def linear_response(system: System, loads: np.ndarray) -> np.ndarray:
    """Displacement [m] ``(n, 3)`` due to small ``loads`` [N] ``(n, 3)`` about the equilibrium in which the system is,
    to first order. Raises ``ConfigError`` where something is not held."""
    stiffness = tangent_stiffness(system)
    try:
        factor = splu(
            stiffness.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    except RuntimeError as error:  # a pivot that is zero to the last bit
        raise ConfigError(UNHELD, "Hold every body.") from error
    pivots, own = np.abs(factor.U.diagonal()), np.abs(stiffness.diagonal())[np.argsort(factor.perm_c)]
    if np.any(pivots <= LEAST_PIVOT * own):
        raise ConfigError(UNHELD, "Hold every body.")
    spread = system.spread_matrix
    return np.asarray(spread @ factor.solve(spread.T @ loads.ravel())).reshape(-1, 3)


def natural_vibrations(system: System, count: int, x: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Slowest undamped vibrations about an equilibrium, K u = omega^2 M u: at ``x`` [m] ``(n, 3)``, or where the last
    step of the system ended.

    Returns angular frequencies [rad/s] ``(count,)``, ascending, and the shapes ``(count, n, 3)``, of unit modal
    mass [kg^-1/2]. K is the true Hessian with everything that acts now (weight, prestress, contact). Raises
    ``ConfigError`` where something is not held, or is not in stable equilibrium. What sheets and contacts
    remember (creases, elastic slip) is not part of it.
    """
    if system.compliant:
        raise ConfigError("Vibrations on compliant mounts are not computed.", "Leave the compliance out.")
    stiffness = tangent_stiffness(system, x)
    mass = system.reduced_mass()
    if not 0 < count < system.n_unknowns - 1:
        raise ConfigError(f"There are {system.n_unknowns} unknowns and not {count} vibrations.", "Ask for fewer.")
    try:
        squared, shapes = eigsh(stiffness.tocsc(), k=count, M=mass.tocsc(), sigma=0.0)
    except RuntimeError as error:
        raise ConfigError(UNHELD, "Hold every body.") from error
    order = np.argsort(squared)
    if abs(squared[order[0]]) <= SLACK * float((stiffness.diagonal() / mass.diagonal()).max()):
        raise ConfigError(UNHELD, "Hold every body.")
    if squared[order[0]] <= 0.0:
        raise ConfigError("The equilibrium is unstable: the softest vibration grows.", "Settle the system first.")
    return np.sqrt(squared[order]), (system.spread_matrix @ shapes[:, order]).T.reshape(count, -1, 3)
