"""Posterior probabilities of models from Gram matrices, on linear models with known answers."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sysid.comparison.ledger import Block, Column, Ledger, LedgerError, blocks_of, read_ledger
from sysid.comparison.posterior import UNKNOWN, Evidence, Widths, posterior, temper_of

READINGS, BLOCKS = 240, 12
T = np.linspace(0.0, 1.0, READINGS)
PARAMETERS = np.stack([np.ones(READINGS), T], axis=1)
EFFECTS = np.stack([np.sin(7.0 * T), np.cos(7.0 * T), np.exp(-6.0 * T), T**2], axis=1)
NAMES = ("lag", "drag", "creep", "drift")


def column(kind: str, owner: str, sd: float, one_sided: bool = False, mean: float = 0.0) -> Column:
    label = "" if kind == "parameter" else owner
    return Column(
        "parameter" if kind == "parameter" else "effect", owner, label, {}, "size", "N", 0.0, 2.0, False, mean, sd,
        one_sided, -np.inf, np.inf,
    )  # fmt: skip


def ledger(y: np.ndarray, one_sided: bool = False, mean: float = 0.0) -> Ledger:
    """Of readings that are noise of unit variance, two parameters and four effects of one amplitude each; rows are
    derivatives of the residual, as of the residuals of a fit: less those of the prediction."""
    columns = [column("parameter", name, 3.0, mean=mean) for name in ("offset", "slope")]
    columns += [column("effect", name, 2.0, one_sided) for name in NAMES]
    rows = np.column_stack([-PARAMETERS, -EFFECTS, y])
    blocks = blocks_of("run", 1.0, T, np.ones(READINGS, dtype=bool), rows, BLOCKS)
    return Ledger(tuple(columns), tuple(blocks), {"made": "by hand"})


def drawn(seed: int, sizes: dict[str, float]) -> np.ndarray:
    rng = np.random.default_rng(seed)
    made = sum((size * EFFECTS[:, NAMES.index(name)] for name, size in sizes.items()), np.zeros(READINGS))
    return np.asarray(made + PARAMETERS @ [0.4, -0.3] + rng.standard_normal(READINGS))


SLOTS = {
    "sheet": np.stack([np.sin(3.0 * T), np.cos(3.0 * T), np.sin(5.0 * T)], axis=1),
    "wrench": np.stack([np.sign(T - 0.4), np.abs(T - 0.6)], axis=1),
}


def with_closures(y: np.ndarray) -> Ledger:
    """The same ledger with closures of two slots, whose coefficients have the standard deviation 0.5."""
    plain = ledger(y)
    columns = list(plain.columns)
    for owner, shapes in SLOTS.items():
        columns += [
            Column("closure", owner, f"{owner} is off", {}, f"by shape {k}", "1", 0.0, 1.0, False, 0.0, 0.5, False,
                   -np.inf, np.inf)
            for k in range(shapes.shape[1])
        ]  # fmt: skip
    rows = np.column_stack([-PARAMETERS, -EFFECTS, *(-shapes for shapes in SLOTS.values()), y])
    blocks = blocks_of("run", 1.0, T, np.ones(READINGS, dtype=bool), rows, BLOCKS)
    return replace(plain, columns=tuple(columns), blocks=tuple(blocks))


def marginal(y: np.ndarray, chosen: tuple[str, ...], mean: float = 0.0) -> float:
    """Log density of all readings with parameters and amplitudes integrated out, by their dense covariance."""
    d = EFFECTS[:, [NAMES.index(n) for n in chosen]]
    covariance = np.eye(READINGS) + 9.0 * PARAMETERS @ PARAMETERS.T + 4.0 * d @ d.T
    return float(multivariate_normal(PARAMETERS @ [mean, mean], covariance).logpdf(y))


@pytest.mark.parametrize("mean", [0.0, 0.7])
def test_bayes_factors_are_those_of_the_whole_covariance(mean: float) -> None:
    y = drawn(1, {"creep": 1.0})
    evidence = Evidence(ledger(y, mean=mean))
    for count in (1, 2, 3):
        for chosen in combinations(NAMES, count):
            found = evidence.factor([(n, n) for n in chosen])
            assert found == pytest.approx(marginal(y, chosen, mean) - marginal(y, (), mean), abs=1e-7)


def test_unknown_physics_is_a_closure_with_wide_coefficients() -> None:
    """Bayes factors of slots, of effects with the narrow closures that all models have, and of both together, against
    dense covariances."""
    widths, y = Widths(background=0.1, unknown=2.0), drawn(9, {"lag": 1.0}) + SLOTS["sheet"] @ [0.6, -0.9, 0.4]

    def density(chosen: tuple[str, ...], slots: tuple[str, ...]) -> float:
        d = EFFECTS[:, [NAMES.index(n) for n in chosen]]
        covariance = np.eye(READINGS) + 9.0 * PARAMETERS @ PARAMETERS.T + 4.0 * d @ d.T
        for owner, shapes in SLOTS.items():
            covariance += (0.5 * (2.0 if owner in slots else 0.1)) ** 2 * shapes @ shapes.T
        return float(multivariate_normal(np.zeros(READINGS), covariance).logpdf(y))

    evidence = Evidence(with_closures(y), widths=widths)
    for chosen, slots in (((), ("sheet",)), (("lag",), ()), (("lag",), ("sheet",)), ((), ("sheet", "wrench"))):
        keys = [*((n, n) for n in chosen), *((f"{UNKNOWN}{n}", "") for n in slots)]
        assert evidence.factor(keys) == pytest.approx(density(chosen, slots) - density((), ()), abs=1e-7)


def test_what_the_library_lacks_is_placed_and_what_it_has_is_named() -> None:
    beyond = posterior(with_closures(drawn(10, {}) + SLOTS["wrench"] @ [1.5, 0.8]))
    assert beyond.models[0].effects == (f"{UNKNOWN}wrench",)
    assert beyond.unknown > 0.9 and beyond.nothing < 1e-3
    named = posterior(with_closures(drawn(11, {"creep": 4.0})))
    assert named.models[0].effects == ("creep",)
    assert named.unknown < 0.2
    # What careful simulators differ in is no unknown physics.
    careful = posterior(with_closures(drawn(12, {}) + SLOTS["sheet"] @ [0.01, -0.01, 0.0]))
    assert careful.nothing > 0.5


def test_data_weigh_less_where_no_column_explains_them() -> None:
    y = drawn(13, {"lag": 3.0})
    noise = 2.0 * np.random.default_rng(14).standard_normal(READINGS)
    assert temper_of(with_closures(y)) == pytest.approx(1.0, abs=0.15)
    # Of 240 readings about six numbers are fitted; the variance of the noise is 1 + 4.
    assert temper_of(with_closures(y + noise)) == pytest.approx(5.0, abs=1.0)


def test_an_amplitude_that_cannot_be_negative_has_half_of_a_prior() -> None:
    """Against the integral over the amplitude, on a grid."""
    y = drawn(2, {"creep": 0.8})
    grid = np.linspace(0.0, 20.0, 40001)
    covariance = np.eye(READINGS) + 9.0 * PARAMETERS @ PARAMETERS.T
    d, inverse = EFFECTS[:, 2], np.linalg.inv(covariance)
    logs = grid * (d @ inverse @ y) - 0.5 * grid**2 * (d @ inverse @ d) - 0.5 * (grid / 2.0) ** 2
    expected = np.log(np.trapezoid(np.exp(logs), grid) * 2.0 / (2.0 * np.sqrt(2.0 * np.pi)))
    evidence = Evidence(ledger(y, one_sided=True))
    assert evidence.factor([("creep", "creep")]) == pytest.approx(expected, abs=1e-4)
    (amplitude,) = evidence.amplitudes([("creep", "creep")])
    weight = np.exp(logs - logs.max())
    # A factor of one is two newtons.
    assert amplitude.value == pytest.approx(2.0 * np.sum(grid * weight) / np.sum(weight), rel=1e-3)
    assert amplitude.interval[0] >= 0.0


def test_what_was_drawn_is_found_with_its_size() -> None:
    found = posterior(ledger(drawn(3, {"lag": 3.0, "creep": -5.0})))
    best = found.models[0]
    assert set(best.effects) == {"lag", "creep"} and best.probability > 0.5
    assert [set(m.effects) for m in found.credible(0.5)] == [{"lag", "creep"}]
    # Bootstrap samples that leave out the blocks which show an effect keep a little of it.
    assert found.nothing < 1e-3
    assert found.inclusion["creep"] > 0.75
    assert sum(m.probability for m in found.models) == pytest.approx(1.0)


def test_probabilities_are_as_often_right_as_they_say() -> None:
    """Sets and sizes are drawn from the prior: of all effects and recordings, those that are missing with a probability
    of p are missing in p of the cases, and nothing is missing as often as is said."""
    rng = np.random.default_rng(4)
    each = 1.0 - 0.5**0.25
    said, true, nothing, none = [], [], [], []
    for seed in range(300):
        chosen = [n for n in NAMES if rng.random() < each]
        y = drawn(seed, {n: 2.0 * rng.standard_normal() for n in chosen})
        found = posterior(ledger(y), bags=0)
        said += [found.inclusion.get(n, 0.0) for n in NAMES]
        true += [n in chosen for n in NAMES]
        nothing.append(found.nothing)
        none.append(not chosen)
    said_, true_ = np.array(said), np.array(true)
    for low, high in ((0.0, 0.2), (0.2, 0.8), (0.8, 1.0)):
        here = (said_ >= low) & (said_ < high + 1e-9)
        sd = np.sqrt(np.sum(said_[here] * (1.0 - said_[here]))) / here.sum()
        assert np.mean(true_[here]) == pytest.approx(np.mean(said_[here]), abs=4.0 * sd + 1e-3)
    assert np.mean(nothing) == pytest.approx(np.mean(none), abs=0.08)


def test_blocks_that_disagree_make_a_model_less_probable() -> None:
    """An effect that one block alone asks for is not as probable as one that all ask for, with the same Bayes factor
    in all data."""
    rng = np.random.default_rng(5)
    y = drawn(6, {})
    here = (T > 0.5) & (T < 0.58)
    y[here] += 3.5 * np.sign(EFFECTS[here, 0]) * np.abs(rng.standard_normal(here.sum()))
    alone = posterior(ledger(y), bags=0).inclusion
    bagged = posterior(ledger(y)).inclusion
    most = max(alone, key=lambda name: alone[name])
    assert alone[most] > 0.9
    assert bagged[most] < alone[most] - 0.05


def test_a_ledger_is_read_as_it_was_written(tmp_path: Path) -> None:
    given = ledger(drawn(7, {"lag": 1.0}))
    given.write(tmp_path / "ledger.npz")
    for path in (tmp_path, tmp_path / "ledger.npz"):
        found = read_ledger(path)
        assert found.columns == given.columns and found.provenance == {"made": "by hand"}
        np.testing.assert_array_equal(found.gram, given.gram)
    assert sum(b.readings for b in given.blocks) == READINGS
    table = np.column_stack([-PARAMETERS, -EFFECTS, drawn(7, {"lag": 1.0})])
    np.testing.assert_allclose(given.gram, table.T @ table, rtol=1e-12)


def test_without_an_effect_nothing_is_known_of_it() -> None:
    given = ledger(drawn(8, {"lag": 2.0}))
    less = given.without(["lag"])
    assert less.effects == NAMES[1:]
    kept = Evidence(less).factor([("creep", "creep")])
    assert kept == pytest.approx(Evidence(given).factor([("creep", "creep")]), rel=1e-12)
    with pytest.raises(LedgerError, match="no columns of play"):
        given.without(["play"])


@pytest.mark.parametrize("fault", ["text", "schema", "size", "missing"])
def test_a_file_that_is_no_ledger_is_named(tmp_path: Path, fault: str) -> None:
    path = tmp_path / "ledger.npz"
    if fault == "text":
        path.write_text("mass 3")
    elif fault == "schema":
        np.savez(path, words=np.array('{"schema": "other"}'), grams=np.zeros((1, 1, 1)))
    elif fault == "size":
        given = ledger(drawn(9, {}))
        replace(given, blocks=(Block("run", 0.0, 1.0, 3, np.eye(3)),)).write(path)
    with pytest.raises(LedgerError, match=r"ledger\.npz"):
        read_ledger(path)


def test_what_a_model_leaves_is_its_misfit() -> None:
    """One for noise of unit variance, and more without the effect that is there."""
    evidence = Evidence(ledger(drawn(10, {"lag": 3.0})))
    assert evidence.left([("lag", "lag")]) == pytest.approx(1.0, abs=0.25)
    assert evidence.left([]) > 2.0
