"""The neo-Hookean solid: derivatives, moduli that come back, locking."""

import numpy as np
import pytest
import scipy.sparse as sp
from potentials import Look
from scipy.sparse.linalg import splu

from sim_core.energies.neo_hookean import NeoHookean
from sim_core.errors import ConfigError
from sim_core.geometry import solids
from sim_core.solve.system import System

ELASTIC = {"E_pa": 1e5, "nu": 0.45}
DAMPED = {**ELASTIC, "stiffness_damping_s": 0.02}


class Body:
    """One solid with a static Newton solver."""

    def __init__(self, mesh, parameters):
        self.mesh, self.n = mesh, len(mesh.nodes)
        self.term = NeoHookean("gel", mesh.tets, mesh.nodes)
        self.term.configure(parameters)
        free, none = np.zeros((self.n, 3), dtype=bool), sp.csr_matrix((self.n, self.n))
        self.look = Look(System(mesh.nodes, none, free, [self.term], np.zeros(3), inertia=False))

    def at(self, x, exact=True):
        self.look.x[:] = x
        return self.look.at(exact)

    def energy(self, x):
        return self.at(x).energy

    def gradient(self, x):
        return self.at(x).gradient

    def hessian(self, x, exact=True):
        return self.at(x, exact).hessian.tocsc()

    def solve(self, x, free, exact=True):
        """Newton with a halving line search for the free degrees of freedom of ``x``."""
        x = x.copy()
        for _ in range(60):
            gradient = self.gradient(x).ravel()[free]
            step = np.zeros(3 * self.n)
            step[free] = -splu(self.hessian(x, exact)[free][:, free]).solve(gradient)
            scale, before = 1.0, self.energy(x)
            while self.energy(x + scale * step.reshape(-1, 3)) > before + 1e-12 * abs(before) and scale > 1e-6:
                scale *= 0.5
            x += scale * step.reshape(-1, 3)
            if np.abs(step).max() < 1e-13 * np.ptp(self.mesh.nodes):
                return x
        raise AssertionError("the static solve did not converge")


def irregular_block(size=(0.01, 0.01, 0.01), cells=(2, 2, 2), jitter=0.12, seed=0):
    """A block whose nodes are moved at random inside the body and along its faces."""
    mesh = solids.block(size, cells)
    rng = np.random.default_rng(seed)
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    inner = (mesh.nodes > low + 1e-9) & (mesh.nodes < high - 1e-9)
    nodes = mesh.nodes + jitter * np.divide(size, cells) * inner * rng.uniform(-1.0, 1.0, mesh.nodes.shape)
    for tet in mesh.tets:
        for k, (i, j) in enumerate(((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))):
            nodes[tet[4 + k]] = (nodes[tet[i]] + nodes[tet[j]]) / 2.0
    return solids.TetMesh(nodes, mesh.tets, mesh.surface, mesh.face_sets)


def lame(parameters):
    e, nu = parameters["E_pa"], parameters["nu"]
    return e / 2.0 / (1.0 + nu), e * nu / (1.0 + nu) / (1.0 - 2.0 * nu)


def dofs(nodes, *components):
    return np.concatenate([3 * np.asarray(nodes, dtype=int) + c for c in components])


def others(body, fixed):
    return np.setdiff1d(np.arange(3 * body.n), fixed)


def stretched(parameters, stretch, mesh=None):
    """Uniaxial test on an irregular block: nominal stress [Pa] and lateral stretch."""
    mesh = irregular_block() if mesh is None else mesh
    body, sets = Body(mesh, parameters), mesh.node_sets
    fixed = np.concatenate(
        [dofs(sets["x_min"], 0), dofs(sets["y_min"], 1), dofs(sets["bottom"], 2), dofs(sets["top"], 2)]
    )
    x = mesh.nodes.copy()
    low = x.min(axis=0)
    side = 1.0 - parameters["nu"] * (stretch - 1.0)
    x = low + (x - low) * [side, side, stretch]
    x = body.solve(x, others(body, fixed))
    force = body.gradient(x)[sets["top"], 2].sum()
    width = np.ptp(mesh.nodes[:, 0]) * np.ptp(mesh.nodes[:, 1])
    lateral = (x[sets["x_max"], 0] - low[0]) / np.ptp(mesh.nodes[:, 0])
    assert np.ptp(lateral) < 1e-10
    return force / width, lateral.mean()


