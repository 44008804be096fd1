"""What terms know of their numbers along given vectors, element by element, against central differences of the work of
their forces and of their new internal variables, with weights."""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse as sp
from shell_terms import ORTHOTROPIC, PAPER, bending, membrane, strip
from test_neo_hookean import RELAXING, Body, irregular_block

from sim_core.energies.linearised import flatten
from sim_core.energies.mass_damping import MassDamping
from sim_core.energies.neo_hookean_kernels import HISTORY_J
from sim_core.energies.neo_hookean_moduli import MU
from sim_core.energies.term import Buffers, StepContext
from sim_core.solve.integrator import Past, step_context

DAMPING = "stiffness_damping_s"


def step_from(rng: np.random.Generator, x: np.ndarray, past: np.ndarray | None) -> StepContext:
    """A step of 20 ms from ``x``, that looks back to ``past`` or not."""
    earlier = None if past is None else Past(past, np.zeros_like(past), 0.03)
    return step_context(x, rng.normal(size=x.shape), 0.02, earlier)


def slopes(work: Callable[[np.ndarray], float], at: np.ndarray, h: float) -> np.ndarray:
    """Differences by each entry of ``at``; to the side of more where it is zero."""
    out = np.zeros(len(at))
    for k, value in enumerate(at):
        ends = (h, 0.0 if value == 0.0 else -h)
        high, low = (work(np.where(np.arange(len(at)) == k, value + end, at)) for end in ends)
        out[k] = (high - low) / (ends[0] - ends[1])
    return out


def assert_same(found: np.ndarray, differences: np.ndarray, what: str) -> None:
    assert np.abs(differences).max() > 0.0, what
    assert found == pytest.approx(differences, rel=0.0, abs=1e-6 * np.abs(differences).max()), what


@pytest.mark.parametrize("looks_back", [False, True])
@pytest.mark.parametrize("crushed", [False, True])
@pytest.mark.parametrize(
    "numbers",
    [RELAXING | {"nu": 0.3}, RELAXING | {"nu": 0.3, DAMPING: 0.01}, {"E_pa": 1e5, "nu": 0.3, DAMPING: 0.01}],
    ids=["relaxes", "both", "damped"],
)
def test_gel(numbers: dict[str, float], crushed: bool, looks_back: bool) -> None:
    """Of elements with values of their own; crushed: to a twentieth, from inside out."""
    rng = np.random.default_rng(3)
    mesh = irregular_block(cells=(1, 1, 1), jitter=0.0)
    body, count = Body(mesh, numbers), len(mesh.tets)
    term = body.term
    own = {"nu": rng.uniform(-0.5, 0.1, count), "damping": rng.uniform(0.0, 0.02, count)}
    own |= {"share": rng.uniform(0.3, 1.6, count), "tau": rng.uniform(0.4, 2.0, count)}
    x, start, past = (mesh.nodes + 2e-4 * rng.normal(size=mesh.nodes.shape) for _ in range(3))
    if crushed:
        for place in (x, start, past):
            place[:, 2] = 0.05 * mesh.nodes[:, 2] + 0.02 * (place[:, 2] - mesh.nodes[:, 2])
        start[:, 2] *= -1.0
    step = step_from(rng, start, past if looks_back else None)
    before = {"Q": 1e4 * rng.normal(size=(count, 4, 6))}
    relaxes = "relaxation_g" in numbers
    vectors, kept = rng.normal(size=x.shape), 1e-9 * relaxes * rng.normal(size=24 * count)
    term.scale(rng.uniform(0.5, 2.0, count))

    def work(**given: np.ndarray) -> float:
        values = own | given
        term.shift_nu(values["nu"])
        term.shift_damping(values["damping"])
        term.scale_relaxation(values["share"], values["tau"])
        body.buffers.x[:] = x
        term.begin_step(step, before)
        return float(np.vdot(body.gradient(x), vectors) + kept @ term.end_step(step, before)["Q"].ravel())

    total = work()
    along = term.along(vectors, kept, step, before)
    memory = float(kept @ term.end_step(step, before)["Q"].ravel())
    assert along.work().sum() + memory == pytest.approx(total, rel=1e-12)
    found = {"nu": along.by_nu(), "damping": along.by_damping(), "E": along.by_modulus()}
    if relaxes:
        found["share"] = numbers["relaxation_g"] * along.by_relaxation("relaxation_g")
        found["tau"] = numbers["relaxation_tau_s"] * along.by_relaxation("relaxation_tau_s")
    for what in set(found) - {"E"}:
        assert_same(found[what], slopes(lambda v, what=what: work(**{what: v}), own[what], 1e-5), what)
    ends = []
    for factor in (1.001, 0.999):
        term.configure(numbers | {"E_pa": factor * numbers["E_pa"]})
        ends.append(work())
    assert found["E"].sum() == pytest.approx((ends[0] - ends[1]) / (0.002 * numbers["E_pa"]), rel=1e-7)


