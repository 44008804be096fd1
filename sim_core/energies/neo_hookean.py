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

import numpy as np
import taichi as ti

from sim_core.energies.projection import negative_modes
from sim_core.energies.term import Buffers, Internals, StepContext
from sim_core.errors import ConfigError, nearest_match
from sim_core.geometry import tet10
from sim_core.kernels import F1, F2, F3, I1, I2, BoundKernel, mat3, vec3

_HISTORY_J = 0.1
"""S_dev grows like 1/J; the memory of a point crushed below this J is taken as if it were at this J."""

_OWN_STIFFNESS = 6.0
"""How far the bulk modulus acts point by point, over mu; chosen by measurement, see the module text."""

# Places in the array of constants that the kernels read.
_MU, _BULK, _OWN, _SHARE, _RELAXING, _EXACT = range(6)


@ti.func
def _displacement_gradient(x: ti.template(), rest: ti.template(), tets: ti.template(), grad: ti.template(), p):
    """G = F - 1 at quadrature point ``p``, from displacements so that small strains keep their digits."""
    g = mat3(0.0)
    for a in range(10):
        n = tets[p // 4, a]
        for i in ti.static(range(3)):
            u = x[n, i] - rest[n, i]
            for j in ti.static(range(3)):
                g[i, j] += u * grad[p, a, j]
    return g


@ti.func
def _cofactor(f: mat3):
    c = mat3(0.0)
    for i, j in ti.static(ti.ndrange(3, 3)):
        i1, i2, j1, j2 = ti.static((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3)
        c[i, j] = f[i1, j1] * f[i2, j2] - f[i1, j2] * f[i2, j1]
    return c


@ti.func
def _bilinear(g: mat3):
    """det(1 + G) - 1 - tr G, computed without cancellation."""
    return _cofactor(g).trace() + g.determinant()


@ti.func
def _memory(history: ti.template(), p):
    """H at quadrature point ``p`` from its components 11, 22, 33, 23, 13, 12."""
    return mat3(
        [history[p, 0], history[p, 5], history[p, 4]],
        [history[p, 5], history[p, 1], history[p, 3]],
        [history[p, 4], history[p, 3], history[p, 2]],
    )


@ti.kernel
def _deform(x: F2, rest: F2, tets: I2, grad: F3, weight: F2, constants: F1, deformation: F3, dilatation: F1):
    """G at each quadrature point, and the J - 1 that the bulk modulus sees there."""
    own = constants[_OWN]
    ti.loop_config(serialize=True)
    for e in range(tets.shape[0]):
        mean, whole = 0.0, 0.0
        for q in range(4):
            p = 4 * e + q
            g = _displacement_gradient(x, rest, tets, grad, p)
            for i, j in ti.static(ti.ndrange(3, 3)):
                deformation[p, i, j] = g[i, j]
            dilatation[p] = g.trace() + _bilinear(g)
            mean += weight[e, q] * dilatation[p]
            whole += weight[e, q]
        for q in range(4):
            dilatation[4 * e + q] = own * dilatation[4 * e + q] + (1.0 - own) * mean / whole


@ti.func
def _load(deformation: ti.template(), p):
    g = mat3(0.0)
    for i, j in ti.static(ti.ndrange(3, 3)):
        g[i, j] = deformation[p, i, j]
    return g


@ti.kernel
def _energy(deformation: F3, dilatation: F1, history: F2, weight: F2, constants: F1, out: F1):
    mu, bulk, share = constants[_MU], constants[_BULK], constants[_SHARE]
    ti.loop_config(serialize=True)
    for e in range(weight.shape[0]):
        total = 0.0
        for q in range(4):
            p = 4 * e + q
            g = _load(deformation, p)
            bilinear = _bilinear(g)
            theta = g.trace() + bilinear
            density = share * mu * (0.5 * g.norm_sqr() - bilinear + theta * theta / 6.0)
            density += 0.5 * bulk * dilatation[p] * theta
            if constants[_RELAXING] > 0.0:
                strain = g + g.transpose() + g.transpose() @ g
                density += 0.5 * (_memory(history, p) * strain).sum()
            total += weight[e, q] * density
        out[0] = out[0] + total


@ti.kernel
def _gradient(deformation: F3, dilatation: F1, history: F2, tets: I2, grad: F3, weight: F2, constants: F1, out: F2):
    mu, bulk, share = constants[_MU], constants[_BULK], constants[_SHARE]
    one = ti.Matrix.identity(ti.f64, 3)
    ti.loop_config(serialize=True)
    for p in range(grad.shape[0]):
        g = _load(deformation, p)
        f = one + g
        cof_g = _cofactor(g)
        theta = g.trace() + cof_g.trace() + g.determinant()
        # F - cof F = G + G^T - tr(G) 1 - cof G, which is small when G is.
        stress = share * mu * (g + g.transpose() - g.trace() * one - cof_g)
        stress += (share * mu / 3.0 * theta + bulk * dilatation[p]) * _cofactor(f)
        if constants[_RELAXING] > 0.0:
            stress += f @ _memory(history, p)
        stress *= weight[p // 4, p % 4]
        for a in range(10):
            n = tets[p // 4, a]
            for i in ti.static(range(3)):
                force = stress[i, 0] * grad[p, a, 0] + stress[i, 1] * grad[p, a, 1] + stress[i, 2] * grad[p, a, 2]
                out[n, i] = out[n, i] + force


@ti.kernel
def _tangent(deformation: F3, dilatation: F1, history: F2, constants: F1, modes: F2, out: F3):
    """Second derivative of the energy density by F (row by row) at each quadrature point [Pa].

    alpha 1(x)1 + 1(x)H + f'' dJ(x)dJ + f' d2J, less its negative eigenvalues unless exact.
    """
    mu, bulk, share = constants[_MU], constants[_BULK], constants[_SHARE]
    ti.loop_config(serialize=True)
    for p in range(deformation.shape[0]):
        g = _load(deformation, p)
        f = ti.Matrix.identity(ti.f64, 3) + g
        cof = _cofactor(f)
        alpha = share * mu
        slope = share * mu * ((g.trace() + _bilinear(g)) / 3.0 - 1.0) + bulk * dilatation[p]
        curvature = share * mu / 3.0 + bulk * constants[_OWN]
        memory = mat3(0.0)
        if constants[_RELAXING] > 0.0:
            memory = _memory(history, p)
        for i in range(3):
            for k in range(3):
                # Block (i, k) of d2J is the skew matrix of row m of F, with the sign of (i, k, m).
                m = (6 - i - k) % 3
                turn = slope * (k - i) * (m - i) * (m - k) * 0.5
                same = ti.select(i == k, 1.0, 0.0)
                for j, n in ti.static(ti.ndrange(3, 3)):
                    value = curvature * cof[i, j] * cof[k, n] + same * memory[j, n]
                    if ti.static(j == n):
                        value += same * alpha
                    else:
                        value += turn * ti.static((n - j) * (3 - n - 2 * j) * (3 - 2 * n - j) // 2) * f[m, 3 - j - n]
                    out[p, 3 * i + j, 3 * k + n] = value
        if constants[_EXACT] == 0.0:
            negative_modes(modes, f, alpha, slope, curvature, memory, constants[_RELAXING] > 0.0)
            for m in range(9):
                if modes[m, 9] < 0.0:
                    mode = ti.Vector.zero(ti.f64, 9)
                    for c in ti.static(range(9)):
                        mode[c] = modes[m, c]
                    for r in range(9):
                        factor = modes[m, 9] * modes[m, r]
                        for c in ti.static(range(9)):
                            out[p, r, c] = out[p, r, c] - factor * mode[c]


@ti.kernel
def _assemble(
    tangent: F3,
    deformation: F3,
    grad: F3,
    weight: F2,
    constants: F1,
    first: I1,
    place: I2,
    columns: F2,
    volume: F1,
    local: F1,
    out: F1,
):
    """Add w B^T tangent B of each element, and of its mean dilatation, to the kept entries."""
    ti.loop_config(serialize=True)
    for e in range(weight.shape[0]):
        for q in range(4):
            p = 4 * e + q
            for r in range(9):
                row = ti.Vector.zero(ti.f64, 9)
                for c in ti.static(range(9)):
                    row[c] = weight[e, q] * tangent[p, r, c]
                for b in range(10):
                    b0, b1, b2 = grad[p, b, 0], grad[p, b, 1], grad[p, b, 2]
                    for k in ti.static(range(3)):
                        columns[3 * b + k, 9 * q + r] = row[3 * k] * b0 + row[3 * k + 1] * b1 + row[3 * k + 2] * b2
        for c in range(30):
            volume[c] = 0.0
        whole = 0.0
        for q in range(4):
            p = 4 * e + q
            cof = _cofactor(ti.Matrix.identity(ti.f64, 3) + _load(deformation, p)) * weight[e, q]
            whole += weight[e, q]
            for a in range(10):
                for i in ti.static(range(3)):
                    v = cof[i, 0] * grad[p, a, 0] + cof[i, 1] * grad[p, a, 1] + cof[i, 2] * grad[p, a, 2]
                    volume[3 * a + i] = volume[3 * a + i] + v
        stiffness = (1.0 - constants[_OWN]) * constants[_BULK] / whole
        for a in range(10):
            ga = ti.Matrix.zero(ti.f64, 4, 3)
            for q, j in ti.static(ti.ndrange(4, 3)):
                ga[q, j] = grad[4 * e + q, a, j]
            va = stiffness * vec3(volume[3 * a], volume[3 * a + 1], volume[3 * a + 2])
            for c in range(3 * a, 30):
                entry = va * volume[c]
                for q in ti.static(range(4)):
                    for i, j in ti.static(ti.ndrange(3, 3)):
                        entry[i] += ga[q, j] * columns[c, 9 * q + 3 * i + j]
                for i in ti.static(range(3)):
                    local[30 * (3 * a + i) + c] = entry[i]
        for k in range(first[e], first[e + 1]):
            out[place[k, 0]] = out[place[k, 0]] + local[place[k, 1]]


@ti.kernel
def _deviatoric_stress(deformation: F3, constants: F1, out: F2):
    """S_dev = mu 1 + (-mu + mu/3 (J - 1)) cof(C) / J."""
    mu = constants[_MU]
    one = ti.Matrix.identity(ti.f64, 3)
    ti.loop_config(serialize=True)
    for p in range(deformation.shape[0]):
        g = _load(deformation, p)
        theta = g.trace() + _bilinear(g)
        f = one + g
        cof = _cofactor(f)
        factor = mu * (theta / 3.0 - 1.0) / ti.max(1.0 + theta, _HISTORY_J)
        s = mu * one + factor * (cof.transpose() @ cof)
        for k, i, j in ti.static(((0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 1, 2), (4, 0, 2), (5, 0, 1))):
            out[p, k] = s[i, j]


class NeoHookean:
    """A solid body of quadratic tetrahedra as a term of the incremental potential.

    Parameters: ``E_pa`` [Pa], ``nu`` [-], ``relaxation_g`` (share of the deviatoric stress that fades, 0 to
    below 1, default 0), ``relaxation_tau_s`` [s]. Internal variable ``Q``: the relaxing part of the second
    Piola-Kirchhoff stress [Pa], ``(m, 4, 6)``, components 11 22 33 23 13 12; zero while g = 0.
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
        self._weight = np.ascontiguousarray(det * weights)
        self._constants = np.zeros(6)
        self._constants[_SHARE] = 1.0
        self._history = np.zeros((4 * m, 6))
        self._start_stress = np.zeros((4 * m, 6))
        self._g, self._tau, self._blend = 0.0, 1.0, 1.0

    def blocks(self) -> np.ndarray:
        """Return all ordered pairs of the ten nodes of each element, ``(100 m, 2)``."""
        i = np.repeat(self._tets, 10, axis=1).ravel()
        j = np.tile(self._tets, (1, 10)).ravel()
        return np.column_stack([i, j])

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        """Prepare the kernels for these arrays; keep only the entries that have a place."""
        m = len(self._tets)
        self._x = buffers.x
        self._positions = np.zeros_like(buffers.x)
        deformation, dilatation = np.zeros((4 * m, 3, 3)), np.zeros(4 * m)
        mesh = self._rest, self._tets, self._grad, self._weight, self._constants
        state = deformation, dilatation, self._history
        self._deform = BoundKernel(_deform, buffers.x, *mesh, deformation, dilatation)
        self._deform_stored = BoundKernel(_deform, self._positions, *mesh, deformation, dilatation)
        self._stress = np.zeros((4 * m, 6))
        self._deviatoric_stress = BoundKernel(_deviatoric_stress, deformation, self._constants, self._stress)
        self._energy = BoundKernel(_energy, *state, self._weight, self._constants, buffers.energy)
        self._gradient = BoundKernel(
            _gradient, *state, self._tets, self._grad, self._weight, self._constants, buffers.gradient
        )
        # Entry (i, k) of block (a, b) is read from the upper triangle of the element matrix.
        row, column = np.divmod(np.arange(900), 30)
        a, b, i, k = (
            g.ravel() for g in np.meshgrid(np.arange(10), np.arange(10), np.arange(3), np.arange(3), indexing="ij")
        )
        row, column = 3 * a + i, 3 * b + k
        local = 30 * np.minimum(row, column) + np.maximum(row, column)
        slot = np.ascontiguousarray(slots).reshape(m, 900)
        kept = slot != len(buffers.hessian) - 1
        first = np.concatenate([[0], np.cumsum(kept.sum(axis=1))]).astype(np.int32)
        place = np.column_stack([slot[kept], np.broadcast_to(local, slot.shape)[kept]]).astype(np.int32)
        tangent = np.zeros((4 * m, 9, 9))
        self._tangent = BoundKernel(_tangent, *state, self._constants, np.zeros((9, 10)), tangent)
        self._assemble = BoundKernel(
            _assemble,
            *(
                tangent,
                deformation,
                self._grad,
                self._weight,
                self._constants,
                first,
                np.ascontiguousarray(place),
            ),
            *(np.zeros((30, 36)), np.zeros(30), np.zeros(900)),
            buffers.hessian,
        )

    def configure(self, parameters: Mapping[str, float]) -> None:
        """Take ``E_pa``, ``nu`` and, if the gel relaxes, ``relaxation_g`` and ``relaxation_tau_s``."""
        values = {"relaxation_g": 0.0, "relaxation_tau_s": 1.0, **parameters}
        known = ("E_pa", "nu", "relaxation_g", "relaxation_tau_s")
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
        self._constants[_MU] = mu
        bulk = lam + 2.0 * mu / 3.0
        self._constants[_BULK] = bulk
        self._constants[_OWN] = _OWN_STIFFNESS * mu / (bulk + _OWN_STIFFNESS * mu)
        self._constants[_RELAXING] = float(g > 0.0)
        self._constants[_SHARE] = 1.0
        self._g, self._tau = g, tau

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        """Freeze the memory stress H_n of the step."""
        if self._g == 0.0:
            return
        ratio = step.dt / self._tau
        fade, self._blend = np.exp(-ratio), -np.expm1(-ratio) / ratio
        self._constants[_SHARE] = 1.0 - self._g + self._blend * self._g
        self._start_stress[:] = self._stress_at(step.x_start)
        self._history[:] = fade * internals["Q"].reshape(-1, 6) - self._blend * self._g * self._start_stress

    def add_energy(self) -> None:
        """Add the incremental energy [J]."""
        self._deform()
        self._energy()

    def add_gradient(self) -> None:
        """Add dE/dx [N]."""
        self._deform()
        self._gradient()

    def add_hessian(self, exact: bool) -> None:
        """Add d2E/dx2 [N/m], each quadrature point made positive semidefinite unless ``exact``."""
        self._constants[_EXACT] = float(exact)
        self._deform()
        self._tangent()
        self._assemble()

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        """Return Q_{n+1} = H_n + b g S_dev(F_{n+1})."""
        if self._g == 0.0:
            return internals
        q = self._history + self._blend * self._g * self._stress_at(self._x)
        return {"Q": q.reshape(-1, 4, 6)}

    def initial_internals(self) -> Internals:
        """Return Q = 0."""
        return {"Q": np.zeros((len(self._tets), 4, 6))}

    def _stress_at(self, x: np.ndarray) -> np.ndarray:
        """S_dev [Pa] at positions ``x`` [m], ``(4 m, 6)``; valid until the next call."""
        self._positions[:] = x
        self._deform_stored()
        self._deviatoric_stress()
        return self._stress
