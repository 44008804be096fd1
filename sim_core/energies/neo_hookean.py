"""Compressible neo-Hookean solid on quadratic tetrahedra, with one relaxing (Prony) branch.

Stored energy per rest volume, with J = det F, I_C = tr(F^T F) and K = lambda + 2/3 mu:

    W(F) = W_dev + K/2 (J - 1)^2,     W_dev = mu/2 (I_C - 3) - mu (J - 1) + mu/6 (J - 1)^2

that is mu/2 (I_C - 3) - mu (J - 1) + (lambda + mu)/2 (J - 1)^2: the log-free law of Smith, de Goes and
Kim, Stable Neo-Hookean Flesh Simulation, ACM Trans. Graph. 37, 2018, with their lambda
replaced by lambda + mu. Expanding at F = I gives mu eps:eps + lambda/2 (tr eps)^2, so the E and nu that
are put in are the E and nu that a tensile test reads off. The energy is a polynomial in F, finite
and smooth through inversion. The force of a uniaxial test rises monotonically with compression down to
the stretch 0.54 at nu = 0.2, 0.42 at 0.3, 0.14 at 0.45 and below 0.1 at 0.49; beyond that it drops.

Relaxation (Simo, Comput. Methods Appl. Mech. Eng. 60, 1987): E and nu are the instantaneous moduli, and a
share g of the deviatoric stress S_dev = 2 dW_dev/dC fades with the time constant tau. With

    a = exp(-dt/tau),   b = (1 - a) tau/dt,   H_n = a Q_n - b g S_dev(F_n)

a step minimises (1 - g + b g) W_dev(F) + K/2 (J - 1)^2 + 1/2 H_n : C, and afterwards
Q_{n+1} = H_n + b g S_dev(F_{n+1}). This b is exact for a stress that changes linearly during the step,
at any dt/tau (Simo's midpoint value exp(-dt/2tau) is 15 % low at dt = 2 tau).

Damping by the rate of strain (Kelvin-Voigt, beta [s]) is beta dS_dev/dt beside S_dev and beta K dJ/dt beside the
pressure K (J - 1): the limit of a branch that relaxes at once (tau to 0, g tau = beta), with the same code. With
k = beta / tau of the step and what :meth:`sim_core.energies.term.StepContext.base` makes of both,

    (1 + k) [W_dev + K/2 (J - 1)^2] - k [S_dev,b : C/2 + K (J - 1)_b (J - 1)]

but for a constant that makes the damping's part zero at the start of the step. At small strain that is beta times
the stiffness; it dissipates as long as W is convex in C.

Near incompressibility the bulk energy is weighed between the points and the mean of each element
(:mod:`sim_core.energies.neo_hookean_moduli`). mu, K and that weight are those of the element's own nu; g, tau and beta
may differ from element to element, too.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from sim_core.energies import neo_hookean_kernels as kernels
from sim_core.energies.element_values import ElementValues
from sim_core.energies.linearised import ByNumber, Linearised, axes_of, placed
from sim_core.energies.neo_hookean_kernels import BULK_SHARE, SHARE
from sim_core.energies.neo_hookean_memory import (
    pressure_blocks,
    stress_derivatives,
    stress_forces,
    volume_derivatives,
)
from sim_core.energies.neo_hookean_moduli import BULK, MU, OWN, moduli, moduli_by_nu
from sim_core.energies.neo_hookean_rest import GelStep, as_tensors, by_rest
from sim_core.energies.neo_hookean_vjp import Changes, NeoHookeanAlong, Remembered
from sim_core.energies.term import Buffers, Internals, Quantity, StepContext
from sim_core.errors import ConfigError, nearest_match
from sim_core.geometry import tet10
from sim_core.kernels import BoundKernel
from sim_core.materials.elastic import poisson_ratios


class NeoHookean(ElementValues):
    """A solid body of quadratic tetrahedra as a term of the incremental potential.

    Parameters: ``E_pa`` [Pa], ``nu`` [-], ``relaxation_g`` (share of the deviatoric stress that fades, 0 to
    below 1, default 0), ``relaxation_tau_s`` [s], ``stiffness_damping_s`` (beta [s], default 0). Internal variable
    ``Q``: the relaxing part of the second Piola-Kirchhoff stress [Pa], ``(m, 4, 6)``, components 11 22 33 23 13 12;
    zero while g = 0.
    """

    mirrored = False
    measured_at_rest = True
    quantities: tuple[Quantity, ...] = (
        Quantity("E_pa", "Pa", power=1),
        Quantity("nu", "-"),
        Quantity("stiffness_damping_s", "s"),
        Quantity("relaxation_g", "-", shares=True),
        Quantity("relaxation_tau_s", "s", shares=True),
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
        self._constants = np.tile([1.0, 1.0, 0.0], (m, 1))
        self._history, self._fading = np.zeros((4 * m, 7)), np.zeros((4 * m, 6))
        self._g, self._tau = np.zeros(m), np.ones(m)
        self._g_share, self._tau_share = np.ones(m), np.ones(m)
        self._fade, self._blend, self._constant = np.ones(m), np.ones(m), 0.0
        self._relaxes = self._damped = self._isotropic_known = False
        self._seen = np.full((0, 3), np.nan)

    @property
    def tets(self) -> np.ndarray:
        """Nodes of the elements among all, int32 ``(m, 10)``."""
        return self._tets

    @property
    def gradients(self) -> np.ndarray:
        """Of the shape functions at the quadrature points [1/m] ``(4 m, 10, 3)``."""
        return self._grad

    @property
    def weights(self) -> np.ndarray:
        """Volumes of the points [m^3] ``(m, 4)``, times the factors of the modulus; changed in place."""
        return np.asarray(self._size)

    @property
    def whole_weights(self) -> np.ndarray:
        """Volumes of the points [m^3] ``(m, 4)``."""
        return np.asarray(self._whole_size)

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

    @property
    def relaxes(self) -> bool:
        """Whether it has a share that relaxes, be it zero."""
        return self._relaxes

    def moduli_by(self, quantity: str) -> np.ndarray:
        """Derivative of :attr:`moduli` by ``E_pa`` or ``nu``, in forces that are linear in them ``(m, 3)``."""
        if quantity == "E_pa":
            return moduli(1.0, self._nu)
        return moduli_by_nu(self._given["E_pa"], self._nu)

    def shear_moduli_by(self, quantity: str) -> np.ndarray:
        """Derivative of :attr:`shear_moduli` by ``E_pa`` or ``nu`` ``(m,)``."""
        return np.asarray(self.moduli_by(quantity)[:, MU])

    def blocks(self) -> np.ndarray:
        """Return all ordered pairs of the ten nodes of each element, ``(100 m, 2)``."""
        i = np.repeat(self._tets, 10, axis=1).ravel()
        j = np.tile(self._tets, (1, 10)).ravel()
        return np.column_stack([i, j])

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        """Prepare the kernels for these arrays; keep only the entries that have a place."""
        m = len(self._tets)
        self._buffers, self._x = buffers, buffers.x
        self._positions = np.zeros_like(buffers.x)
        deformation, dilatation = np.zeros((4 * m, 3, 3)), np.zeros(4 * m)
        self._dilatation = dilatation
        mesh = self._rest, self._tets, self._grad, self._size, self._moduli
        state = deformation, dilatation, self._history
        self._seen = np.full_like(buffers.x, np.nan)
        self._deform = BoundKernel(kernels.deform, buffers.x, *mesh, deformation, dilatation)
        self._deform_stored = BoundKernel(kernels.deform, self._positions, *mesh, deformation, dilatation)
        self._stress = np.zeros((4 * m, 6))
        self._deviatoric_stress = BoundKernel(kernels.deviatoric_stress, deformation, self._moduli, self._stress)
        law = self._moduli, self._constants
        solid = self._grad, self._size, *law
        self._energy = BoundKernel(kernels.add_energy, *state, self._size, *law, buffers.energy)
        self._gradient = BoundKernel(kernels.add_gradient, *state, self._tets, *solid, buffers.gradient)
        self._vectors, self._works, self._virtual = np.zeros_like(buffers.x), np.zeros((m, 3)), np.zeros((4 * m, 7))
        found = self._works, self._virtual
        self._works_then = np.zeros((m, 3))
        mesh_then = self._rest, self._tets, self._grad, self._size, self._virtual
        self._along_then = BoundKernel(kernels.along_then, self._positions, *mesh_then, self._works_then)
        self._works_along = BoundKernel(
            kernels.along, deformation, self._tets, self._grad, self._size, self._vectors, *found
        )
        places = _places(slots.reshape(m, 10, 10, 3, 3), len(buffers.hessian) - 1)
        tangent, local = np.zeros((4 * m, 9, 9)), np.zeros(900)
        self._projected_tangent = BoundKernel(kernels.projected_tangent, *state, *law, np.zeros((9, 10)), tangent)
        self._add_projected = BoundKernel(
            kernels.add_projected,
            *(tangent, deformation, *solid, places),
            *(np.zeros((30, 36)), np.zeros(30), local, buffers.hessian),
        )
        kept_part = np.zeros((m, 55))
        self._isotropic = BoundKernel(kernels.isotropic, self._history, *solid, kept_part)
        self._add_exact = BoundKernel(
            kernels.exact_hessian,
            *(deformation, dilatation, self._history, *solid, kept_part, places, np.zeros((5, 30)), buffers.hessian),
        )
        self._isotropic_known = False

    def _weigh(self) -> None:
        super()._weigh()
        self._isotropic_known = False

    def scale_relaxation(self, share: np.ndarray, tau: np.ndarray) -> None:
        """Let each element relax by ``share`` ``(m,)`` times the share that is configured, with ``tau`` times the time
        constant."""
        self._g_share[:], self._tau_share[:] = share, tau
        self.configure(self._given)

    def configure(self, parameters: Mapping[str, float]) -> None:
        """Take ``E_pa``, ``nu`` and, if the gel relaxes or is damped, the other parameters."""
        values = {"relaxation_g": 0.0, "relaxation_tau_s": 1.0, "stiffness_damping_s": 0.0, **parameters}
        known = ("E_pa", "nu", "relaxation_g", "relaxation_tau_s", "stiffness_damping_s")
        self._configure_grading(parameters)
        if self.grading is not None:
            values = {name: value for name, value in values.items() if name not in self.grading.numbers}
        for name in values:
            if name not in known:
                raise ConfigError(f"{self.name} has no parameter {name!r}.", nearest_match(name, known))
        for name in known:
            if name not in values:
                raise ConfigError(f"{self.name} needs the parameter {name!r}.", "Add it to the material.")
        e_pa, nu = values["E_pa"], poisson_ratios(self.name, values["nu"], self._beside)
        g, tau = values["relaxation_g"], values["relaxation_tau_s"]
        for name, value in (("E_pa", e_pa), ("relaxation_tau_s", tau)):
            if not 0.0 < value < np.inf:
                raise ConfigError(f"{self.name}: {name} = {value} is not between 0.0 and inf.")
        if not 0.0 <= g < 1.0:
            raise ConfigError(f"{self.name}: relaxation_g = {g} is not in [0, 1).")
        self._given, self._nu[:], self._moduli[:] = dict(parameters), nu, moduli(e_pa, nu)
        self._g[:], self._tau[:] = g * self._g_share, tau * self._tau_share
        self._damping[:] = values["stiffness_damping_s"] + self._more_damping
        self._relaxes = "relaxation_g" in parameters  # also with a share of zero, for the derivative by it
        self._damped = bool(self._damping.any())
        self._constants[:] = 1.0, 1.0, self._remembers
        self._constant = 0.0
        if not self._remembers:
            self._history[:] = 0.0
        self._isotropic_known = False
        self._seen[:] = np.nan

    @property
    def _remembers(self) -> bool:
        return self._relaxes or self._damped

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        """Freeze the memory stress H_n of the step, and what rates are measured from."""
        self._grade_at(step.time)
        if not self._remembers:
            return
        self._isotropic_known = False
        ratio = step.dt / self._tau
        self._fade[:], self._blend[:] = np.exp(-ratio), -np.expm1(-ratio) / ratio
        self._constants[:, SHARE] = 1.0 - self._g + self._blend * self._g
        self._fading[:] = 0.0
        if self._relaxes:
            self._fading[:] = _at_points(self._fade) * internals["Q"].reshape(-1, 6)
            self._fading -= _at_points(self._blend * self._g) * self._stress_at(step.x_start)
        self._history[:, :6], self._history[:, 6] = self._fading, 0.0
        if self._damped:
            rate = self._damping / step.tau
            self._constants[:, SHARE] += rate
            self._constants[:, BULK_SHARE] = 1.0 + rate
            base = -_at_points(rate) * step.base(self._stress_and_dilatation_at)
            base[:, 6] *= np.repeat(self._moduli[:, BULK], 4)
            self._constant = -self._damping_energy(step.x_start, rate, base)
            self._history += base

    def _measure(self) -> None:
        """Bring strains up to date with the positions."""
        if not np.array_equal(self._seen, self._x):
            self._deform()
            self._seen[:] = self._x

    def _damping_energy(self, x: np.ndarray, rate: np.ndarray, history: np.ndarray) -> float:
        """Energy [J] at ``x`` [m] of the damping alone."""
        kept, total = (self._constants.copy(), self._history.copy()), float(self._buffers.energy[0])
        self._constants[:, SHARE] = self._constants[:, BULK_SHARE] = rate
        self._history[:] = history
        self._positions[:] = x
        self._deform_stored()
        self._seen[:] = np.nan
        self._energy()
        found = float(self._buffers.energy[0]) - total
        self._buffers.energy[0], self._constants[:], self._history[:] = total, *kept
        return found

    def add_energy(self) -> None:
        """Add the incremental energy [J]."""
        self._measure()
        self._energy()
        self._buffers.energy[0] += self._constant

    def add_gradient(self) -> None:
        """Add dE/dx [N]."""
        self._measure()
        self._gradient()

    def along(self, vectors: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals) -> NeoHookeanAlong:
        """What forces along nodal ``vectors`` ``(n, 3)``, and new internal variables with the weights ``kept``,
        flattened, know of the gel's numbers at the end of a step from ``internals``."""
        self.begin_step(step, internals)
        self._measure()
        self._vectors[:] = vectors
        self._works_along()
        memory = None
        if self._remembers:
            memory = Remembered(
                history=self._history.copy(),
                stresses=lambda: self._stresses(step),
                fresh=self._blend * self._g,
                kept=kept.reshape(-1, 6),
                by_relaxation=lambda ends: self._changes_by_relaxation(step, internals, ends),
            )
        return NeoHookeanAlong(
            works=self._works.copy(),
            virtual=self._virtual.copy(),
            moduli=self._moduli,
            constants=self._constants.copy(),
            young=self._given["E_pa"],
            nu=self._nu,
            damping=self._damping,
            tau=step.tau,
            base=lambda: step.base(self._works_at),
            memory=memory,
        )

    def _stresses(self, step: StepContext) -> tuple[np.ndarray, np.ndarray]:
        """S_dev [Pa] ``(4 m, 6)`` at the start and at the end of a step."""
        return self._stress_at(step.x_start).copy(), self._stress_at(self._x).copy()

    def _works_at(self, x: np.ndarray) -> np.ndarray:
        """Work of the stresses at other positions ``x`` [m], along the vectors at hand, by modulus ``(m, 3)``."""
        self._positions[:] = x
        self._along_then()
        return self._works_then

    def by_rest(self, along: np.ndarray, kept: np.ndarray, step: StepContext) -> np.ndarray:
        """What the derivative by the shape at rest of the work of the forces along nodal vectors ``(n, 3)``, and of the
        product of the new internal variables, flattened, with ``kept``, is made of at the quadrature points,
        ``(m, 4, 3, 3)`` (:mod:`sim_core.energies.neo_hookean_rest`)."""
        shape, grad = (len(self._tets), 4, 3, 3), self._grad.reshape(len(self._tets), 4, 10, 3)

        def deformation(x: np.ndarray) -> np.ndarray:
            return np.asarray(np.eye(3) + self.displacement_gradients(x).reshape(shape))

        fresh, rate = ((self._blend * self._g)[:, None], (self._damping / step.tau)[:, None])
        earlier = []
        if self._remembers:
            now, before = step.weights
            earlier = [(deformation(step.x_start), -fresh - now * rate, -now * rate)]
            if step.x_past is not None and self._damped:
                earlier.append((deformation(step.x_past), -before * rate, -before * rate))
        history = self._history.reshape(len(self._tets), 4, 7)
        memory = as_tensors(history[..., :6]), history[..., 6]
        law = self._moduli[:, [MU]], self._moduli[:, [BULK]], self._moduli[:, [OWN]]
        shares = self._constants[:, [SHARE]], self._constants[:, [BULK_SHARE]]
        known = GelStep(self._size, deformation(self._x), *memory, *law, *shares, tuple(earlier), fresh)
        slope = np.einsum("mai,mqaj->mqij", along[self._tets], grad)
        weights = as_tensors(kept.reshape(len(self._tets), 4, 6), 0.5) if self._relaxes else None
        return by_rest(known, slope, weights)

    def add_hessian(self, exact: bool) -> None:
        """Add d2E/dx2 [N/m], each quadrature point made positive semidefinite unless ``exact``."""
        self._measure()
        if not exact:
            self._projected_tangent()
            self._add_projected()
            return
        if not self._isotropic_known:
            self._isotropic()
            self._isotropic_known = True
        self._add_exact()

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        """Return Q_{n+1} = H_n + b g S_dev(F_{n+1})."""
        if not self._relaxes:
            return internals
        q = self._fading + _at_points(self._blend * self._g) * self._stress_at(self._x)
        return {"Q": q.reshape(-1, 4, 6)}

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised | None:
        """Derivatives by the start of the step and of the one before, and by the stress that relaxes."""
        del after
        if not self._remembers:
            return None
        count, whole = len(self._grad), self._x.size
        axes = np.repeat(axes_of(self._tets), 4, axis=0)
        f = np.eye(3) + self.displacement_gradients(self._x)
        push = self._size.reshape(-1, 1, 1) * stress_forces(f, self._grad)
        fade, fresh, rate = (
            _at_points(each)[..., None] for each in (self._fade, self._blend * self._g, self._damping / step.tau)
        )
        now, before = step.weights
        start = self._stress_derivatives(step.x_start)
        by_start = [(-(fresh + now * rate) * push @ start, axes, axes)]
        past = None
        if self._damped:
            by_start.append(self._pressure_blocks(step.x_start, -now * self._damping / step.tau))
        if self._damped and step.x_past is not None:
            sheared = -before * rate * push @ self._stress_derivatives(step.x_past)
            pressed = self._pressure_blocks(step.x_past, -before * self._damping / step.tau)
            past = placed((sheared, axes, axes), pressed, shape=(whole, whole))
        found = Linearised(force_start=placed(*by_start, shape=(whole, whole)), force_past=past)
        if not self._relaxes:
            return found
        size = internals["Q"].size
        q = np.arange(size).reshape(count, 6)
        return replace(
            found,
            numbers=self._by_relaxation(step, internals),
            force_memory=placed((fade * push, axes, q), shape=(whole, size)),
            memory_start=placed((-fresh * start, q, axes), shape=(size, whole)),
            memory_memory=placed((np.repeat(fade, 6, axis=0), q.reshape(-1, 1), q.reshape(-1, 1)), shape=(size, size)),
            memory_end=placed((fresh * self._stress_derivatives(self._x), q, axes), shape=(size, whole)),
        )

    def _by_relaxation(self, step: StepContext, internals: Internals) -> dict[str, ByNumber]:
        """Derivatives by g and tau, of which each element has a share."""
        gradient, found = self._buffers.gradient, {}
        shares = {"relaxation_g": self._g_share, "relaxation_tau_s": self._tau_share}
        changes = self._changes_by_relaxation(step, internals, self._stresses(step))
        for name, (share, stress, fresh) in changes.items():
            part, scaled = shares[name], _at_points(shares[name]) * stress
            gradient[:] = 0.0
            with self._exerting(part * share, scaled):
                self.add_gradient()
            memory = _at_points(part) * (stress + fresh)
            found[name] = ByNumber(gradient.ravel().copy(), memory.ravel(), np.zeros(3))
        return found

    def _changes_by_relaxation(
        self, step: StepContext, internals: Internals, ends: tuple[np.ndarray, np.ndarray]
    ) -> Changes:
        """Derivatives by g and tau of the factor on S_dev ``(m,)``, of H and of what end_step adds to it
        ``(4 m, 6)``; ``ends``: S_dev at the start and at the end. Force and memory are linear in these, so theirs are
        what these derivatives exert."""
        ratio, g, b, fade = step.dt / self._tau, self._g, self._blend, self._fade
        fading, slower = fade * ratio / self._tau, (b - fade) / self._tau  # of fade and b by tau
        q = internals["Q"].reshape(-1, 6)
        start, end = ends
        slow = _at_points(slower * g)
        return {
            "relaxation_g": (b - 1.0, -_at_points(b) * start, _at_points(b) * end),
            "relaxation_tau_s": (slower * g, _at_points(fading) * q - slow * start, slow * end),
        }

    @contextmanager
    def _exerting(self, share: np.ndarray, stress: np.ndarray) -> Iterator[None]:
        """While in it, forces are those of ``share`` ``(m,)`` times W_dev, and of a memory of ``stress`` [Pa]
        ``(4 m, 6)``."""
        kept, one = (self._constants.copy(), self._history.copy()), np.ones_like(share)
        self._constants[:] = np.column_stack([share, np.zeros_like(share), one])
        self._history[:, :6], self._history[:, 6] = stress, 0.0
        try:
            yield
        finally:
            self._constants[:], self._history[:] = kept

    def _pressure_blocks(self, x: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivative by other positions ``x`` of the force that a memory of pressure, K (J - 1) there times ``weight``
        ``(m,)``, exerts at those at hand: blocks of the elements, and where they are."""
        moved, axes = (self.displacement_gradients(at) for at in (self._x, x)), axes_of(self._tets)
        here, there = (volume_derivatives(np.eye(3) + g, self._grad) for g in moved)
        blocks = pressure_blocks(here, there, self._size, self._moduli[:, BULK], self._moduli[:, OWN])
        return weight[:, None, None] * blocks, axes, axes

    def _stress_derivatives(self, x: np.ndarray) -> np.ndarray:
        """Derivative of S_dev at ``x`` by the nodes of each point's element [Pa/m], ``(4 m, 6, 30)``."""
        return stress_derivatives(self.displacement_gradients(x), self._grad, np.repeat(self._moduli[:, MU], 4))

    def displacement_gradients(self, x: np.ndarray) -> np.ndarray:
        """F - 1 at all points when nodes are at ``x`` [m] ``(n, 3)``, ``(4 m, 3, 3)``."""
        moved = np.repeat((x - self._rest)[self._tets], 4, axis=0)
        return np.asarray(moved.swapaxes(-1, -2) @ self._grad)

    def initial_internals(self) -> Internals:
        """Return Q = 0."""
        return {"Q": np.zeros((len(self._tets), 4, 6))}

    def _stress_at(self, x: np.ndarray) -> np.ndarray:
        """S_dev [Pa] at positions ``x`` [m], ``(4 m, 6)``; valid until the next call."""
        self._positions[:] = x
        self._deform_stored()
        self._seen[:] = np.nan
        self._deviatoric_stress()
        return self._stress

    def _stress_and_dilatation_at(self, x: np.ndarray) -> np.ndarray:
        """S_dev [Pa] and the J - 1 that the bulk modulus sees, at positions ``x`` [m], ``(4 m, 7)``."""
        return np.column_stack([self._stress_at(x), self._dilatation])


def _at_points(values: np.ndarray) -> np.ndarray:
    """Values of the elements ``(m,)`` at the quadrature points ``(4 m, 1)``."""
    return np.repeat(values, 4)[:, None]


def _places(slots: np.ndarray, nowhere: int) -> np.ndarray:
    """Place of each entry of each block a <= b of the elements, -1 where there is none: int32 ``(m, 495)``.

    ``slots``: of all ordered pairs, ``(m, 10, 10, 3, 3)``; an entry has its place in one of the two orders.
    """
    mirrored = slots.transpose(0, 2, 1, 4, 3)
    a, b = np.triu_indices(10)
    both = np.where(slots == nowhere, mirrored, slots)[:, a, b]
    below = np.tril(np.ones((3, 3), dtype=bool), -1) & (a == b)[:, None, None]
    return np.ascontiguousarray(np.where((both == nowhere) | below, -1, both).reshape(len(slots), -1), dtype=np.int32)