@pytest.mark.parametrize("looks_back", [False, True])
@pytest.mark.parametrize("damping", [0.0, 0.01])
@pytest.mark.parametrize(
    ("build", "numbers"),
    [
        (membrane, ORTHOTROPIC),
        (bending, ORTHOTROPIC),
        (bending, PAPER | {"yield_curvature_per_m": 40.0, "hardening_ratio": 0.3}),
    ],
    ids=["membrane", "bending", "flow"],
)
def test_sheet(build: Callable[..., tuple], numbers: dict[str, float], damping: float, looks_back: bool) -> None:
    """Of triangles with values of their own, half of which flow if they can."""
    rng = np.random.default_rng(3)
    mesh = strip("irregular", cells=(4, 3))
    count, flows = len(mesh.triangles), "hardening_ratio" in numbers
    system, term = build(mesh, numbers | {DAMPING: damping})
    own = {"nu": rng.uniform(-0.5, 0.1, count), "damping": np.sign(damping) * rng.uniform(0.005, 0.02, count)}
    own |= {"onset": rng.uniform(0.5, 1.5, count), "hardening": rng.uniform(0.5, 1.5, count)}
    x, start, past = (mesh.nodes + 5e-4 * rng.normal(size=mesh.nodes.shape) for _ in range(3))
    step = step_from(rng, start, past if looks_back else None)
    before = term.initial_internals()
    if flows:
        before = {
            "plastic_curvature": 10.0 * rng.normal(size=(count, 3)),
            "accumulated_curvature": rng.uniform(0.0, 20.0, count),
        }
    vectors, kept = rng.normal(size=x.shape), rng.normal(size=4 * count * flows)
    term.scale(rng.uniform(0.5, 2.0, count))

    def work(**given: np.ndarray) -> float:
        values = own | given
        term.shift_nu(values["nu"])
        term.shift_damping(values["damping"])
        if flows:
            term.scale_flow(values["onset"], values["hardening"])
        system.x[:] = x
        term.begin_step(step, before)
        return float(np.vdot(system.gradient_of(term), vectors) + kept @ flatten(term.end_step(step, before)))

    total = work()
    along = term.along(vectors, kept, step, before)
    assert along.work().sum() + kept @ flatten(term.end_step(step, before)) == pytest.approx(total, rel=1e-12)
    found = {"nu": along.by_nu(), "damping": along.by_damping()}
    if flows:
        found["onset"] = numbers["yield_curvature_per_m"] * along.by_yield()
        found["hardening"] = numbers["hardening_ratio"] * along.by_hardening()
    for what, values in found.items():
        assert_same(values, slopes(lambda v, what=what: work(**{what: v}), own[what], 1e-5), what)


@pytest.mark.parametrize("looks_back", [False, True])
@pytest.mark.parametrize("varies", [False, True])
def test_mass_damping(varies: bool, looks_back: bool) -> None:
    """Of nodes of which one is held, and of elements with an alpha of their own or not."""
    rng = np.random.default_rng(0)

    def mass() -> sp.csr_matrix:
        root = rng.normal(size=(6, 6))
        return sp.csr_matrix(root @ root.T)

    term = MassDamping("b.mass_damping", mass(), 2, np.array([1, 1, 0, 1, 1, 1], dtype=bool))
    term.set_unit_mass(mass(), mass() if varies else None)
    buffers = Buffers(rng.normal(size=(9, 3)), np.zeros(1), np.zeros((9, 3)), np.zeros(900))
    term.bind(buffers, np.zeros((len(term.blocks()), 9), dtype=int))
    numbers = {"mass_damping_per_s": 1.3, "density": 2.1}
    term.configure(numbers)
    start, past, vectors = rng.normal(size=(3, 9, 3))
    step = step_from(rng, start, past if looks_back else None)
    along = term.along(vectors, np.zeros(0), step, {})

    def work(given: dict[str, float]) -> float:
        term.configure(given)
        term.begin_step(step, {})
        buffers.gradient[:] = 0.0
        term.add_gradient()
        return float(np.vdot(buffers.gradient, vectors))

    for name, found in (("mass_damping_per_s", along.by_mass_damping()), ("density", along.by_density())):
        high, low = (work(numbers | {name: factor * numbers[name]}) for factor in (1.01, 0.99))
        assert found == pytest.approx((high - low) / (0.02 * numbers[name]), rel=1e-11), name


@pytest.mark.parametrize(("size_m", "digits"), [(1e-10, 1e-10), (1e-7, 1e-13), (4e-3, 1e-13)])
def test_the_stress_of_a_small_strain_keeps_its_digits(size_m: float, digits: float) -> None:
    """Of the relaxing part, mu 1 + mu ((J - 1) / 3 - 1) cof(C) / J, against more digits: a gel that hardly moves has
    the rate of stress that it has. The largest leave points inside out."""
    mesh = irregular_block(cells=(1, 1, 1), jitter=0.0)
    term = Body(mesh, RELAXING).term
    x = mesh.nodes + size_m * np.random.default_rng(3).normal(size=mesh.nodes.shape)
    moved = np.repeat((x - mesh.nodes)[mesh.tets], 4, axis=0).astype(np.longdouble)
    f = np.einsum("pai,paj->pij", moved, term._grad) + np.eye(3, dtype=np.longdouble)
    p, q = [1, 2, 0], [2, 0, 1]
    cof = f[:, p][..., p] * f[:, q][..., q] - f[:, p][..., q] * f[:, q][..., p]
    j = (f[:, 0] * cof[:, 0]).sum(axis=-1)
    factor = ((j - 1) / 3 - 1) / np.maximum(j, np.longdouble(HISTORY_J))
    stress = term._moduli[0, MU] * (np.eye(3) + factor[:, None, None] * (cof.swapaxes(-1, -2) @ cof))
    expected = np.stack([stress[:, a, b] for a, b in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))], axis=-1)
    assert np.abs(term._stress_at(x) - expected).max() < digits * np.abs(expected).max()
