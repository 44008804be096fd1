"""Material laws of gels: forces, Hessian and derivatives by the shape at rest against differences; known answers."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.effects import effect_by_name
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.solid_strain import PAIRS, SolidStrain
from sim_core.energies.strain_law import StrainLaws
from sim_core.energies.term import Buffers, Internals, StepContext
from sim_core.geometry.solids import block
from sim_core.solve.integrator import step_context

MESH = block((0.01, 0.008, 0.004), (1, 1, 1))
YOUNG, NU = 1e5, 0.4
MU = YOUNG / 2.0 / (1.0 + NU)
RNG = np.random.default_rng(0)
NAMES = ["gel_stiffening", "gel_mullins", "viscoelastic_gel"]


def deformed(seed: int) -> np.ndarray:
    """Positions [m] ``(n, 3)`` of a gel that is strained by some 10 %."""
    rng = np.random.default_rng(seed)
    return np.asarray(
        MESH.nodes @ (np.eye(3) + 0.1 * rng.standard_normal((3, 3))).T + 2e-5 * rng.standard_normal(MESH.nodes.shape)
    )


class Gel:
    """One law of a gel, bound to buffers of its own: each block of the Hessian has places of its own."""

    def __init__(self, name: str, rest: np.ndarray, x: np.ndarray) -> None:
        own = NeoHookean("gel.elastic", MESH.tets, rest)
        own.configure({"E_pa": YOUNG, "nu": NU})
        self.measure = SolidStrain(own)
        self.laws, effect = StrainLaws("gel.laws", self.measure), effect_by_name(name)
        self.laws.add(name, effect)
        count = len(self.measure.blocks())
        self.buffers = Buffers(x.copy(), np.zeros(1), np.zeros_like(x), np.zeros(9 * count))
        self.laws.bind(self.buffers, np.arange(9 * count).reshape(-1, 9))
        self.laws.configure(self.laws.numbers({"E_pa": YOUNG, "nu": NU}, {name: effect.example}))
        rng = np.random.default_rng(7)
        self.internals: Internals = {k: 0.02 * rng.random(z.shape) for k, z in self.laws.initial_internals().items()}
        start = deformed(1)
        self.step: StepContext = step_context(start, np.zeros_like(start), 0.02)
        self.laws.begin_step(self.step, self.internals)

    def energy(self, x: np.ndarray) -> float:
        self.buffers.x[:], self.buffers.energy[0] = x, 0.0
        self.laws.add_energy()
        return float(self.buffers.energy[0])

    def force(self, x: np.ndarray) -> np.ndarray:
        self.buffers.x[:], self.buffers.gradient[:] = x, 0.0
        self.laws.add_gradient()
        return self.buffers.gradient.copy()

    def product(self, x: np.ndarray, along: np.ndarray) -> np.ndarray:
        self.buffers.x[:], self.buffers.hessian[:] = x, 0.0
        self.laws.add_hessian(exact=True)
        out = np.zeros_like(along)
        for (i, j), h in zip(self.measure.blocks(), self.buffers.hessian.reshape(-1, 3, 3), strict=True):
            whole = np.triu(h) + np.triu(h, 1).T if i == j else h
            out[i] += whole @ along[j]
            if i != j:
                out[j] += whole.T @ along[i]
        return out


@pytest.mark.parametrize("name", NAMES)
def test_forces_and_hessian_are_derivatives_of_the_energy(name: str) -> None:
    x = deformed(0)
    gel, h = Gel(name, MESH.nodes, x), 1e-3
    along = 1e-4 * RNG.standard_normal(x.shape)
    force = gel.force(x)
    slope = (gel.energy(x + h * along) - gel.energy(x - h * along)) / (2 * h)
    assert slope == pytest.approx(float((force * along).sum()), rel=1e-5, abs=1e-7 * float(np.abs(force * along).sum()))
    difference = (gel.force(x + h * along) - gel.force(x - h * along)) / (2 * h)
    product = gel.product(x, along)
    assert difference == pytest.approx(product, rel=1e-5, abs=1e-6 * float(np.abs(product).max()))
    strains = gel.measure.by_positions(x) @ along.ravel()
    assert strains == pytest.approx(gel.measure.along(along).ravel(), rel=1e-9, abs=1e-12)
    assert len(gel.measure.blocks()) == len(PAIRS) * len(MESH.tets)


@pytest.mark.parametrize("name", NAMES)
def test_work_and_memory_by_the_shape_at_rest(name: str) -> None:
    x, along, moved = deformed(0), *(1e-4 * RNG.standard_normal((2, *MESH.nodes.shape)))
    gel, h = Gel(name, MESH.nodes, x), 1e-3
    kept = RNG.standard_normal(sum(z.size for z in gel.internals.values()))

    def found(rest: np.ndarray) -> float:
        there = Gel(name, rest, x)
        work = float((there.force(x) * along).sum())
        new = there.laws.end_step(there.step, there.internals)
        return work + 1e-6 * float(kept @ np.concatenate([np.empty(0), *(z.ravel() for z in new.values())]))

    weights = gel.laws.rest_weights(along, 1e-6 * kept, gel.step, gel.internals)
    tensor = gel.measure.by_rest(weights, along, gel.step.x_start)
    gradients = gel.measure._solid.gradients.reshape(len(MESH.tets), 4, 10, 3)
    slope = np.einsum("mqij,mqaj,mai->", tensor, gradients, moved[MESH.tets])
    difference = (found(MESH.nodes + h * moved) - found(MESH.nodes - h * moved)) / (2 * h)
    assert difference == pytest.approx(float(slope), rel=1e-5)


def test_strains_of_a_rotation_vanish_and_those_of_a_shear_are_known() -> None:
    measure = Gel(NAMES[0], MESH.nodes, MESH.nodes).measure
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.abs(measure.strains_at(MESH.nodes @ turn.T)).max() < 1e-12
    f = np.eye(3)
    f[0, 2] = 0.3
    found = measure.strains_at(MESH.nodes @ f.T)
    assert found == pytest.approx(np.tile([0.0, 0.0, 0.045, 0.0, 0.3, 0.0], (len(found), 1)), abs=1e-12)


def test_a_bar_that_is_pulled_stiffens_by_a_times_the_square_of_its_strain() -> None:
    """Without change of volume the energy of a unit of it is 3/4 mu a e^4 at small strain e: stress 3 mu a e^3."""
    gel, e = Gel("gel_stiffening", MESH.nodes, MESH.nodes), 1e-3
    pulled = MESH.nodes @ np.diag([1.0 + e, (1.0 + e) ** -0.5, (1.0 + e) ** -0.5])
    a = effect_by_name("gel_stiffening").example["coefficient"]
    assert gel.energy(pulled) / (0.01 * 0.008 * 0.004) == pytest.approx(0.75 * MU * a * e**4, rel=5e-3)
