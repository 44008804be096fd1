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

Near incompressibility a bulk energy K/2 (J - 1)^2 at all four quadrature points is too stiff, and one on
the mean dilatation of each element alone too soft. The two are mixed: the pointwise part has the
stiffness K_own with 1/K_own = 1/K + 1/(6 mu), the mean takes the rest. Uniform strain is not affected
(straight elements reproduce it exactly; on the curved ones of a coarse dome the four-point rule leaves
0.6 % of the largest nodal force unbalanced, 0.2 % after one refinement).
Error of the apparent modulus of a disc bonded to two plates, S = R/2t, against an axisymmetric solution
that is converged to 0.2 %; pointwise / this mixture / mean alone [%]:

    cells of the disc      S = 1, nu 0.45     S = 1, nu 0.49      S = 2.5, nu 0.45    S = 2.5, nu 0.49
    (2, 1, 1)   60 tets    16 / 12 /  5       79 / 34 / 19        6.4 / 4.8 /  1.7    19  /  4.9 /  -5.8
    (2, 1, 2)  120 tets    5.6 / 3.8 / -4.0   10.9 / 5.6 / -8.6   3.4 / 1.7 / -3.2    5.0 / -4.3 / -19.9
    (2, 2, 2)  200 tets    5.2 / 3.8 / -2.1   10.0 / 6.1 / -4.5   2.9 / 1.7 / -2.6    4.2 / -1.6 / -15.2
    (4, 2, 2)  480 tets    4.7 / 3.4 / -2.2   10.0 / 6.2 / -3.5   2.2 / 1.3 / -2.8    3.8 /  0.0 / -11.8

So a bonded layer wants at least two cells through its thickness. At nu = 0.3 all three are within 1.3 %
from there on.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim_core.energies.linearised import ByNumber, Linearised, axes_of, complex_step, placed
from sim_core.energies.neo_hookean_kernels import (
    BULK,
    HISTORY_J,
    MU,
    OWN,
    REMEMBERS,
    SHARE,
    add_energy,
    add_gradient,
    add_projected,
    deform,
    deviatoric_stress,
    exact_hessian,
    isotropic,
    projected_tangent,
    work,
)
from sim_core.energies.neo_hookean_rest import GelStep, as_tensors, by_rest
from sim_core.energies.term import Buffers, Internals, StepContext
from sim_core.errors import ConfigError, nearest_match
from sim_core.geometry import tet10
from sim_core.kernels import BoundKernel

_COMPONENTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))

_OWN_STIFFNESS = 6.0
"""How far the bulk modulus acts point by point, over mu; chosen by measurement, see the module text."""


