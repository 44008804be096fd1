"""The projected second derivative of a solid's energy density against a dense eigenvalue decomposition."""

import numpy as np
import pytest

from sim_core.core.language import Mat
from sim_core.energies.projection import negative_modes, rotation_variant_svd

CROSS = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    CROSS[_i, _j, _k], CROSS[_i, _k, _j] = 1.0, -1.0


def deformation(kind, rng):
    if kind == "rest":
        return np.eye(3)
    if kind == "near rest":
        return np.eye(3) + 1e-9 * rng.normal(size=(3, 3))
    if kind == "any":
        return rng.normal(size=(3, 3))
    if kind == "line":
        return np.outer(rng.normal(size=3), rng.normal(size=3))
    return np.diag(rng.integers(-1, 2, 3)).astype(float)


KINDS = ["rest", "near rest", "any", "line", "axes"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("memory_kind", ["none", "coaxial", "any"])
def test_negative_modes_against_a_dense_decomposition(kind, memory_kind):
    """The nearest semidefinite matrix for coaxial memory; semidefinite and not below it for any."""
    rng = np.random.default_rng(11)
    memory, modes = np.zeros((3, 3)).view(Mat), np.zeros((9, 10))
    for _ in range(100):
        f = deformation(kind, rng).view(Mat)
        alpha, slope, curvature = abs(rng.normal()), 2.0 * rng.normal(), abs(rng.normal())
        memory[:] = 0.0
        if memory_kind == "coaxial":
            memory[:] = rng.normal() * np.eye(3) + rng.normal() * f.T @ f
        elif memory_kind == "any":
            memory[:] = rng.normal(size=(3, 3))
            memory[:] = memory + memory.T
        cofactor = 0.5 * np.einsum("ikm,jln,kl,mn->ij", CROSS, CROSS, f, f).ravel()
        full = (
            alpha * np.eye(9)
            + np.kron(np.eye(3), memory)
            + curvature * np.outer(cofactor, cofactor)
            + slope * np.einsum("ikm,jln,mn->ijkl", CROSS, CROSS, f).reshape(9, 9)
        )
        negative_modes(modes, f, alpha, slope, curvature, memory, memory_kind != "none")
        projected = full - np.einsum("m,mi,mj->ij", modes[:, 9], modes[:, :9], modes[:, :9])
        values, vectors = np.linalg.eigh(full)
        scale = np.abs(values).max()
        assert np.linalg.eigvalsh(projected)[0] > -1e-12 * scale
        if memory_kind != "any":
            nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
            assert np.abs(projected - nearest).max() < 1e-10 * scale


@pytest.mark.parametrize("kind", KINDS)
def test_rotation_variant_svd(kind):
    rng = np.random.default_rng(12)
    for _ in range(50):
        f = deformation(kind, rng).view(Mat)
        u, s, v = (np.asarray(part) for part in rotation_variant_svd(f))
        scale = max(np.abs(f).max(), 1e-300)
        assert np.abs(u @ np.diag(s) @ v.T - f).max() < 1e-13 * scale
        for rotation in (u, v):
            assert np.abs(rotation.T @ rotation - np.eye(3)).max() < 1e-13
            assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert abs(s[2]) <= min(s[0], s[1]) + 1e-12 * scale
