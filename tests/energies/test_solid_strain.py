"""Material laws of gels: derivatives against differences of the energy; shear, tension and turns in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from potentials import Look, check_derivatives
from scipy.spatial.transform import Rotation
from shell_terms import alone

from sim_core.effects import effect_by_name
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.geometry.solids import block
from sim_core.scene.assembly import strain_laws

SIZE = (0.01, 0.008, 0.004)
VOLUME = float(np.prod(SIZE))
MESH = block(SIZE, (1, 1, 1))
YOUNG, NU = 1e5, 0.4
MU = YOUNG / 2.0 / (1.0 + NU)
STIFFENING = effect_by_name("gel_stiffening").example["coefficient"]


def deformed(seed: int) -> np.ndarray:
    """Positions [m] ``(n, 3)`` of a gel that is strained by some 10 %."""
    rng = np.random.default_rng(seed)
    return np.asarray(
        MESH.nodes @ (np.eye(3) + 0.1 * rng.standard_normal((3, 3))).T + 2e-5 * rng.standard_normal(MESH.nodes.shape)
    )


def gel(name: str | None = None) -> Look:
    """A block of gel with one law in addition to its own, or with its own alone."""
    own = NeoHookean("gel.elastic", MESH.tets, MESH.nodes)
    own.configure({"E_pa": YOUNG, "nu": NU})
    if name is None:
        return alone(own, MESH.nodes)
    laws, effect = strain_laws(own), effect_by_name(name)
    laws.add(name, effect)
    laws.configure(laws.numbers({"E_pa": YOUNG, "nu": NU}, {name: effect.example}))
    return alone(own, MESH.nodes, laws)


def added(name: str, x: np.ndarray) -> float:
    """Energy of the law alone at ``x`` [J]."""
    found = []
    for look in (gel(name), gel()):
        look.x[:] = x
        found.append(look.energy())
    return found[0] - found[1]


@pytest.mark.parametrize("name", ["gel_stiffening", "gel_mullins", "gel_relaxation", "viscoelastic_gel"])
def test_forces_and_hessian_are_derivatives_of_the_energy(name: str) -> None:
    """From a start that is strained too, with a memory."""
    look, rng = gel(name), np.random.default_rng(7)
    known = look.system.initial_internals()
    memory = {term: {k: 0.02 * rng.random(z.shape) for k, z in own.items()} for term, own in known.items()}
    look.begin(deformed(1), dt=0.02, internals=memory)
    check_derivatives(look, deformed(0))


@pytest.mark.parametrize("shear", [0.1, 0.5])
def test_a_gel_that_is_sheared_and_turned_stiffens_by_the_closed_form(shear: float) -> None:
    """x_1 = X_1 + g X_3 has E_33 = g^2 / 2 and 2 E_13 = g, hence Q = mu (g^2 + g^4 / 3) and psi = a Q^2 / (12 mu)."""
    f = np.eye(3)
    f[0, 2] = shear
    square = shear**2 + shear**4 / 3.0
    turned = Rotation.from_rotvec([0.4, -1.1, 0.7]).apply(MESH.nodes @ f.T) + [0.1, -0.2, 0.3]
    for x in (MESH.nodes @ f.T, turned):
        assert added("gel_stiffening", x) == pytest.approx(VOLUME * STIFFENING * MU * square**2 / 12.0, rel=1e-9)


def test_a_bar_that_is_pulled_stiffens_by_a_times_the_square_of_its_strain() -> None:
    """Without change of volume the energy of a unit of it is 3/4 mu a e^4 at small strain e: stress 3 mu a e^3."""
    e = 1e-3
    pulled = MESH.nodes @ np.diag([1.0 + e, (1.0 + e) ** -0.5, (1.0 + e) ** -0.5])
    assert added("gel_stiffening", pulled) / VOLUME == pytest.approx(0.75 * MU * STIFFENING * e**4, rel=5e-3)
