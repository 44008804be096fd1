"""Posterior probabilities of models from Gram matrices, on linear models with known results."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sysid.comparison.evidence import Evidence, joined
from sysid.comparison.explanations import UNKNOWN
from sysid.comparison.ledger import Block, Column, Ledger, LedgerError, blocks_of, read_ledger
from sysid.comparison.posterior import compared, judged, posterior, temper_of
from sysid.comparison.priors import AMPLITUDES, PLACE, PRIORS, Priors

READINGS, BLOCKS = 240, 12
T = np.linspace(0.0, 1.0, READINGS)
PARAMETERS = np.stack([np.ones(READINGS), T], axis=1)
EFFECTS = np.stack([np.sin(7.0 * T), np.cos(7.0 * T), np.exp(-6.0 * T), T**2], axis=1)
NAMES = ("lag", "drag", "creep", "drift")
PLACES = {"lag": "robot", "drag": "environment", "creep": "sheet", "drift": "wrench"}
LIBRARY_ONLY = replace(PRIORS, unknown=-30.0, left=(-30.0, -30.0, -30.0))
"""Without unknown physics, and effects that are in the shapes that are looked at."""


def column(kind: str, owner: str, sd: float, one_sided: bool = False, mean: float = 0.0) -> Column:
    label, place = ("", "") if kind == "parameter" else (owner, PLACES[owner])
    return Column(
        "parameter" if kind == "parameter" else "effect", owner, place, label, {}, "size", "N", 0.0, 2.0, False, mean,
        sd, one_sided, -np.inf, np.inf,
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
            Column("closure", owner, owner, f"{owner} is off", {}, f"by shape {k}", "1", 0.0, 1.0, False, 0.0, 0.5,
                   False, -np.inf, np.inf)
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
    sets = [chosen for count in (2, 0, 3, 1) for chosen in combinations(NAMES, count)]
    expected = [marginal(y, chosen, mean) - marginal(y, (), mean) for chosen in sets]
    # The form error of a thousandth of the noise in every column is in all of them.
    found = [evidence.factor(joined([evidence.directions((n, n)) for n in chosen])) for chosen in sets]
    assert found == pytest.approx(expected, abs=1e-7)


APPROXIMATION = 6.0 * np.sin(11.0 * T)


def with_approximation(y: np.ndarray) -> Ledger:
    """The ledger with closures, and an error of the mesh that is known to be 1 +- 0.3."""
    plain = with_closures(y)
    mesh = Column("approximation", "mesh", "", "", {}, "mesh", "1", 0.0, 1.0, False, 1.0, 0.3, False, -np.inf, np.inf)
    rows = np.column_stack(
        [-PARAMETERS, -EFFECTS, *(-shapes for shapes in SLOTS.values()), -APPROXIMATION, y]
    )  # fmt: skip
    blocks = blocks_of("run", 1.0, T, np.ones(READINGS, dtype=bool), rows, BLOCKS)
    return replace(plain, columns=(*plain.columns, mesh), blocks=tuple(blocks))


def plain_covariance() -> np.ndarray:
    """Of noise, parameters and the mesh."""
    return np.eye(READINGS) + 9.0 * PARAMETERS @ PARAMETERS.T + 0.09 * np.outer(APPROXIMATION, APPROXIMATION)


def form_error(form: float) -> np.ndarray:
    """Covariance of what careful simulators differ in: each effect and closure by a share of the size of the mesh,
    whose mean square is 1 + 0.3^2 of its own, less what the parameters take up of it."""
    columns = np.column_stack([EFFECTS, *SLOTS.values()])
    sd = np.concatenate([np.full(4, 2.0), np.full(5, 0.5)])
    projection = np.linalg.inv(np.eye(READINGS) + 9.0 * PARAMETERS @ PARAMETERS.T)
    size = np.sqrt((1.0 + 0.3**2) * APPROXIMATION @ projection @ APPROXIMATION)
    inverse = np.linalg.inv(plain_covariance())
    widths = np.minimum(form * size / np.sqrt(np.einsum("nk,nm,mk->k", columns, inverse, columns)), sd)
    return np.asarray((columns * widths**2) @ columns.T)


@pytest.mark.parametrize("form", [0.01, 0.2])
def test_all_models_have_the_mesh_and_the_form_error(form: float) -> None:
    """Bayes factors and the marginal likelihood against the dense covariance of all readings."""
    y = drawn(9, {"lag": 1.0}) + SLOTS["sheet"] @ [0.6, -0.9, 0.4] + APPROXIMATION
    covariance = plain_covariance() + form_error(form)

    def density(more: np.ndarray) -> float:
        return float(multivariate_normal(APPROXIMATION, covariance + more).logpdf(y))

    lag, drag = EFFECTS[:, 0], EFFECTS[:, 1]
    evidence = Evidence(with_approximation(y), priors=Priors(form=form))
    both = joined([evidence.directions(("lag", "lag")), evidence.directions(("drag", "drag"), 0.5)])
    expected = density(4.0 * np.outer(lag, lag) + np.outer(drag, drag)) - density(np.zeros((READINGS, READINGS)))
    assert evidence.factor(both) == pytest.approx(expected, abs=1e-7)
    other = plain_covariance() + form_error(0.05)
    less = float(multivariate_normal(APPROXIMATION, other).logpdf(y))
    found = evidence.log_marginal - Evidence(with_approximation(y), priors=Priors(form=0.05)).log_marginal
    assert found == pytest.approx(density(np.zeros((READINGS, READINGS))) - less, abs=1e-6)


def test_unknown_physics_is_any_combination_of_what_a_place_has() -> None:
    """Against the dense covariance: each effect and closure of the place by one standard deviation of the noise, given
    what all models have, all together of the size that is asked for."""
    y = drawn(9, {"lag": 1.0}) + SLOTS["sheet"] @ [0.6, -0.9, 0.4] + APPROXIMATION
    covariance = plain_covariance() + form_error(0.01)
    inverse = np.linalg.inv(covariance)
    columns = np.column_stack([EFFECTS[:, 2], SLOTS["sheet"]])
    scaled = columns / np.sqrt(np.einsum("nk,nm,mk->k", columns, inverse, columns)) / np.sqrt(columns.shape[1])
    mean = APPROXIMATION
    evidence = Evidence(with_approximation(y), priors=Priors(form=0.01))
    for trace in (2.0, 20.0):
        more = covariance + trace**2 * scaled @ scaled.T
        expected = multivariate_normal(mean, more).logpdf(y) - multivariate_normal(mean, covariance).logpdf(y)
        # Directions fainter than a tenth of the noise are left out.
        assert evidence.factor(evidence.unknown_directions("sheet", trace)) == pytest.approx(expected, abs=0.02)


def test_a_named_approximation_is_in_every_model_and_is_no_answer() -> None:
    """Against the dense covariance of all readings, about the mean that the approximation has."""
    shape, rng = np.sin(11.0 * T), np.random.default_rng(20)
    y = PARAMETERS @ [0.4, -0.3] + 4.0 * shape + 1.2 * EFFECTS[:, 2] + rng.standard_normal(READINGS)
    plain = ledger(y)
    open_ = Column("approximation", "mesh", "", "", {}, "mesh", "1", 0.0, 1.0, False, 4.2, 0.5, False, -np.inf, np.inf)
    rows = np.column_stack([-PARAMETERS, -EFFECTS, -shape, y])
    blocks = blocks_of("run", 1.0, T, np.ones(READINGS, dtype=bool), rows, BLOCKS)
    found = replace(plain, columns=(*plain.columns, open_), blocks=tuple(blocks))

    def density(chosen: tuple[str, ...]) -> float:
        d = EFFECTS[:, [NAMES.index(n) for n in chosen]]
        covariance = np.eye(READINGS) + 9.0 * PARAMETERS @ PARAMETERS.T + 4.0 * d @ d.T + 0.25 * np.outer(shape, shape)
        return float(multivariate_normal(4.2 * shape, covariance).logpdf(y))

    evidence = Evidence(found, priors=Priors(form=1e-9))
    for chosen in (("creep",), ("lag", "drag")):
        expected = density(chosen) - density(())
        together = joined([evidence.directions((n, n)) for n in chosen])
        assert evidence.factor(together) == pytest.approx(expected, abs=1e-7)
    assert {e for e, _ in evidence.shapes} == set(NAMES)


def test_what_the_library_lacks_is_placed_and_what_it_has_is_named() -> None:
    beyond = posterior(with_closures(drawn(10, {}) + SLOTS["wrench"] @ [1.5, 0.8]))
    assert beyond.models[0].effects == (f"{UNKNOWN}wrench",)
    assert beyond.unknown > 0.9 and beyond.nothing < 1e-3
    named = posterior(with_closures(drawn(11, {"creep": 4.0})))
    assert named.models[0].effects == ("creep",)
    # What resembles the effect but for a little is unknown physics as well, of a place with this effect alone.
    assert named.unknown < 0.5
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
    creep = evidence.directions(("creep", "creep"))
    assert evidence.factor(creep) == pytest.approx(expected, abs=1e-7)
    (amplitude,) = evidence.amplitudes(creep)
    weight = np.exp(logs - logs.max())
    # A factor of one is two newtons.
    assert amplitude.value == pytest.approx(2.0 * np.sum(grid * weight) / np.sum(weight), rel=1e-3)
    assert amplitude.interval[0] >= 0.0


def test_what_was_drawn_is_found_with_its_size() -> None:
    found = posterior(ledger(drawn(3, {"lag": 3.0, "creep": -5.0})), priors=LIBRARY_ONLY)
    best = found.models[0]
    assert set(best.effects) == {"lag", "creep"} and best.probability > 0.5
    assert [set(m.effects) for m in found.credible(0.5)] == [{"lag", "creep"}]
    # Bootstrap samples that leave out the blocks which show an effect keep a little of it.
    assert found.nothing < 1e-3
    assert found.inclusion["creep"] > 0.65
    both = found.inclusion["creep"] + found.inclusion.get(f"{UNKNOWN}sheet", 0.0)
    assert found.in_place["sheet"] == pytest.approx(both)
    assert sum(m.probability for m in found.models) == pytest.approx(1.0)


def test_probabilities_are_as_often_right_as_they_say() -> None:
    """Sets and sizes are drawn from the prior: of all effects and recordings, those that are missing with a probability
    of p are missing in p of the cases, and nothing is missing as often as is said."""
    rng = np.random.default_rng(4)
    each = 1.0 - 0.5**0.125  # Of four effects and four places.
    said, true, nothing, none = [], [], [], []
    for seed in range(400):
        chosen = [n for n in NAMES if rng.random() < each]
        y = drawn(seed, {n: 2.0 * rng.choice(AMPLITUDES) * rng.standard_normal() for n in chosen})
        found = posterior(ledger(y), bags=0, priors=LIBRARY_ONLY)
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


def test_what_resembles_an_effect_but_is_none_is_not_surely_it() -> None:
    """A shape between two of a place, near one of them: the effect with what is left of it, and unknown physics that
    resembles it, explain it as well as each other, and neither is sure."""
    y = drawn(15, {"creep": 4.0}) + SLOTS["sheet"] @ [0.0, 0.0, 0.5]
    found = compared(with_closures(y))
    effect, unknown = ([c for c in found.candidates if c.names == (name,)] for name in ("creep", f"{UNKNOWN}sheet"))
    exact = max(c.factor for c in effect if not c.counts.any())
    left = max(c.factor for c in effect)
    assert left > exact
    assert max(c.factor for c in unknown if c.explanations[0].label) == pytest.approx(left)
    said = judged(found)
    assert said.in_place["sheet"] > 0.9
    assert 0.05 < said.inclusion["creep"] < 0.9
    # Much is left of what is unknown, not of a shape that is not looked at.
    far = judged(compared(with_closures(drawn(15, {"creep": 4.0}) + SLOTS["sheet"] @ [0.0, 0.0, 5.0])))
    assert far.inclusion[f"{UNKNOWN}sheet"] > 0.9
    # The same effect without anything else is named.
    assert judged(compared(with_closures(drawn(15, {"creep": 4.0})))).models[0].effects == ("creep",)


def test_an_effect_is_no_cause_beside_unknown_physics_of_its_place() -> None:
    found = compared(with_closures(drawn(16, {"creep": 3.0})))
    sets = {c.names for c in found.candidates}
    assert ("creep", "lag") in sets and ("creep", f"{UNKNOWN}wrench") in sets
    assert ("creep", f"{UNKNOWN}sheet") not in sets
    assert all(len(set(names)) == len(names) for names in sets)


def test_blocks_that_disagree_make_a_model_less_probable() -> None:
    """An effect that one block alone asks for is not as probable as one that all ask for, with the same Bayes factor
    in all data."""
    rng = np.random.default_rng(5)
    y = drawn(6, {})
    here = (T > 0.5) & (T < 0.58)
    y[here] += 3.5 * np.sign(EFFECTS[here, 0]) * np.abs(rng.standard_normal(here.sum()))
    alone = posterior(ledger(y), bags=0, priors=LIBRARY_ONLY).inclusion
    bagged = posterior(ledger(y), priors=LIBRARY_ONLY).inclusion
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
    found, before = Evidence(less), Evidence(given)
    kept = found.factor(found.directions(("creep", "creep")))
    assert kept == pytest.approx(before.factor(before.directions(("creep", "creep"))), abs=1e-4)
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
    assert evidence.left(evidence.directions(("lag", "lag"))) == pytest.approx(1.0, abs=0.25)
    assert evidence.left(joined([])) > 2.0


def test_several_effects_of_one_place_may_be_unknown_physics_that_looks_like_them() -> None:
    """As far as the recordings tell they are equally probable. Effects of two places are no mixture."""
    plain = with_closures(drawn(17, {"lag": 3.0, "creep": 4.0}))
    other_place = replace(
        plain, columns=tuple(replace(c, place="sheet") if c.owner == "lag" else c for c in plain.columns)
    )
    found = compared(other_place)
    pair = [c for c in found.candidates if c.names == ("creep", "lag")]
    same = [c for c in found.candidates if c.names == (f"{UNKNOWN}sheet",) and c.counts[PLACE["mixture"]]]
    assert sorted(c.factor for c in same) == sorted(c.factor for c in pair)
    said = judged(found)
    # Of two effects of a place there is one mixture, and one unknown thing is more probable than two known ones.
    assert said.in_place["sheet"] > 0.9 and said.models[0].effects == (f"{UNKNOWN}sheet",)
    assert not any(c.counts[PLACE["mixture"]] for c in compared(plain).candidates)
