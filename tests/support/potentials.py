"""The potential of a system on the compiled core, looked at from one place after the other."""

from __future__ import annotations

import numpy as np

from sim_core.solve.integrator import Past
from sim_core.solve.state import State
from sim_core.solve.step import Potential, ended, potential
from sim_core.solve.system import System


class Look:
    """A system whose step begins in a ``state`` (at rest if not given) and lasts ``dt`` [s]; ``x``: positions at which
    one looks [m] ``(n, 3)``, written in place; ``targets``: of what is prescribed (None: where that is)."""

    def __init__(self, system: System) -> None:
        self.system, self.targets, self.dt = system, None, 1.0
        self.x = system.nodes.copy()
        self.begin(system.nodes)

    def begin(self, x, v=None, dt=1.0, internals=None, past: Past | None = None, t=0.0):
        """Let the step begin at ``x``."""
        still = np.zeros_like(x)
        known = internals if internals is not None else self.system.initial_internals()
        self.state = State(t, np.array(x), still if v is None else v, known, past)
        self.dt = dt

    def at(self, exact: bool = True) -> Potential:
        """All that there is to see."""
        system = self.system
        return potential(system, self.state, self.x, self.targets, self.dt, system.inertia, exact)

    def energy(self) -> float:
        return self.at().energy

    def gradient(self) -> np.ndarray:
        return self.at().gradient

    def exerted(self) -> np.ndarray:
        return self.at().exerted

    def move(self, values) -> None:
        """Change the unknowns."""
        self.x += (self.system.spread_matrix @ values).reshape(-1, 3)

    def residual(self) -> np.ndarray:
        """Derivative by the unknowns, springs of groups that give way included."""
        out = self.system.spread_matrix.T @ self.gradient().ravel()
        if self.system.compliant:
            given = [(self.x - self.targets)[group.nodes[0]] for group in self.system.compliant]
            out[-3 * len(given) :] += (self.system.springs * given).ravel()
        return out

    def hessian(self, exact: bool = False) -> np.ndarray:
        """Second derivatives by the unknowns, dense."""
        spread = self.system.spread_matrix
        out = (spread.T @ self.at(exact).hessian @ spread).toarray()
        springs = self.system.springs.ravel()
        out[range(len(out) - len(springs), len(out)), range(len(out) - len(springs), len(out))] += springs
        return out

    def end(self) -> State:
        """The state after the step, if it ends here."""
        return ended(self.system, self.state, self.x, self.dt, self.system.inertia)


def check_derivatives(look: Look, at, h=1e-8, tolerance=2e-6, seed=0) -> float:
    """Energy, residual and true Hessian against central differences ``at`` a place; the largest stiffness along a
    random direction."""
    x = np.array(at)
    direction = np.random.default_rng(seed).standard_normal(look.system.n_unknowns)
    found = []
    for shift in (h, -h):
        look.x[:] = x
        look.move(shift * direction)
        found.append((look.energy(), look.residual()))
    look.x[:] = x
    (e_plus, g_plus), (e_minus, g_minus) = found
    residual, hessian = look.residual(), look.hessian(exact=True)
    difference, change = (e_plus - e_minus) / (2.0 * h), (g_plus - g_minus) / (2.0 * h)
    assert abs(residual @ direction - difference) <= tolerance * max(abs(difference), np.abs(residual).max())
    np.testing.assert_allclose(hessian @ direction, change, atol=tolerance * np.abs(change).max())
    return float(np.abs(change).max())
