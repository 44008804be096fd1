"""Numbers that are learnt, on linear models with known results."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sysid.comparison.learning import Case, learnt_form, learnt_weights, score, shared_out
from sysid.comparison.ledger import Column, Ledger, blocks_of
from sysid.comparison.posterior import compared
from sysid.comparison.priors import PLACE, PRIORS, Priors

READINGS = 120
T = np.linspace(0.0, 1.0, READINGS)
MODULUS, MESH = np.ones(READINGS), 8.0 * np.sin(9.0 * T)
EFFECTS = np.exp(-5.0 * T)[:, None] * np.cos(np.outer(T, np.arange(12.0) * 4.0))


def ledger(y: np.ndarray) -> Ledger:
    owners = [("parameter", "E", "", 0.0, 2.0), ("approximation", "mesh", "", 1.0, 0.3)]
    owners += [("effect", f"effect {k}", f"place {k % 3}", 0.0, 50.0) for k in range(EFFECTS.shape[1])]
    columns = [
        Column(kind, owner, place, "", {}, "size", "1", 0.0, 1.0, False, mean, sd, False, -np.inf, np.inf)  # type: ignore[arg-type]
        for kind, owner, place, mean, sd in owners
    ]
    rows = np.column_stack([-MODULUS, -MESH, -EFFECTS, y])
    return Ledger(tuple(columns), tuple(blocks_of("run", 1.0, T, np.ones(READINGS, dtype=bool), rows)), {})


def test_the_form_error_is_learnt() -> None:
    """Each effect changes the readings by a tenth of what the mesh does, given parameters and mesh."""
    rng = np.random.default_rng(1)
    parameters = 4.0 * np.outer(MODULUS, MODULUS)
    projection = np.linalg.inv(np.eye(READINGS) + parameters)
    size = np.sqrt((1.0 + 0.3**2) * MESH @ projection @ MESH)
    inverse = np.linalg.inv(np.eye(READINGS) + parameters + 0.09 * np.outer(MESH, MESH))
    widths = 0.1 * size / np.sqrt(np.einsum("nk,nm,mk->k", EFFECTS, inverse, EFFECTS))

    def drawn() -> np.ndarray:
        mesh = rng.normal(1.0, 0.3)
        small = EFFECTS @ (widths * rng.standard_normal(EFFECTS.shape[1]))
        return np.asarray(2.0 * rng.normal() * MODULUS + mesh * MESH + small + rng.standard_normal(READINGS))

    found = learnt_form([ledger(drawn()) for _ in range(30)])
    # 30 recordings with several effects each tell a width to about a tenth.
    assert found.form == pytest.approx(0.1, rel=0.3)
    # One recording without any does not make it vanish.
    assert learnt_form([ledger(MESH + rng.standard_normal(READINGS))]).form > 0.05 * PRIORS.form


def cases(rng: np.random.Generator, count: int) -> list[Case]:
    """With Bayes factors at random, of three candidates that count different things."""
    counts = np.zeros((3, len(PLACE)))
    counts[1, PLACE["unknown"]], counts[2, PLACE["pair"]] = 1.0, 1.0
    found = []
    for _ in range(count):
        true = np.zeros(3, dtype=bool)
        true[rng.integers(3)] = True
        found.append(Case(counts, 2.0 * rng.standard_normal(3), true, float(rng.uniform(0.5, 2.0))))
    return found


def test_the_derivative_of_the_score_is_that_of_differences() -> None:
    rng = np.random.default_rng(2)
    some, at = cases(rng, 20), rng.standard_normal(len(PLACE))
    _, slope = score(some, at)
    step = 1e-6
    for k in (PLACE["unknown"], PLACE["pair"]):
        ahead, behind = at.copy(), at.copy()
        ahead[k] += step
        behind[k] -= step
        difference = (score(some, ahead)[0] - score(some, behind)[0]) / (2.0 * step)
        assert slope[k] == pytest.approx(difference, rel=1e-5, abs=1e-6)
    assert np.count_nonzero(slope) == 2


def test_prior_weights_are_the_odds_of_what_is_concealed() -> None:
    """Bayes factors that say nothing leave the shares of the truths: 3 to 1 for unknown physics."""
    counts = np.zeros((2, len(PLACE)))
    counts[1, PLACE["unknown"]] = 1.0
    some = [Case(counts, np.zeros(2), np.array([k % 4 == 3, k % 4 < 3])) for k in range(400)]
    found = learnt_weights(some)
    assert found.unknown == pytest.approx(np.log(3.0), abs=0.03)
    assert found.form == PRIORS.form and found.pair == PRIORS.pair


def test_nothing_missing_has_half_of_the_weight() -> None:
    rng = np.random.default_rng(3)
    concealed, empty = [replace(c, weight=1.0) for c in cases(rng, 8)], cases(rng, 2)
    assert [c.weight for c in shared_out(concealed, empty)] == [1.0] * 8 + [4.0] * 2


def test_a_case_has_the_probability_of_what_is_concealed() -> None:
    y = 2.0 * MODULUS + MESH + 60.0 * EFFECTS[:, 5] + np.random.default_rng(4).standard_normal(READINGS)
    found, other = (Case.of(compared(ledger(y)), (name,)) for name in ("effect 5", "effect 2"))
    assert found.probability(PRIORS.weights) > 5.0 * other.probability(PRIORS.weights)


def test_prior_weights_are_numbers_in_one_order() -> None:
    weights = np.arange(float(len(PLACE)))
    found = Priors.of_weights(weights, 0.5)
    np.testing.assert_array_equal(found.weights, weights)
    assert found.form == 0.5 and found.left == tuple(weights[PLACE["left 0"] : PLACE["left 0"] + 3])
