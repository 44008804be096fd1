"""Compressible neo-Hookean solid on quadratic tetrahedra.

Stored energy per rest volume, with J = det F, I_C = tr(F^T F) and K = lambda + 2/3 mu:

    W(F) = W_dev + K/2 (J - 1)^2,     W_dev = mu/2 (I_C - 3) - mu (J - 1) + mu/6 (J - 1)^2

that is mu/2 (I_C - 3) - mu (J - 1) + (lambda + mu)/2 (J - 1)^2: the log-free law of Smith, de Goes and
Kim, Stable Neo-Hookean Flesh Simulation, ACM Trans. Graph. 37, 2018, with their lambda
replaced by lambda + mu. Expanding at F = I gives mu eps:eps + lambda/2 (tr eps)^2, so the E and nu that
are put in are the E and nu that a tensile test reads off. The energy is a polynomial in F, finite
and smooth through inversion. The force of a uniaxial test rises monotonically with compression down to
the stretch 0.54 at nu = 0.2, 0.42 at 0.3, 0.14 at 0.45 and below 0.1 at 0.49; beyond that it drops.

Damping by the rate of strain (Kelvin-Voigt, beta [s]) is beta dS_dev/dt added to S_dev and beta K dJ/dt added to the
pressure K (J - 1). With k = beta / tau of the step and what :meth:`sim_core.energies.term.StepContext.base` makes of
both,

    (1 + k) [W_dev + K/2 (J - 1)^2] - k [S_dev,b : C/2 + K (J - 1)_b (J - 1)]

but for a constant that makes the damping's part zero at the start of the step. At small strain that is beta times
the stiffness; it dissipates as long as W is convex in C.

Near incompressibility the bulk energy is weighed between the points and the mean of each element
(:mod:`sim_core.energies.neo_hookean_moduli`). mu, K and that weight are those of the element's own nu; beta may
differ from element to element, too.
"""

from collections.abc import Mapping

import numpy as np

from sim_core.energies.element_values import ElementValues
from sim_core.energies.neo_hookean_moduli import MU, moduli, moduli_by_nu
from sim_core.energies.term import Internals, Quantity, counted
from sim_core.errors import ConfigError, nearest_match
from sim_core.geometry import tet10
from sim_core.materials.elastic import poisson_ratios


class NeoHookean(ElementValues):
    """A solid body of quadratic tetrahedra as a term of the incremental potential.

    Parameters: ``E_pa`` [Pa], ``nu`` [-], ``stiffness_damping_s`` (beta [s], default 0).
    """

    quantities: tuple[Quantity, ...] = (
        Quantity("E_pa", "Pa", power=1),
        Quantity("nu", "-"),
        Quantity("stiffness_damping_s", "s"),
    )

    def __init__(self, name: str, tets: np.ndarray, rest: np.ndarray) -> None:
        """Take the elements ``(m, 10)`` in nodes of the whole scene and their rest positions [m].

        ``rest``: ``(n_nodes, 3)``; only the rows that ``tets`` names are read.
        """
        self.name = name
        self._tets = np.ascontiguousarray(tets, dtype=np.int32)
        self._rest = np.ascontiguousarray(rest, dtype=np.float64)
        points, weights = tet10.four_point_rule()
        grad, det = tet10.gradients(self._rest[self._tets], points)
        m = len(self._tets)
        self._grad = np.ascontiguousarray(grad.reshape(4 * m, 10, 3))
        super().__init__(det * weights)
        self._moduli = np.zeros((m, 3))

    @property
    def tets(self) -> np.ndarray:
        """Nodes of the elements among all, int32 ``(m, 10)``."""
        return self._tets

    @property
    def gradients(self) -> np.ndarray:
        """Of the shape functions at the quadrature points [1/m] ``(4 m, 10, 3)``."""
        return self._grad

    @property
    def shear_moduli(self) -> np.ndarray:
        """Of the elements [Pa] ``(m,)``."""
        return np.asarray(self._moduli[:, MU])

    @property
    def poisson_ratios(self) -> np.ndarray:
        """Of the elements ``(m,)``."""
        return np.asarray(self._nu)

    @property
    def moduli(self) -> np.ndarray:
        """mu, K [Pa] and K_own / K of the elements ``(m, 3)``."""
        return self._moduli

    def moduli_by(self, quantity: str) -> np.ndarray:
        """Derivative of :attr:`moduli` by ``E_pa`` or ``nu``, in forces that are linear in them ``(m, 3)``."""
        if quantity == "E_pa":
            return moduli(1.0, self._nu)
        return moduli_by_nu(self._given["E_pa"], self._nu)

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        """Take ``E_pa``, ``nu`` and, if the gel is damped, ``stiffness_damping_s``."""
        values = {"stiffness_damping_s": 0.0, **parameters}
        known = ("E_pa", "nu", "stiffness_damping_s")
        self._configure_grading(parameters)
        if self.grading is not None:
            values = {name: value for name, value in values.items() if name not in self.grading.numbers}
        for name in values:
            if name not in known:
                raise ConfigError(f"{self.name} has no parameter {name!r}.", nearest_match(name, known))
        for name in known:
            if name not in values:
                raise ConfigError(f"{self.name} needs the parameter {name!r}.", "Add it to the material.")
        e_pa, nu = values["E_pa"], poisson_ratios(self.name, values["nu"], self._nu_shift)
        if not 0.0 < e_pa < np.inf:
            raise ConfigError(f"{self.name}: E_pa = {e_pa} is not between 0.0 and inf.")
        self._given, self._nu[:], self._moduli[:] = dict(parameters), nu, moduli(e_pa, nu)
        self._damping[:] = values["stiffness_damping_s"] + self._more_damping

    def initial_internals(self) -> Internals:
        """There are none."""
        return {}