class NeoHookean:
    """A solid body of quadratic tetrahedra as a term of the incremental potential.

    Parameters: ``E_pa`` [Pa], ``nu`` [-], ``relaxation_g`` (share of the deviatoric stress that fades, 0 to
    below 1, default 0), ``relaxation_tau_s`` [s], ``stiffness_damping_s`` (beta [s], default 0). Internal variable
    ``Q``: the relaxing part of the second Piola-Kirchhoff stress [Pa], ``(m, 4, 6)``, components 11 22 33 23 13 12;
    zero while g = 0.
    """

    mirrored = False

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
        self._whole_weight = det * weights
        self._weight = self._whole_weight.copy()
        self._constants = np.zeros(5)
        self._constants[SHARE] = 1.0
        self._history, self._fading = np.zeros((4 * m, 7)), np.zeros((4 * m, 6))
        self._g, self._tau, self._blend = 0.0, 1.0, 1.0
        self._damping, self._bulk, self._constant = 0.0, 0.0, 0.0
        self._isotropic_known = False
        self._seen = np.full((0, 3), np.nan)

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
        mesh = self._rest, self._tets, self._grad, self._weight, self._constants
        state = deformation, dilatation, self._history
        self._seen = np.full_like(buffers.x, np.nan)
        self._deform = BoundKernel(deform, buffers.x, *mesh, deformation, dilatation)
        self._deform_stored = BoundKernel(deform, self._positions, *mesh, deformation, dilatation)
        self._stress = np.zeros((4 * m, 6))
        self._deviatoric_stress = BoundKernel(deviatoric_stress, deformation, self._constants, self._stress)
        self._energy = BoundKernel(add_energy, *state, self._weight, self._constants, buffers.energy)
        self._gradient = BoundKernel(
            add_gradient, *state, self._tets, self._grad, self._weight, self._constants, buffers.gradient
        )
        self._along, self._work_of = np.zeros_like(buffers.x), np.zeros(m)
        self._work = BoundKernel(
            work, *state, self._tets, self._grad, self._weight, self._constants, self._along, self._work_of
        )
        places = _places(slots.reshape(m, 10, 10, 3, 3), len(buffers.hessian) - 1)
        tangent, local = np.zeros((4 * m, 9, 9)), np.zeros(900)
        solid = self._grad, self._weight, self._constants
        self._projected_tangent = BoundKernel(projected_tangent, *state, self._constants, np.zeros((9, 10)), tangent)
        self._add_projected = BoundKernel(
            add_projected,
            *(tangent, deformation, *solid, places),
            *(np.zeros((30, 36)), np.zeros(30), local, buffers.hessian),
        )
        kept_part = np.zeros((m, 55))
        self._isotropic = BoundKernel(isotropic, self._history, *solid, kept_part)
        self._add_exact = BoundKernel(
            exact_hessian,
            *(deformation, dilatation, self._history, *solid, kept_part, places, np.zeros((5, 30)), buffers.hessian),
        )
        self._isotropic_known = False

    def scale(self, factors: np.ndarray) -> None:
        """Let each element have ``factors`` ``(m,)`` times the modulus that is configured: all of its energy, relaxing
        and damping parts included, is linear in it."""
        self._weight[:] = self._whole_weight * factors[:, None]
        self._isotropic_known = False

    def configure(self, parameters: Mapping[str, float]) -> None:
        """Take ``E_pa``, ``nu`` and, if the gel relaxes or is damped, the other parameters."""
        values = {"relaxation_g": 0.0, "relaxation_tau_s": 1.0, "stiffness_damping_s": 0.0, **parameters}
        known = ("E_pa", "nu", "relaxation_g", "relaxation_tau_s", "stiffness_damping_s")
        for name in values:
            if name not in known:
                raise ConfigError(f"{self.name} has no parameter {name!r}.", nearest_match(name, known))
        for name in known:
            if name not in values:
                raise ConfigError(f"{self.name} needs the parameter {name!r}.", "Add it to the material.")
        e_pa, nu = values["E_pa"], values["nu"]
        g, tau = values["relaxation_g"], values["relaxation_tau_s"]
        for name, value, low, high in (
            ("E_pa", e_pa, 0.0, np.inf),
            ("nu", nu, -1.0, 0.5),
            ("relaxation_tau_s", tau, 0.0, np.inf),
        ):
            if not low < value < high:
                raise ConfigError(f"{self.name}: {name} = {value} is not between {low} and {high}.")
        if not 0.0 <= g < 1.0:
            raise ConfigError(f"{self.name}: relaxation_g = {g} is not in [0, 1).")
        mu, lam = e_pa / 2.0 / (1.0 + nu), e_pa * nu / (1.0 + nu) / (1.0 - 2.0 * nu)
        self._constants[MU] = mu
        bulk = lam + 2.0 * mu / 3.0
        self._constants[BULK] = bulk
        self._constants[OWN] = _OWN_STIFFNESS * mu / (bulk + _OWN_STIFFNESS * mu)
        self._constants[SHARE] = 1.0
        self._g, self._tau = g, tau
        self._damping, self._bulk = values["stiffness_damping_s"], bulk
        self._constants[REMEMBERS] = float(self._remembers)
        self._constant = 0.0
        if not self._remembers:
            self._history[:] = 0.0
        self._isotropic_known = False
        self._seen[:] = np.nan

    @property
    def _remembers(self) -> bool:
        return self._g > 0.0 or self._damping > 0.0

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        """Freeze the memory stress H_n of the step, and what rates are measured from."""
        if not self._remembers:
            return
        self._isotropic_known = False
        ratio = step.dt / self._tau
        fade, self._blend = np.exp(-ratio), -np.expm1(-ratio) / ratio
        self._constants[SHARE] = 1.0 - self._g + self._blend * self._g
        self._fading[:] = fade * internals["Q"].reshape(-1, 6)
        if self._g > 0.0:
            self._fading -= self._blend * self._g * self._stress_at(step.x_start)
        self._history[:, :6], self._history[:, 6] = self._fading, 0.0
        if self._damping > 0.0:
            rate = self._damping / step.tau
            self._constants[SHARE] += rate
            self._constants[BULK] = (1.0 + rate) * self._bulk
            base = -rate * step.base(self._stress_and_dilatation_at)
            base[:, 6] *= self._bulk
            self._constant = -self._damping_energy(step.x_start, rate, base)
            self._history += base

    def _measure(self) -> None:
        """Bring strains up to date with the positions."""
        if not np.array_equal(self._seen, self._x):
            self._deform()
            self._seen[:] = self._x

    def _damping_energy(self, x: np.ndarray, rate: float, history: np.ndarray) -> float:
        """Energy [J] at ``x`` [m] of the damping alone."""
        kept, total = (self._constants.copy(), self._history.copy()), float(self._buffers.energy[0])
        self._constants[SHARE], self._constants[BULK] = rate, rate * self._bulk
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

    def work(self, along: np.ndarray, internals: Internals) -> np.ndarray:
        """Work of each element's forces dE/dx along nodal vectors ``(n, 3)``, ``(m,)``."""
        del internals
        self._measure()
        self._along[:] = along
        self._work()
        return np.array(self._work_of)

    def by_rest(self, along: np.ndarray, kept: np.ndarray, step: StepContext) -> np.ndarray:
        """What the derivative by the shape at rest of the work of the forces along nodal vectors ``(n, 3)``, and of the
        product of the new internal variables, flattened, with ``kept``, is made of at the quadrature points,
        ``(m, 4, 3, 3)`` (:mod:`sim_core.energies.neo_hookean_rest`)."""
        shape, grad = (len(self._tets), 4, 3, 3), self._grad.reshape(len(self._tets), 4, 10, 3)

        def deformation(x: np.ndarray) -> np.ndarray:
            return np.asarray(np.eye(3) + self._displacement_gradients(x).reshape(shape))

        fresh, rate = (self._blend * self._g, self._damping / step.tau) if self._remembers else (0.0, 0.0)
        earlier = []
        if self._remembers:
            now, before = step.weights
            earlier = [(deformation(step.x_start), -fresh - now * rate, -now * rate * self._bulk)]
            if step.x_past is not None and rate > 0.0:
                earlier.append((deformation(step.x_past), -before * rate, -before * rate * self._bulk))
        history = self._history.reshape(len(self._tets), 4, 7)
        memory = as_tensors(history[..., :6]), history[..., 6]
        mu, share, bulk, own = (float(self._constants[k]) for k in (MU, SHARE, BULK, OWN))
        known = GelStep(self._weight, deformation(self._x), *memory, mu, share, bulk, own, tuple(earlier), fresh)
        slope = np.einsum("mai,mqaj->mqij", along[self._tets], grad)
        weights = as_tensors(kept.reshape(len(self._tets), 4, 6), 0.5) if fresh > 0.0 else None
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
        if self._g == 0.0:
            return internals
        q = self._fading + self._blend * self._g * self._stress_at(self._x)
        return {"Q": q.reshape(-1, 4, 6)}

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised | None:
        """Derivatives by the start of the step and of the one before, and by the stress that relaxes."""
        del after
        if not self._remembers:
            return None
        count, whole = len(self._grad), self._x.size
        axes = np.repeat(axes_of(self._tets), 4, axis=0)
        f = np.eye(3) + self._displacement_gradients(self._x)
        push = self._weight.reshape(-1, 1, 1) * np.stack(
            [_symmetric(f, self._grad, *pair) for pair in _COMPONENTS], axis=-1
        )
        fade, fresh = np.exp(-step.dt / self._tau), self._blend * self._g
        rate, (now, before) = self._damping / step.tau, step.weights
        start = self._stress_derivatives(step.x_start)
        by_start = [(-(fresh + now * rate) * push @ start, axes, axes)]
        past = None
        if rate > 0.0:
            by_start.append(self._pressure_blocks(step.x_start, -now * rate))
        if rate > 0.0 and step.x_past is not None:
            sheared = -before * rate * push @ self._stress_derivatives(step.x_past)
            pressed = self._pressure_blocks(step.x_past, -before * rate)
            past = placed((sheared, axes, axes), pressed, shape=(whole, whole))
        found = Linearised(force_start=placed(*by_start, shape=(whole, whole)), force_past=past)
        if self._g == 0.0:
            return found
        size = internals["Q"].size
        q = np.arange(size).reshape(count, 6)
        return replace(
            found,
            numbers=self._by_relaxation(step, internals),
            force_memory=placed((fade * push, axes, q), shape=(whole, size)),
            memory_start=placed((-fresh * start, q, axes), shape=(size, whole)),
            memory_memory=placed((np.full((size, 1, 1), fade), q.reshape(-1, 1), q.reshape(-1, 1)), shape=(size, size)),
            memory_end=placed((fresh * self._stress_derivatives(self._x), q, axes), shape=(size, whole)),
        )

    def _by_relaxation(self, step: StepContext, internals: Internals) -> dict[str, ByNumber]:
        """Derivatives by g and tau. Force and memory are linear in the share of S_dev and in H, so their derivatives
        are what the derivatives of these two exert."""
        ratio, g, b = step.dt / self._tau, self._g, self._blend
        fade = np.exp(-ratio)
        fading, slower = fade * ratio / self._tau, (b - fade) / self._tau  # of fade and b by tau
        q = internals["Q"].reshape(-1, 6)
        start, end = self._stress_at(step.x_start).copy(), self._stress_at(self._x).copy()
        kept = self._constants.copy(), self._history.copy()
        gradient, found = self._buffers.gradient, {}
        changes = {
            "relaxation_g": (b - 1.0, -b * start, b * end),
            "relaxation_tau_s": (slower * g, fading * q - slower * g * start, slower * g * end),
        }
        for name, (share, stress, fresh) in changes.items():
            self._constants[SHARE], self._constants[BULK] = share, 0.0
            self._history[:, :6], self._history[:, 6] = stress, 0.0
            gradient[:] = 0.0
            self.add_gradient()
            found[name] = ByNumber(gradient.ravel().copy(), (stress + fresh).ravel(), np.zeros(3))
        self._constants[:], self._history[:] = kept
        return found

    def _pressure_blocks(self, x: np.ndarray, weight: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivative by other positions ``x`` of the force that a memory of pressure, ``weight`` K (J - 1) there,
        exerts at those at hand: blocks of the elements, and where they are."""
        share, axes = self._constants[OWN], axes_of(self._tets)
        here, there = (self._volume_derivatives(at) for at in (self._x, x))
        w = self._weight[:, :, None]
        mean = (w * there).sum(axis=1, keepdims=True) / w.sum(axis=1, keepdims=True)
        mixed = share * there + (1.0 - share) * mean
        return weight * self._bulk * np.einsum("eqi,eqj->eij", w * here, mixed), axes, axes

    def _volume_derivatives(self, x: np.ndarray) -> np.ndarray:
        """Derivative of J at all points by the nodes of their elements [1/m], ``(m, 4, 30)``."""
        p, q = [1, 2, 0], [2, 0, 1]
        f = np.eye(3) + self._displacement_gradients(x)
        cof = f[:, p][:, :, p] * f[:, q][:, :, q] - f[:, p][:, :, q] * f[:, q][:, :, p]
        return np.asarray(np.einsum("pij,paj->pai", cof, self._grad).reshape(len(self._tets), 4, 30))

    def _displacement_gradients(self, x: np.ndarray) -> np.ndarray:
        """F - 1 at all points, ``(4 m, 3, 3)``."""
        moved = np.repeat((x - self._rest)[self._tets], 4, axis=0)
        return np.asarray(np.einsum("pai,paj->pij", moved, self._grad))

    def _stress_derivatives(self, x: np.ndarray) -> np.ndarray:
        """Derivative of S_dev by the nodes of each point's element [Pa/m], ``(4 m, 6, 30)``."""
        mu = self._constants[MU]

        def stress(g: np.ndarray) -> tuple[np.ndarray]:
            p, q = [1, 2, 0], [2, 0, 1]
            f = np.eye(3) + g
            cof = f[..., p, :][..., p] * f[..., q, :][..., q] - f[..., p, :][..., q] * f[..., q, :][..., p]
            j = (f[..., 0, :] * cof[..., 0, :]).sum(axis=-1)
            factor = mu * ((j - 1.0) / 3.0 - 1.0) / np.where(j.real > HISTORY_J, j, HISTORY_J)
            s = mu * np.eye(3) + factor[..., None, None] * (np.swapaxes(cof, -1, -2) @ cof)
            return (np.stack([s[..., i, j] for i, j in _COMPONENTS], axis=-1),)

        ((by_gradient,),) = complex_step(stress, self._displacement_gradients(x))
        return np.asarray(np.einsum("pkij,paj->pkai", by_gradient, self._grad).reshape(len(self._grad), 6, 30))

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


def _symmetric(f: np.ndarray, grad: np.ndarray, i: int, j: int) -> np.ndarray:
    """Nodal forces of F H per weight for a unit component ij (and ji) of H, ``(4 m, 30)``."""
    out = f[:, None, :, i] * grad[:, :, j, None]
    if i != j:
        out = out + f[:, None, :, j] * grad[:, :, i, None]
    return np.asarray(out.reshape(len(grad), 30))


def _places(slots: np.ndarray, nowhere: int) -> np.ndarray:
    """Place of each entry of each block a <= b of the elements, -1 where there is none: int32 ``(m, 495)``.

    ``slots``: of all ordered pairs, ``(m, 10, 10, 3, 3)``; an entry has its place in one of the two orders.
    """
    mirrored = slots.transpose(0, 2, 1, 4, 3)
    a, b = np.triu_indices(10)
    both = np.where(slots == nowhere, mirrored, slots)[:, a, b]
    below = np.tril(np.ones((3, 3), dtype=bool), -1) & (a == b)[:, None, None]
    return np.ascontiguousarray(np.where((both == nowhere) | below, -1, both).reshape(len(slots), -1), dtype=np.int32)
