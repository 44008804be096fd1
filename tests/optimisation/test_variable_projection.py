"""Coefficients taken out of a least-squares problem, against the problem with them in."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.whitening import whiten
from sysid.solve.discretisation_basis import Basis, Changes
from sysid.solve.variable_projection import Elimination

N, M, OWN, COMMON = 40, 3, 4, 5
T = np.cumsum(np.random.default_rng(9).choice([0.01, 0.01, 0.012, 0.2], N))
"""Times [s] with pauses between them."""


def basis(rng: np.random.Generator, bias: float, common: int = COMMON) -> Basis:
    """One coefficient of each column stands for a bias that may be much larger than the noise."""

    def part(count: int) -> Changes:
        return Changes(rng.standard_normal((N, M)), rng.standard_normal((N, count)), np.arange(count, dtype=float))

    always = Changes(np.full((N, M), bias), np.ones((N, 1)), np.zeros(1))
    nothing = np.zeros((N, M))
    rough = rng.uniform(size=(N, M))
    return Basis(
        nothing, np.zeros((N, M, 0)), np.zeros(0), np.zeros(0), (part(common - common // 2), part(common // 2)),
        (part(OWN - 1), always), rough, rough, nothing,
    )  # fmt: skip


def dense(found: Basis) -> np.ndarray:
    """All columns of the basis: each column's own first ``(n, m, m l + k)``."""
    own, common = (
        np.concatenate([p.shape[:, :, None] * p.functions[:, None] for p in parts], axis=2)
        for parts in (found.own, found.common)
    )
    each = np.zeros((N, M, M, OWN))
    each[:, np.arange(M), np.arange(M)] = own
    return np.asarray(np.concatenate([each.reshape(N, M, M * OWN), common], axis=2))


@pytest.mark.parametrize(("bias", "common"), [(1.0, COMMON), (1e4, COMMON), (1.0, 0)])
@pytest.mark.parametrize("rho", [0.0, 0.8])
@pytest.mark.parametrize("modes", [0, 2])
def test_rows_and_coefficients_are_those_of_the_whole_problem(bias: float, common: int, rho: float, modes: int) -> None:
    """``modes``: number of those in which the columns of one instant have noise in common."""
    rng = np.random.default_rng(3)
    here, good = basis(rng, bias, common), rng.uniform(size=(N, M)) > 0.2
    noise = ChannelNoise(rng.uniform(0.5, 2.0, M), np.array([rho, 0.0, 0.5 * rho]), "test")
    vectors = rng.standard_normal((N, M, 2)) + 3.0 * bias
    deviations = 4.0 * rng.standard_normal((N, modes, M))
    eliminate = Elimination(here, noise, good, T, deviations)
    rows, sizes = eliminate(vectors)
    # Missing samples are NaN, so that those after them are whitened without them.
    root = np.where(good[:, :, None], dense(here), np.nan)
    root = (whiten(root, noise, T) * here.weights(noise)[:, :, None])[good]
    # Whitened noise has the covariance I + G^T G over all samples that count.
    each = np.zeros((N, modes, N, M))
    each[np.arange(N), :, np.arange(N)] = deviations
    shaking = each.reshape(N * modes, N, M)[:, good]
    values, vectors_of = np.linalg.eigh(np.eye(np.count_nonzero(good)) + shaking.T @ shaking)
    inverse_root = (vectors_of / np.sqrt(values)) @ vectors_of.T
    whole = np.vstack([inverse_root @ root, np.eye(root.shape[1])])
    right = np.vstack([inverse_root @ vectors[good], np.zeros((root.shape[1], 2))])
    coefficients = np.linalg.lstsq(whole, right, rcond=None)[0]
    left = right - whole @ coefficients
    assert rows == pytest.approx(left, rel=1e-9, abs=1e-9 * np.abs(vectors).max())
    assert sizes.own.ravel() == pytest.approx(coefficients[: M * OWN, 0], rel=1e-9, abs=1e-9)
    assert sizes.common == pytest.approx(coefficients[M * OWN :, 0], rel=1e-9, abs=1e-9)
    assert len(rows) == np.count_nonzero(good) + sizes.number == np.count_nonzero(good) + len(eliminate.times)


def test_which_samples_count_is_remembered() -> None:
    good = np.ones((N, M), dtype=bool)
    unit = ChannelNoise(np.ones(M), np.zeros(M), "test")
    eliminate = Elimination(basis(np.random.default_rng(3), 1.0), unit, good.copy(), T)
    assert eliminate.suits(good)
    good[3, 1] = False
    assert not eliminate.suits(good)


def test_memory_does_not_grow_with_samples_times_coefficients() -> None:
    """254 columns, as of an array of 127 pins; formed, the 100 common coefficients alone would take 61 MB."""
    n, m, count = 300, 254, 100
    rng = np.random.default_rng(4)
    part = Changes(rng.standard_normal((n, m)), rng.standard_normal((n, count)), np.zeros(count))
    few = Changes(part.shape, part.functions[:, :10], np.zeros(10))
    zero = np.zeros((n, m))
    here = Basis(zero, np.zeros((n, m, 0)), np.zeros(0), np.zeros(0), (part,), (few,), zero, zero, zero)
    vectors = rng.standard_normal((n, m, 3))
    tracemalloc.start()
    Elimination(here, ChannelNoise(np.ones(m), np.full(m, 0.5), "test"), zero == 0.0, np.arange(n) / 100.0)(vectors)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 0.5 * 8 * n * m * count, f"{peak / 1e6:.0f} MB"
