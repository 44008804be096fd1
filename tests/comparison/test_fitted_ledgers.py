"""Sets of effects that are compared where they are fitted, on linear models with known results."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid.comparison.evidence import Evidence, joined
from sysid.comparison.explanations import UNKNOWN
from sysid.comparison.ledger import AMPLITUDE, Column, Ledger, LedgerError, blocks_of, read_ledger
from sysid.comparison.posterior import FITTED, compared, judged, posterior, temper_of
from sysid.comparison.priors import PRIORS

N = 300
T = np.linspace(0.0, 1.0, N)
OFFSET = np.ones(N)
LAWS = {"creep": np.exp(-6.0 * T), "lag": np.sin(7.0 * T)}
PLACES = {"creep": "sheet", "lag": "robot"}
CLOSURES = np.stack([np.sin(3.0 * T), np.cos(3.0 * T), np.sin(5.0 * T)], axis=1)
SD = 2.0
NARROW = replace(PRIORS, form=1e-7)


def ledger(y: np.ndarray, fitted: dict[str, float], begin: int = 0, kept: np.ndarray | None = None) -> Ledger:
    """Linearised where laws have these sizes, of readings that are ``kept`` ``(n,)``, with closures of the sheet.
    ``begin``: number of the first reading that anything acts on."""
    acting = np.arange(N) >= begin
    columns = [Column("parameter", "offset", "", "", {}, "offset", "N", 0.0, 1.0, False, 0.0, 3.0, False, -9.0, 9.0)]
    rows = [-OFFSET * acting]
    for name, size in fitted.items():
        columns.append(Column("parameter", name, PLACES[name], AMPLITUDE, {}, f"effects.{name}.size", "N", size, 1.0,
                              False, -size, SD, False, -9.0, 9.0))  # fmt: skip
        rows.append(-LAWS[name] * acting)
    for name in LAWS.keys() - fitted.keys():
        columns.append(Column("effect", name, PLACES[name], "plain", {}, "size", "N", 0.0, 1.0, False, 0.0, SD, False,
                              -9.0, 9.0))  # fmt: skip
        rows.append(-LAWS[name] * acting)
    for k, course in enumerate(CLOSURES.T):
        columns.append(Column("closure", "sheet strip", "sheet", "stiffness", {}, f"by {k}", "1", 0.0, 1.0, False, 0.0,
                              0.5, False, -9.0, 9.0))  # fmt: skip
        rows.append(-course * acting)
    left = y - sum((size * LAWS[n] * acting for n, size in fitted.items()), np.zeros(N))
    table = np.column_stack([*rows, left])[np.ones(N, dtype=bool) if kept is None else kept]
    at = T if kept is None else T[kept]
    return Ledger(tuple(columns), tuple(blocks_of("run", 1.0, at, np.ones(len(at), dtype=bool), table, 3)), {})


def drawn(seed: int, creep: float, rest: float = 0.0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(N) + creep * LAWS["creep"] + rest * CLOSURES[:, 2]


def own(found: Ledger, names: tuple[str, ...]) -> float:
    """log B of a set where it is fitted."""
    return max(
        c.factor
        for c in compared(found, NARROW).candidates
        if c.names == names and c.at and all(e.label == FITTED for e in c.explanations) and not c.counts.any()
    )


def test_a_reading_that_is_out_of_sight_counts_as_missed_by_its_noise() -> None:
    """Of readings that nothing acts on, what the law hides counts half a nat each, whatever it missed there."""
    rest = 0.9 * np.random.default_rng(1).standard_normal(N)  # So quiet that no temper divides it.
    kept = np.arange(N) >= 40
    y = rest + 4.0 * LAWS["creep"] * kept
    plain = ledger(y, {}, 40)
    whole, less = (replace(plain, amended=(ledger(y, {"creep": 4.0}, 40, k),)) for k in (None, kept))
    assert temper_of(whole.amended[0]) == temper_of(less.amended[0]) == 1.0
    missed = float(np.sum(rest[:40] ** 2))
    assert own(less, ("creep",)) - own(whole, ("creep",)) == pytest.approx(0.5 * (missed - 40.0), abs=1e-6)


def test_data_weigh_what_the_best_model_leaves() -> None:
    """Along the baseline nothing makes up for a law that is not linear; where it is fitted it leaves noise alone."""
    y = drawn(2, 4.0)
    far = ledger(y + 20.0 * np.sign(np.sin(90.0 * T)), {})
    there = ledger(y, {"creep": 4.0})
    assert temper_of(far) > 100.0
    assert {e.temper for e in compared(replace(far, amended=(there,))).evidences} == {max(1.0, temper_of(there))}


def test_what_is_left_of_a_fitted_effect_is_looked_at_where_it_is() -> None:
    """With something else of its place the effect and its rest, and unknown physics that resembles it but for that,
    explain it as well as each other, and neither is sure; without, the effect is named."""
    for rest, sure in ((0.0, True), (1.0, False)):
        y = drawn(3, 4.0, rest)
        found = compared(replace(ledger(y, {}), amended=(ledger(y, {"creep": 4.0}),)))
        effect, unknown = (
            [c for c in found.candidates if c.names == (name,) and c.at] for name in ("creep", f"{UNKNOWN}sheet")
        )
        exact = max(c.factor for c in effect if not c.counts.any())
        left = max(c.factor for c in effect if c.counts.any())
        assert (left > exact) == (not sure)
        assert max(c.factor for c in unknown) == pytest.approx(left)
        said = judged(found)
        assert said.models[0].effects == ("creep",) if sure else said.inclusion["creep"] < 0.9


def test_without_an_effect_nothing_that_is_fitted_with_it_is_left(tmp_path: Path) -> None:
    y = drawn(4, 4.0)
    found = replace(ledger(y, {}), amended=(ledger(y, {"creep": 4.0}), ledger(y, {"lag": 0.0})))
    less = found.without(["creep"])
    assert [one.fitted for one in less.amended] == [{"lag": "robot"}]
    assert posterior(less, bags=0).inclusion.get("creep", 0.0) == 0.0
    path = tmp_path / "ledger.npz"
    found.write(path)
    again = read_ledger(path)
    assert [one.fitted for one in again.amended] == [{"creep": "sheet"}, {"lag": "robot"}]
    for one, other in zip((found, *found.amended), (again, *again.amended), strict=True):
        np.testing.assert_array_equal(one.gram, other.gram)
    with np.load(path) as kept:
        spoilt = {k: kept[k] for k in kept.files if k != "grams_1"}
    np.savez(path, **spoilt)
    with pytest.raises(LedgerError):
        read_ledger(path)


@pytest.mark.parametrize("shared", [False, True])
def test_fitted_sizes_have_the_posterior_of_least_squares(shared: bool) -> None:
    """Jointly with the offset, and with a direction that has much in common with them."""
    y = drawn(5, 4.0)
    evidence = Evidence(ledger(y, {"creep": 3.5}), priors=NARROW)
    further = joined([evidence.directions(("lag", "plain"))] if shared else [])
    (found,) = evidence.fitted_amplitudes(further)
    table = np.column_stack([OFFSET, LAWS["creep"], *([LAWS["lag"]] if shared else [])])
    sd = np.array([3.0, SD, SD][: table.shape[1]])
    covariance = np.linalg.inv(table.T @ table + np.diag(sd**-2.0))
    mean = covariance @ table.T @ y
    assert found.value == pytest.approx(mean[1], abs=1e-5)
    assert found.interval == pytest.approx(mean[1] + 1.96 * np.sqrt(covariance[1, 1]) * np.array([-1.0, 1.0]), abs=1e-5)
