"""Every solver gives the same answers and refuses the same matrices."""

import numpy as np
import pytest
import scipy.sparse as sp

from sim_core.solve import factor

SOLVERS = [factor.PardisoFactor, factor.QdldlFactor, factor.SuperluFactor]


@pytest.fixture(params=SOLVERS, ids=lambda s: s.__name__)
def solver(request):
    if request.param is factor.PardisoFactor and factor.pymklpardiso is None:
        pytest.skip("no MKL here")
    return request.param


def laplace(shift, n=40):
    """Stiffness of a grid, ``shift`` added to its diagonal; its smallest eigenvalue is about 0.012 + shift."""
    line = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(n, n))
    grid = sp.kron(line, sp.identity(n)) + sp.kron(sp.identity(n), line) + shift * sp.identity(n * n)
    upper = sp.triu(grid).tocsr()
    upper.sort_indices()
    return upper, grid.tocsr()


def test_solves_again_after_new_values(solver):
    upper, _ = laplace(0.0)
    factorised = solver(upper, True)
    rhs = np.random.default_rng(0).standard_normal((upper.shape[0], 3))
    for shift in (0.0, 0.7):
        again, full = laplace(shift)
        factorised.refactor(again.data)
        np.testing.assert_allclose(full @ factorised.solve(rhs), rhs, atol=1e-9)
        np.testing.assert_allclose(factorised.solve(rhs[:, 1]), factorised.solve(rhs)[:, 1], atol=1e-12)


def test_an_indefinite_matrix_is_refused_at_first_and_later_and_after_that_all_is_well(solver):
    good, full = laplace(0.0)
    bad, _ = laplace(-0.5)
    with pytest.raises(factor.NotPositiveDefinite):
        solver(bad, True)
    factorised = solver(good, True)
    with pytest.raises(factor.NotPositiveDefinite):
        factorised.refactor(bad.data)
    factorised.refactor(good.data)
    rhs = np.ones(good.shape[0])
    np.testing.assert_allclose(full @ factorised.solve(rhs), rhs, atol=1e-9)


def test_an_indefinite_matrix_is_solved_where_that_is_wanted(solver):
    upper, full = laplace(-0.5)
    rhs = np.ones(upper.shape[0])
    np.testing.assert_allclose(full @ solver(upper, False).solve(rhs), rhs, atol=1e-8)


@pytest.mark.parametrize(("missing", "chosen"), [(0, 0), (1, 1), (2, 2)])
def test_what_is_missing_is_replaced(monkeypatch, missing, chosen):
    if missing == 0 and factor.pymklpardiso is None:
        pytest.skip("no MKL here")
    for name in ("pymklpardiso", "qdldl")[:missing]:
        monkeypatch.setattr(factor, name, None)
    assert type(factor.factorise(laplace(0.0)[0])) is SOLVERS[chosen]