# ---------------------------------------------------------------------------------- derivatives


def difference(function, h):
    """Central difference at 0, Richardson-extrapolated to fourth order."""
    coarse, fine = ((function(k * h) - function(-k * h)) / (2.0 * k * h) for k in (2.0, 1.0))
    return (4.0 * fine - coarse) / 3.0


def deformed(mesh, kind, rng):
    """Positions near rest, moderately deformed, or with most elements inverted."""
    scatter = {"small": 1e-7, "moderate": 2e-4, "inverted": 5e-3}[kind]
    return mesh.nodes + scatter * rng.normal(size=mesh.nodes.shape)


def loaded(parameters, mesh, rng):
    """A body in the middle of a step, with rates that are not aligned with anything."""
    body = Body(mesh, parameters)
    if "stiffness_damping_s" in parameters:
        start = deformed(mesh, "moderate", rng)
        body.look.begin(start, dt=0.02)
    return body


@pytest.mark.parametrize("parameters", [ELASTIC, DAMPED], ids=["elastic", "damped"])
@pytest.mark.parametrize("kind", ["small", "moderate", "inverted"])
def test_gradient_and_hessian_against_differences(parameters, kind):
    rng = np.random.default_rng(1)
    mesh = solids.dome(0.0075, 0.00375, (1, 1, 1))
    body = loaded(parameters, mesh, rng)
    x = deformed(mesh, kind, rng)
    if kind == "inverted":
        f = np.einsum("pai,paj->pij", x[np.repeat(mesh.tets, 4, axis=0)], body.term._grad)
        assert np.mean(np.linalg.det(f) < 0.0) > 0.3
    d = rng.normal(size=x.shape)
    h = 1e-7
    gradient, hessian = body.gradient(x), body.hessian(x)
    slope = difference(lambda t: body.energy(x + t * d), h)
    assert abs(slope - np.sum(gradient * d)) < 1e-7 * abs(slope)
    curve = difference(lambda t: body.gradient(x + t * d), h).ravel()
    assert np.linalg.norm(curve - hessian @ d.ravel()) < 1e-8 * np.linalg.norm(curve)


@pytest.mark.parametrize("parameters", [ELASTIC, DAMPED], ids=["elastic", "damped"])
@pytest.mark.parametrize("kind", ["small", "moderate", "inverted"])
def test_projected_hessian_is_positive_semidefinite(parameters, kind):
    rng = np.random.default_rng(2)
    mesh = solids.dome(0.0075, 0.00375, (1, 1, 1))
    body = loaded(parameters, mesh, rng)
    for _ in range(5):
        x = deformed(mesh, kind, rng)
        exact = np.linalg.eigvalsh(body.hessian(x).toarray())
        projected = np.linalg.eigvalsh(body.hessian(x, exact=False).toarray())
        assert projected[0] > -1e-13 * projected[-1]
    if kind != "small":
        assert exact[0] < -1e-4 * exact[-1]


def test_projection_changes_nothing_where_the_hessian_is_already_positive():
    """Uniform expansion: no direction of negative curvature at any quadrature point."""
    for parameters in (ELASTIC, DAMPED):
        body = Body(irregular_block(), parameters)
        x = 1.05 * body.mesh.nodes
        body.look.begin(x, dt=0.02)
        exact, projected = body.hessian(x), body.hessian(x, exact=False)
        assert abs(exact - projected).max() < 1e-12 * abs(exact).max()


def test_projection_of_degenerate_deformations():
    """Flattened, collapsed to a line, to a point, mirrored: finite and positive semidefinite."""
    mesh = solids.block((0.01, 0.01, 0.01), (1, 1, 1))
    for parameters in (ELASTIC, DAMPED):
        body = loaded(parameters, mesh, np.random.default_rng(6))
        for diagonal in ([1, 1, 0], [1, 0, 0], [0, 0, 0], [1, 1, -1], [-1, -1, -1], [2, 2, 0.5]):
            values = np.linalg.eigvalsh(body.hessian(mesh.nodes * diagonal, exact=False).toarray())
            assert values[0] > -1e-12 * values[-1]


