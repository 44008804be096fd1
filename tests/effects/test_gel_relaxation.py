"""Relaxation of a gel at a point: the Prony law in holds and ramps, what does not relax, digits, and its branches."""

from __future__ import annotations

import numpy as np
import pytest
from material_points import Response, Strained, respond

from sim_core.effects import effect_by_name
from sim_core.effects.registry import active_effects
from sim_core.energies.strain import SHEAR
from sim_core.errors import ConfigError

MU, VALUES = 3e4, {"share": 0.3, "tau_s": 0.1}
NOTHING = np.zeros(6)


def components(tensor: np.ndarray) -> np.ndarray:
    """11, 22, 33 and twice 23, 13, 12, ``(6,)``."""
    twice = tensor + tensor.T
    return np.array([*(0.5 * np.diag(twice)), twice[1, 2], twice[0, 2], twice[0, 1]])


def strain(f: np.ndarray) -> np.ndarray:
    """Green strains of a deformation gradient."""
    return components(0.5 * (f.T @ f - np.eye(3)))


def deviatoric(f: np.ndarray) -> np.ndarray:
    """S_dev of the gel's own law, mu [1 - (1 - (J - 1) / 3) J C^-1] ``(6,)``."""
    j = np.linalg.det(f)
    s = MU * (np.eye(3) - (1.0 - (j - 1.0) / 3.0) * j * np.linalg.inv(f.T @ f))
    return components(s) / np.repeat([1.0, 2.0], 3)


class Point:
    """A point of a gel, and what it remembers."""

    def __init__(self) -> None:
        self._law, self._before, self._kept = effect_by_name("gel_relaxation"), NOTHING, NOTHING

    def step(self, to: np.ndarray, dt: float) -> Response:
        seen = Strained(to[None], self._before[None], MU * SHEAR[None], {"stress": self._kept[None]}, dt)
        found = respond(self._law, seen, VALUES)
        self._before, self._kept = to, found.state["stress"][0]
        return found


F = np.array([[1.1, 0.2, 0.0], [-0.05, 0.9, 0.1], [0.1, 0.0, 1.05]])


def test_a_held_stress_fades_by_the_prony_law():
    """After a step that is short against tau, -g (1 - exp(-t/tau)) S_dev is added."""
    point, whole = Point(), deviatoric(F)
    first = point.step(strain(F), 1e-9 * VALUES["tau_s"])
    assert np.abs(first.stress).max() < 1e-8 * np.abs(whole).max()
    for k in range(1, 8):
        found = point.step(strain(F), 0.5 * VALUES["tau_s"])
        expected = -VALUES["share"] * (1.0 - np.exp(-0.5 * k)) * whole
        np.testing.assert_allclose(found.stress[0], expected, rtol=0.0, atol=1e-8 * np.abs(whole).max())


@pytest.mark.parametrize("ratio", [0.1, 2.0, 20.0])
def test_a_steady_ramp_is_exact_for_any_step(ratio):
    """mu rate [(1 - g) t + g tau (1 - exp(-t/tau))] at the end of every step, in shear that is small."""
    point, (g, tau), shear = Point(), VALUES.values(), 1e-7
    dt = ratio * tau
    for k in range(1, 6):
        t, to = k * dt, strain(np.eye(3) + k * shear * np.outer([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
        found = MU * k * shear + point.step(to, dt).stress[0, 4]
        expected = MU * shear / dt * ((1.0 - g) * t + g * tau * (1.0 - np.exp(-t / tau)))
        assert found == pytest.approx(expected, rel=1e-6)


def test_a_uniform_compression_keeps_its_pressure():
    point, small = Point(), 1e-6
    for _ in range(5):
        found = point.step(strain((1.0 - small) * np.eye(3)), 0.1)
    assert np.abs(found.stress).max() < 1e-5 * MU * small


@pytest.mark.parametrize("size", [1e-8, 1e-5, 0.3])
def test_the_stress_of_a_small_strain_keeps_its_digits(size):
    """Against more digits: a gel that hardly moves has the rate of stress that it has."""
    h = size * np.random.default_rng(3).normal(size=(3, 3)).astype(np.longdouble)
    f, p, q = np.eye(3) + h, [1, 2, 0], [2, 0, 1]
    cof = f[p][:, p] * f[q][:, q] - f[p][:, q] * f[q][:, p]
    j = (f[0] * cof[0]).sum()
    s = MU * (np.eye(3) - (1 - (j - 1) / 3) / j * (cof.T @ cof))
    expected = components(s).astype(float) / np.repeat([1.0, 2.0], 3)
    e = components(0.5 * (h + h.T + h.T @ h)).astype(float)
    found, ratio = Point().step(e, 0.05), 0.5
    blend = -np.expm1(-ratio) / ratio
    np.testing.assert_allclose(found.state["stress"][0], blend * 0.3 * expected, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(found.stress[0], (blend - 1.0) * 0.3 * expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("height", [0.0, -0.5, 1e-9])
def test_memory_stays_finite_for_a_crushed_point(height):
    found = Point().step(strain(np.diag([1.0, 1.0, height])), 0.01)
    assert np.isfinite(found.energy).all() and np.isfinite(found.stress).all()
    assert np.abs(found.state["stress"]).max() < 1e3 * MU


def test_branches_add_up_to_less_than_the_whole(small_rig):
    branches = {f"gel_relaxation#{k}": {"share": 0.4, "tau_s": 0.1 * k} for k in (1, 2)}
    assert len(active_effects(small_rig(effects=branches))) == 2
    more = {**branches, "gel_relaxation@gel#3": {"share": 0.2, "tau_s": 1.0}}
    with pytest.raises(ConfigError, match=r"gel_relaxation of gel have together the share 1"):
        active_effects(small_rig(effects=more))
