"""The Maxwell element of a sheet: its answer to a held strain, and that it never gives more work than it was given."""

from __future__ import annotations

import numpy as np
import pytest
from material_points import Strained, respond

from sim_core.effects.viscoelastic_sheet import ViscoelasticSheet
from sim_core.materials.elastic import plane_stress

LAW = ViscoelasticSheet()
STIFFNESS = plane_stress({"E_pa": 2.0, "nu": 0.3})[None]


def seen(strain: np.ndarray, before: np.ndarray, spring: np.ndarray, dt: float) -> Strained:
    return Strained(strain[None], before[None], STIFFNESS, {"spring": spring[None]}, dt)


@pytest.mark.parametrize("dt", [0.003, 0.05, 2.0])
def test_the_stress_of_a_held_strain_fades_exponentially(dt: float) -> None:
    """After a ramp from rest within one step: g D e (1 - exp(-r)) / r, r = dt / tau, and from there exp(-t / tau)."""
    values, strain, none = {"share": 0.4, "tau_s": 0.05}, np.array([1e-3, -2e-3, 5e-4]), np.zeros(3)
    found = respond(LAW, seen(strain, none, none, dt), values)
    whole, ratio = 0.4 * STIFFNESS[0] @ strain, dt / 0.05
    np.testing.assert_allclose(found.stress[0], whole * (1.0 - np.exp(-ratio)) / ratio, rtol=1e-13)
    begun = found.stress[0]
    for k in range(1, 4):
        found = respond(LAW, seen(strain, strain, found.state["spring"][0], dt), values)
        np.testing.assert_allclose(found.stress[0], begun * np.exp(-k * ratio), rtol=1e-12)


def test_passive_along_any_path_in_steps_of_any_length() -> None:
    """Work less what the spring stores is never negative, with a share above one too."""
    rng, values = np.random.default_rng(0), {"share": 3.0, "tau_s": 0.1}

    def stored(z: np.ndarray) -> float:
        return float(0.5 * values["share"] * z @ STIFFNESS[0] @ z)

    strain, spring, lost = np.zeros(3), np.zeros(3), []
    for dt in 10.0 ** rng.uniform(-5, 2, 2000):
        then, strain = strain, rng.standard_normal(3)
        found = respond(LAW, seen(strain, then, spring, dt), values)
        new = found.state["spring"][0]
        lost.append((found.stress[0] @ (strain - then) - stored(new) + stored(spring)) / (stored(new) + stored(spring)))
        spring = new
    assert min(lost) > -1e-12 and max(lost) > 0.1
