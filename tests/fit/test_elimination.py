"""Coefficients taken out of a least-squares problem, against the problem with them in."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.fit.directions import Basis
from sysid.fit.elimination import Elimination
from sysid.fit.noise import ChannelNoise

N, M, OWN, COMMON = 40, 3, 4, 5
UNIT = ChannelNoise(np.ones(M), np.zeros(M), "test")


def basis(rng: np.random.Generator, bias: float, common: int = COMMON) -> Basis:
    """One coefficient of each column stands for a bias that may be much larger than the noise."""
    own = rng.standard_normal((N, M, OWN))
    own[:, :, -1] = bias
    nothing = np.zeros((N, M))
    return Basis(
        nothing, np.zeros((N, M, 0)), np.zeros(0), rng.standard_normal((N, M, common)), own,
        np.arange(common, dtype=float), np.arange(OWN, dtype=float), nothing,
    )  # fmt: skip


def dense(found: Basis, good: np.ndarray) -> np.ndarray:
    """All columns of the basis, for the samples that count: each column's own first ``(g, m l + k)``."""
    own = np.zeros((N, M, M, OWN))
    own[:, np.arange(M), np.arange(M)] = found.own
    return np.asarray(np.concatenate([own.reshape(N, M, M * OWN), found.common], axis=2)[good])


@pytest.mark.parametrize(("bias", "common"), [(1.0, COMMON), (1e4, COMMON), (1.0, 0)])
def test_rows_and_coefficients_are_those_of_the_whole_problem(bias: float, common: int) -> None:
    rng = np.random.default_rng(3)
    here, good = basis(rng, bias, common), rng.uniform(size=(N, M)) > 0.2
    vectors = rng.standard_normal((N, M, 2)) + 3.0 * bias
    eliminate = Elimination(here, UNIT, good)
    rows, sizes = eliminate(vectors)
    root = dense(here, good)
    whole = np.vstack([root, np.eye(root.shape[1])])
    right = np.vstack([vectors[good], np.zeros((root.shape[1], 2))])
    coefficients = np.linalg.lstsq(whole, right, rcond=None)[0]
    left = right - whole @ coefficients
    assert rows.T @ rows == pytest.approx(left.T @ left, rel=1e-9)
    assert sizes.own.ravel() == pytest.approx(coefficients[: M * OWN, 0], rel=1e-9, abs=1e-9)
    assert sizes.common == pytest.approx(coefficients[M * OWN :, 0], rel=1e-9, abs=1e-9)
    assert len(rows) == np.count_nonzero(good) + sizes.number == np.count_nonzero(good) + len(eliminate.times)


def test_which_samples_count_is_remembered() -> None:
    good = np.ones((N, M), dtype=bool)
    eliminate = Elimination(basis(np.random.default_rng(3), 1.0), UNIT, good.copy())
    assert eliminate.suits(good)
    good[3, 1] = False
    assert not eliminate.suits(good)
