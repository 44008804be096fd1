"""Work of a gel's forces along nodal vectors, and what it and the gel's memory know of its numbers.

Forces are linear in mu, K_own, K - K_own (:mod:`sim_core.energies.neo_hookean_moduli`) and the memory of stress and
pressure (H, h), so with the virtual strains of the vectors v, V = grad v, at the quadrature points

    work = k_S mu W_dev' + k_B (K_own W_own' + (K - K_own) W_mean') + sum_q w_q [H : sym(F^T V) + h cof F : V]

where a dash is the derivative along v of the energy per modulus, k_S and k_B the shares in which a step has them. What
of the memory is not left from before is linear in the moduli, too. A damping's is the work of the stresses that rates
are measured from along the same virtual strains, S_dev : sym(F^T V) and (J - 1) cof F : V: as that at the end, with the
other sign.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim_core.energies.neo_hookean_kernels import BULK_SHARE, SHARE
from sim_core.energies.neo_hookean_moduli import BULK, MU, OWN, moduli, moduli_by_nu

Changes = dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]
"""By the name of a number of the relaxation: derivatives by it of the factor on W_dev ``(m,)``, of H, and of what the
end of a step adds to it, ``(4 m, 6)`` [Pa]."""


@dataclass(frozen=True)
class Remembered:
    """What a gel with memory had before a step, and has of it at the end. ``history``: H and h [Pa] ``(4 m, 7)``;
    ``stresses``: gives S_dev before and at the end [Pa] ``(4 m, 6)``; ``fresh``: b g of the elements ``(m,)``;
    ``kept``: weights of the new stress that relaxes ``(4 m, 6)``; ``by_relaxation``: gives, from these stresses, what
    the numbers of the relaxation change."""

    history: np.ndarray
    stresses: Callable[[], tuple[np.ndarray, np.ndarray]]
    fresh: np.ndarray
    kept: np.ndarray
    by_relaxation: Callable[[tuple[np.ndarray, np.ndarray]], Changes]

    @cached_property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """S_dev before and at the end."""
        return self.stresses()

    @cached_property
    def changes(self) -> Changes:
        """What the numbers of the relaxation change."""
        return self.by_relaxation(self.ends)


@dataclass(frozen=True)
class NeoHookeanAlong:
    """A step's end, of which the derivatives are by the values of the elements, ``(m,)``. ``works``: W_dev', W_own',
    W_mean' [m^3] ``(m, 3)``, and ``base`` gives those of the stresses that rates are measured from; ``virtual``: w_q
    sym(F^T V), off the diagonal doubled, and w_q cof F : V ``(4 m, 7)``; ``moduli``, ``constants``: as the kernels read
    them; ``young`` [Pa], ``nu``; ``damping``: beta [s] ``(m,)``; ``tau`` [s]: of the step; ``memory``: None where there
    is none. Good for as long as the gel does not go on: what is asked for is looked up then."""

    works: np.ndarray
    virtual: np.ndarray
    moduli: np.ndarray
    constants: np.ndarray
    young: float
    nu: np.ndarray
    damping: np.ndarray
    tau: float
    base: Callable[[], np.ndarray]
    memory: Remembered | None

    @cached_property
    def _base(self) -> np.ndarray:
        return self.base()

    def work(self) -> np.ndarray:
        """Work of the forces dE/dx."""
        found = self._shared(self.moduli)
        return found if self.memory is None else found + self._of_memory(self.memory.history)

    def _shared(self, law: np.ndarray) -> np.ndarray:
        """Work with the moduli ``law`` ``(m, 3)`` in the shares of the step, without memory."""
        return _work(law, self.works, self.constants[:, SHARE], self.constants[:, BULK_SHARE])

    def _of_memory(self, history: np.ndarray) -> np.ndarray:
        """Work of a memory of stress, and of pressure if ``(4 m, 7)``."""
        products = self.virtual[:, : history.shape[1]] * history
        return np.asarray(products.sum(axis=1).reshape(-1, 4).sum(axis=1))

    def by(self, quantity: str) -> np.ndarray:
        """Derivative by a number, element by element."""
        ways = {"E_pa": self.by_modulus, "nu": self.by_nu, "stiffness_damping_s": self.by_damping}
        return ways[quantity]() if quantity in ways else self.by_relaxation(quantity)

    def by_nu(self) -> np.ndarray:
        """Derivative by Poisson's ratio of the work, and of the product of the new internal variables with their
        weights."""
        return self._by_moduli(moduli_by_nu(self.young, self.nu))

    def by_modulus(self) -> np.ndarray:
        """Derivative by Young's modulus [1/Pa], of the same."""
        return self._by_moduli(moduli(1.0, self.nu))

    def _by_moduli(self, slopes: np.ndarray) -> np.ndarray:
        """Derivative by a number by which mu, K_own and K - K_own have ``slopes``, as moduli are: what is linear in
        them, with the slopes in their place and without what is left from before."""
        found = self._shared(slopes)
        memory = self.memory
        if memory is not None and memory.fresh.any():
            start, end = memory.ends
            fresh = np.repeat(memory.fresh * slopes[:, MU] / self.moduli[:, MU], 4)[:, None]
            found = found + self._of_memory(-fresh * start) + self._kept(fresh * (end - start))
        if self.damping.any():
            found = found - self.damping / self.tau * _work(slopes, self._base)
        return found

    def by_damping(self) -> np.ndarray:
        """Derivative by the stiffness damping [1/s] of the work."""
        return np.asarray(_work(self.moduli, self.works - self._base) / self.tau)

    def by_relaxation(self, name: str) -> np.ndarray:
        """Derivative by ``relaxation_g`` or ``relaxation_tau_s``, of the same as by nu."""
        assert self.memory is not None, "nothing relaxes"
        share, stress, fresh = self.memory.changes[name]
        found = share * self.moduli[:, MU] * self.works[:, 0]
        return np.asarray(found + self._of_memory(stress) + self._kept(stress + fresh))

    def _kept(self, change: np.ndarray) -> np.ndarray:
        """Product with a change of the new stress that relaxes ``(4 m, 6)``."""
        assert self.memory is not None
        return np.asarray((self.memory.kept * change).sum(axis=1).reshape(-1, 4).sum(axis=1))


def _work(
    law: np.ndarray, works: np.ndarray, share: np.ndarray | float = 1.0, bulk_share: np.ndarray | float = 1.0
) -> np.ndarray:
    """Work with the moduli ``law`` ``(m, 3)`` in these shares, from ``works`` by modulus ``(m, 3)``."""
    sheared, own, mean = works.T
    return np.asarray(share * law[:, MU] * sheared + bulk_share * law[:, BULK] * (law[:, OWN] * (own - mean) + mean))
