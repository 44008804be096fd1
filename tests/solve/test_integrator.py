"""Vibration of one mode of a strip: order of the integrators, and how fast they damp what they should not."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from sim_core.energies.membrane import Membrane
from sim_core.geometry.sheets import rectangle
from sim_core.solve.report import NewtonSettings
from sim_core.solve.step import State, advance
from sim_core.solve.system import System
from sysid.validation.small_motions import tangent_stiffness

TIGHT = NewtonSettings(force_tolerance=1e-9)


class Mode:
    """The first stretching mode of a strip that is held at one end: x(t) = rest + amplitude cos(omega t) shape."""

    def __init__(self, second_order: bool) -> None:
        mesh = rectangle(0.1, 0.02, (5, 1), "regular")
        membrane = Membrane("membrane", mesh.nodes, mesh.triangles, np.array([1.0, 0.0, 0.0]))
        membrane.configure({"E_pa": 1e8, "nu": 0.0, "thickness_m": 1e-3})
        mass = sp.diags(mesh.node_areas * 1.0).tocsr()
        prescribed = np.repeat((mesh.nodes[:, 0] < -0.05 + 1e-9)[:, None], 3, axis=1)
        prescribed[:, 1:] = True
        self.system = System(mesh.nodes, mass, prescribed, [membrane], np.zeros(3), second_order=second_order)
        self.rest = mesh.nodes
        free = ~prescribed[:, 0]
        stiffness = tangent_stiffness(self.system).toarray()
        weights = mass.diagonal()[free]
        squared, shapes = scipy.linalg.eigh(stiffness, np.diag(weights))
        self.omega = float(np.sqrt(squared[0]))
        self.shape = np.zeros_like(self.rest)
        self.shape[free, 0] = shapes[:, 0] / np.abs(shapes[:, 0]).max()
        self.mass = mass

    def swing(self, steps: np.ndarray, amplitude: float = 1e-6) -> np.ndarray:
        """Modal amplitude over its start after each step; ``steps``: lengths in radians of the vibration."""
        system = self.system
        x = self.rest + amplitude * self.shape
        state = State(0.0, x, np.zeros_like(x), system.initial_internals())
        weights = self.mass @ self.shape[:, 0]
        out = []
        for step in steps:
            state, _ = advance(system, state, self.rest, float(step) / self.omega, TIGHT)
            out.append(weights @ (state.x - self.rest)[:, 0] / (weights @ self.shape[:, 0]) / amplitude)
        return np.array(out)


@pytest.mark.parametrize(("second_order", "order"), [(False, 1), (True, 2)])
def test_order_with_steps_of_unequal_length(second_order: bool, order: int) -> None:
    mode = Mode(second_order)
    pattern = np.array([1.0, 0.5, 1.5, 0.7])
    errors = []
    for n in (1, 2, 4):
        steps = np.tile(pattern, 8 * n) * 3.0 / (8 * n * pattern.sum())
        errors.append(abs(mode.swing(steps)[-1] - np.cos(3.0)))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(rates - order) < 0.25), (errors, rates)


@pytest.mark.parametrize("second_order", [False, True])
def test_damping_is_that_of_the_formula(second_order: bool) -> None:
    """The root of the scheme for y' = i omega y: 1 / (1 - i h), or of (3/2 - i h) z^2 - 2 z + 1/2."""
    h, n = 0.2, 60
    root = 1.0 / (1.0 - 1j * h) if not second_order else np.roots([1.5 - 1j * h, -2.0, 0.5])[0]
    root = max(np.atleast_1d(root), key=abs)
    found = Mode(second_order).swing(np.full(n, h))
    # Two neighbouring extrema of a decaying oscillation of a known turn a step give its decay.
    z = np.exp(np.log(root) * np.arange(1, n + 1))
    late = slice(n // 2, n)
    basis = np.column_stack([z.real, z.imag])[late]
    fit, residual, *_ = np.linalg.lstsq(basis, found[late], rcond=None)
    assert float(np.sqrt(residual[0] / len(basis))) < 1e-5
    assert np.hypot(*fit) == pytest.approx(1.0, abs=0.03)


def test_a_second_order_swing_keeps_its_energy() -> None:
    """Three periods of 60 steps: implicit Euler loses two thirds of the amplitude, BDF2 a hundredth."""
    steps = np.full(180, 2.0 * np.pi / 60)
    lost = {second: 1.0 - np.abs(Mode(second).swing(steps)[-60:]).max() for second in (False, True)}
    assert lost[True] < 0.02 < 0.4 < lost[False]