@pytest.mark.parametrize("parameters", [ELASTIC, DAMPED], ids=["elastic", "damped"])
def test_rigid_motion_leaves_energy_and_turns_forces(parameters):
    rng = np.random.default_rng(5)
    mesh = solids.dome(0.0075, 0.00375, (2, 1, 1))
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    shift = np.array([0.3, -0.2, 0.1])
    body = loaded(parameters, mesh, rng)
    x = deformed(mesh, "moderate", rng)
    y = x @ rotation.T + shift
    assert body.energy(y) == pytest.approx(body.energy(x), rel=1e-11)
    force = body.gradient(x)
    assert np.abs(body.gradient(y) - force @ rotation.T).max() < 1e-10 * np.abs(force).max()
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * np.abs(force).sum()
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-12 * np.abs(np.cross(x, force)).sum()
    # A moved body at rest stays at rest.
    free = Body(mesh, parameters)
    rest = mesh.nodes @ rotation.T + shift
    assert free.energy(rest) < 1e-15 * lame(parameters)[0] * solids.volume(mesh)
    assert np.abs(free.gradient(rest)).max() < 1e-8 * np.abs(force).max()


# --------------------------------------------------------------------------------- homogeneous states


def test_patch_of_irregular_elements_reproduces_uniform_strain():
    mesh = irregular_block(jitter=0.2)
    body = Body(mesh, ELASTIC)
    f = np.array([[1.1, 0.2, 0.0], [-0.05, 0.9, 0.1], [0.1, 0.0, 1.05]])
    exact = mesh.nodes @ f.T
    border = np.unique(mesh.surface)
    inner = others(body, dofs(border, 0, 1, 2))
    assert len(inner) >= 30
    force = body.gradient(exact).ravel()
    assert np.abs(force[inner]).max() < 1e-12 * np.abs(force).max()
    start = exact + 2e-4 * np.random.default_rng(0).normal(size=exact.shape)
    start[border] = exact[border]
    assert np.abs(body.solve(start, inner) - exact).max() < 1e-14
    mu, lam = lame(ELASTIC)
    jac = np.linalg.det(f)
    density = mu / 2.0 * (np.sum(f * f) - 3.0) - mu * (jac - 1.0) + (lam + mu) / 2.0 * (jac - 1.0) ** 2
    assert body.energy(exact) == pytest.approx(density * 1e-6, rel=1e-12)


@pytest.mark.parametrize("nu", [-0.2, 0.0, 0.2, 0.3, 0.45, 0.49])
def test_young_modulus_and_poisson_ratio_come_back(nu):
    """A small tensile test reads off E and nu; nu = 0.2 gives +0.2 and not the -0.25 of an auxetic."""
    parameters, strain = {"E_pa": 3e5, "nu": nu}, 1e-7
    stress, lateral = stretched(parameters, 1.0 + strain)
    assert stress / strain == pytest.approx(3e5, rel=1e-6)
    assert -(lateral - 1.0) / strain == pytest.approx(nu, abs=1e-6)


@pytest.mark.parametrize("nu", [0.2, 0.45])
@pytest.mark.parametrize("stretch", [0.6, 0.8, 1.3, 2.0])
def test_large_uniaxial_stretch_against_the_closed_form(nu, stretch):
    """No lateral stress: mu + (Lambda (J - 1) - mu) stretch = 0 with Lambda = lambda + mu."""
    parameters = {"E_pa": 3e5, "nu": nu}
    mu, lam = lame(parameters)
    volume_strain = (mu - mu / stretch) / (lam + mu)
    side = np.sqrt((1.0 + volume_strain) / stretch)
    nominal = mu * stretch + ((lam + mu) * volume_strain - mu) * side**2
    stress, lateral = stretched(parameters, stretch)
    assert stress == pytest.approx(nominal, rel=1e-9)
    assert lateral == pytest.approx(side, rel=1e-9)


def test_nearly_incompressible_stretch_approaches_the_textbook():
    """Incompressible neo-Hookean: nominal stress mu (l - 1/l^2)."""
    parameters = {"E_pa": 3e5, "nu": 0.49999}
    stress, _ = stretched(parameters, 1.5)
    assert stress == pytest.approx(lame(parameters)[0] * (1.5 - 1.5**-2), rel=1e-3)


