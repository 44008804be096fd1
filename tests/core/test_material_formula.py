"""Material laws as formulas: compiled, and in numpy where there is no compiler."""

from __future__ import annotations

import numpy as np
import pytest
from material_points import pushes, responses, stresses
from no_compiler import without_compiler

from sim_core.core.lowering import LoweringError
from sim_core.core.material import MaterialFormula, PointLayout
from sim_core.effects import all_effects
from sim_core.effects.hooks import MaterialLaw

LAWS = {n: e for n, e in all_effects().items() if isinstance(e, MaterialLaw)}


def points(effect, size):
    """Rows of what 5 points see, some of them beyond every switch of a law, and three changes of them."""
    rng, layout = np.random.default_rng(4), effect.layout(size)
    half = rng.uniform(-0.3, 0.3, (5, size, size))
    given = {
        "e": np.array([0.01, 0.1, 1.0, 3.0, 0.3])[:, None] * rng.uniform(-1.0, 1.0, (5, size)),
        "e_0": rng.uniform(-0.2, 0.2, (5, size)),
        "d": np.eye(size) + half @ half.swapaxes(-1, -2),
        **{name: rng.uniform(0.05, 0.2, (5, *shape)) for name, shape in effect.state().items()},
        "dt": 0.02,
        **effect.example,
    }
    rows = layout.rows(given, 5)
    return layout, rows, rows * rng.standard_normal((3, *rows.shape))


@pytest.mark.parametrize("name", LAWS)
def test_a_law_in_numpy_is_that_which_was_compiled(name, monkeypatch):
    effect = LAWS[name]
    layout, rows, changes = points(effect, 6 if effect.parts == ("solid",) else 3)
    response, pushed = responses(effect.formula, layout, rows), pushes(effect.formula, layout, rows, changes)
    without_compiler(monkeypatch)
    plain = MaterialFormula(effect.formula._function)
    with pytest.warns(UserWarning, match="run in numpy"):
        again = responses(plain, layout, rows)
    scale = np.abs(response).max(axis=0)
    np.testing.assert_allclose(again, response, rtol=1e-10, atol=1e-12 * float(scale.max()))
    held = changes.copy()
    held[..., : layout.size] = 0.0  # the strain
    for some, there in ((changes, pushed), (held, pushes(effect.formula, layout, rows, held))):
        again = pushes(plain, layout, rows, some)
        np.testing.assert_allclose(again, there, rtol=1e-10, atol=1e-10 * np.abs(there).max())
    # Energy and stress alone are those that come with the tangent.
    first = response[:, : 1 + layout.size]
    for formula in (effect.formula, plain):
        found = stresses(formula, layout, rows)
        np.testing.assert_allclose(found, first, rtol=1e-10, atol=1e-12 * float(np.abs(first).max()))


def test_changes_are_taken_by_eights_and_the_rest():
    effect = LAWS["bending_friction"]
    layout, rows, changes = points(effect, 3)
    many = np.concatenate([changes * k for k in range(1, 4)])
    found = pushes(effect.formula, layout, rows, many)
    alone = np.concatenate([pushes(effect.formula, layout, rows, change[None]) for change in many])
    assert found.shape == (9, 5, 6)
    np.testing.assert_array_equal(found, alone)


def mixed(e, e_0, share):
    """Every way in which what depends on the strain alone meets what depends on the rest alone."""
    own, rest = 1.0 + e.dot(e), 1.0 + share * e_0.dot(e_0)
    both = own * rest + rest * own + (own + rest) * (rest + own) + (own - rest) * (rest - 2.0 * own)
    return both + own / rest + rest / own + max(own, rest) + (own if own > rest else rest) + (own + rest) / (own * rest)


def test_derivatives_along_changes_with_the_strain_held(monkeypatch):
    layout, rng = PointLayout(3, (), ("share",)), np.random.default_rng(8)
    given = {"e": rng.uniform(-0.5, 0.5, (6, 3)), "e_0": rng.uniform(-0.5, 0.5, (6, 3)), "d": np.eye(3), "dt": 0.1}
    rows = layout.rows({**given, "share": 0.7}, 6)
    changes = rng.standard_normal((3, *rows.shape))
    changes[..., :3] = 0.0
    found = pushes(MaterialFormula(mixed), layout, rows, changes)
    without_compiler(monkeypatch)
    expected = pushes(MaterialFormula(mixed), layout, rows, changes)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13 * np.abs(expected).max())


def forgetful(e, d, spring):
    """Returns no new internal variable."""
    return e.dot(d @ spring)


def test_a_law_that_returns_too_little_is_refused_with_a_remedy():
    with pytest.raises(LoweringError, match="could not be compiled") as refused:
        MaterialFormula(forgetful).addresses(PointLayout(3, (("spring", (3,)),), ()))
    assert "an energy, and the new internal variables after it" in str(refused.value)