def test_compression_never_loses_its_force():
    """The force grows down to half the height, where a law without the lambda shift has collapsed."""
    stress = [stretched({"E_pa": 3e5, "nu": 0.2}, s)[0] for s in (0.95, 0.85, 0.75, 0.65, 0.56)]
    assert np.all(np.diff(stress) < 0.0)


def test_simple_shear_stress():
    """P_xz = mu g; the Cauchy normal stress difference s_xx - s_zz = mu g^2."""
    mesh, shear = irregular_block(), 0.4
    body = Body(mesh, ELASTIC)
    mu, _ = lame(ELASTIC)
    x = mesh.nodes.copy()
    x[:, 0] += shear * x[:, 2]
    force = body.gradient(x)
    # Virtual work of uniform fields gives the volume integral of the first Piola-Kirchhoff stress.
    piola = np.einsum("ni,nj->ij", force, mesh.nodes) / 1e-6
    f = np.eye(3) + shear * np.outer([1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    cauchy = piola @ f.T
    assert cauchy[0, 2] == pytest.approx(mu * shear, rel=1e-12)
    assert cauchy[0, 0] - cauchy[2, 2] == pytest.approx(mu * shear**2, rel=1e-12)
    assert piola[0, 2] == pytest.approx(mu * shear, rel=1e-12)


# -------------------------------------------------------------------------------------------- locking


def apparent_modulus(shape_factor, nu, cells):
    """E_a / E of a disc of thickness 1 bonded to two plates, for small compression."""
    radius = 2.0 * shape_factor
    mesh = solids.cylinder(radius, 1.0, cells)
    body = Body(mesh, {"E_pa": 1.0, "nu": nu})
    hessian = body.hessian(mesh.nodes)
    bottom, top = mesh.node_sets["bottom"], mesh.node_sets["top"]
    fixed = np.concatenate([dofs(bottom, 0, 1, 2), dofs(top, 0, 1, 2)])
    free, u = others(body, fixed), np.zeros(3 * body.n)
    u[dofs(top, 2)] = -1.0
    u[free] = splu(hessian[free][:, free]).solve(-(hessian @ u)[free])
    return -(hessian @ u)[dofs(top, 2)].sum() / solids.volume(mesh)


# Axisymmetric 9-node elements, graded into the bonded edge; two resolutions agree to 0.2 %.
BONDED = {
    (1.0, 0.3): 1.2107,
    (1.0, 0.45): 1.9304,
    (1.0, 0.49): 2.6345,
    (2.5, 0.45): 2.8717,
    (2.5, 0.49): 7.0221,
}


@pytest.mark.parametrize(("shape_factor", "nu"), BONDED)
def test_bonded_disc_does_not_lock(shape_factor, nu):
    reference = BONDED[shape_factor, nu]
    error = [apparent_modulus(shape_factor, nu, cells) / reference - 1.0 for cells in ((2, 1, 1), (2, 1, 2), (4, 2, 3))]
    assert abs(error[0]) < 0.40
    assert abs(error[1]) < 0.065
    assert abs(error[2]) < 0.045


def test_bonded_disc_against_gent_and_lindley():
    """E_a = E (1 + 2 S^2) for an incompressible disc; itself an approximation, 1 % high at S = 1."""
    assert apparent_modulus(1.0, 0.4999, (2, 1, 2)) == pytest.approx(3.0, rel=0.08)


# ------------------------------------------------------------------------------------------ parameters


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"E_pa": 1e5, "nu": 0.5}, "nu = 0.5 is not between"),
        ({"E_pa": -1.0, "nu": 0.3}, "E_pa"),
        ({"E_pa": 1e5, "nu": 0.3, "stiffness_dampin_s": 0.1}, "Did you mean 'stiffness_damping_s'"),
        ({"E_pa": 1e5}, "needs the parameter 'nu'"),
    ],
)
def test_bad_parameters_are_refused(parameters, message):
    mesh = solids.block((0.01, 0.01, 0.01), (1, 1, 1))
    with pytest.raises(ConfigError, match=message):
        NeoHookean("gel", mesh.tets, mesh.nodes).configure(parameters)
