"""Effects concealed in ledgers, and rates by strength, on linear models with known results."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sysid.comparison.injection import LARGEST, Concealer, Injection, injected
from sysid.comparison.ledger import Column, Ledger, blocks_of
from sysid.comparison.posterior import compared, posterior
from sysid.comparison.priors import PRIORS
from sysid.proof import form_error_table
from sysid.proof.curve import Judged, drawn_cases, half_seen, make_curve, rates_of

READINGS = 400
T = np.linspace(0.0, 1.0, READINGS)
COLUMNS = {
    ("parameter", "E", ""): np.ones(READINGS),
    ("effect", "air_drag", "slow"): np.sin(9.0 * T),
    ("effect", "air_drag", "fast"): np.sin(9.2 * T),
    ("effect", "wrench_gain", "wrench_gain"): np.exp(-5.0 * T),
    **{("closure", "environment strip", f"{k}"): np.cos(k * T) for k in (17.0, 23.0, 29.0, 37.0)},
    **{("closure", "wrench wrist", f"{k}"): np.sin(k * T) for k in (19.0, 27.0, 31.0, 39.0)},
}

PLACES = {
    "air_drag": "environment",
    "wrench_gain": "wrench",
    "environment strip": "environment",
    "wrench wrist": "wrench",
}

SHAPES = {"slow": {"rate": 9.0}, "fast": {"rate": 9.2}}


def ledger(y: np.ndarray) -> Ledger:
    rest = ("size", "1", 0.0, 1.0, False, 0.0, 5.0, False, -np.inf, np.inf)
    columns = [
        Column(kind, owner, PLACES.get(owner, ""), label, SHAPES.get(label, {}), *rest)  # type: ignore[arg-type]
        for kind, owner, label in COLUMNS
    ]
    rows = np.column_stack([*(-c for c in COLUMNS.values()), y])
    blocks = blocks_of("run", 1.0, T, np.ones(READINGS, dtype=bool), rows, 6)
    return Ledger(tuple(columns), tuple(blocks), {})


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(READINGS)


def test_a_concealed_effect_is_as_if_the_readings_had_it() -> None:
    """Against the ledger of readings that were changed, block by block."""
    y = noise(1)
    injection = Injection("wrench_gain", "wrench_gain", 12.0)
    change = Concealer(ledger(y)).change(injection, np.random.default_rng(2))
    assert change is not None
    found = injected(ledger(y), change)
    shape = COLUMNS[("effect", "wrench_gain", "wrench_gain")]
    # What the mean, known to 5, leaves of the effect.
    left = shape @ np.linalg.solve(np.eye(READINGS) + 25.0 * np.ones((READINGS, READINGS)), shape)
    size = 12.0 / np.sqrt(left)
    changes = [ledger(y + sign * size * shape) for sign in (1.0, -1.0)]
    errors = [max(np.abs(a.gram - b.gram).max() for a, b in zip(found.blocks, c.blocks, strict=True)) for c in changes]
    assert min(errors) < 1e-6 * found.gram[-1, -1]
    assert posterior(found, bags=0).models[0].effects == ("wrench_gain",)


def test_the_shape_that_is_concealed_is_not_looked_at() -> None:
    drawn = drawn_cases({"empty": ledger(noise(3))}, 60, np.random.default_rng(4))
    for one in (c for c in drawn if c.inside and c.effect == "air_drag"):
        assert len({c.hypothesis for c in one.ledger.columns if c.owner == "air_drag"}) == 1
    cases = [c.judged(compared(c.ledger), PRIORS) for c in drawn]
    # The probability of what is concealed is that of the answer where this is right, and small elsewhere.
    assert all(c.true == pytest.approx(c.sure) if c.right else c.true < 0.5 for c in cases)
    strong = [c for c in cases if c.trace > 20.0]
    assert np.mean([c.right for c in strong if c.inside]) > 0.9
    # What the library does not have is not named rightly.
    assert all(c.effect not in c.said for c in cases if not c.inside)


def test_an_effect_is_concealed_in_the_shape_that_was_drawn_for_it_and_within_its_prior() -> None:
    plain, y = ledger(noise(5)), noise(5)
    between = np.sin(9.1 * T)
    drawn = replace(plain.columns[1], kind="concealed", hypothesis="drawn")
    rows = np.column_stack([*(-c for c in COLUMNS.values()), -between, y])
    blocks = blocks_of("run", 1.0, T, np.ones(READINGS, dtype=bool), rows, 6)
    found = Ledger((*plain.columns, drawn), tuple(blocks), {})
    concealer = Concealer(found)
    assert concealer.shapes == {"air_drag": ["drawn"], "wrench_gain": ["wrench_gain"]}
    change = concealer.change(Injection("air_drag", "drawn", 20.0), np.random.default_rng(6))
    assert change is not None and np.flatnonzero(change).tolist() == [len(COLUMNS)]
    # All shapes that are looked at are still in the library, and the drawn one is in no model.
    case = injected(found, change)
    assert {h for e, h in compared(case).evidences[0].shapes if e == "air_drag"} == {"slow", "fast"}
    assert posterior(case, bags=0).models[0].effects == ("air_drag",)
    # A direction that is LARGEST deviations of the prior away has this trace at most.
    most = LARGEST * 5.0 * float(np.linalg.norm(between - between.mean()))
    assert concealer.change(Injection("air_drag", "drawn", 0.9 * most), np.random.default_rng(6)) is not None
    assert concealer.change(Injection("air_drag", "drawn", 1.1 * most), np.random.default_rng(6)) is None


def judged(effect: str, trace: float, odds: float, said: tuple[str, ...] = (), sure: float = 0.5) -> Judged:
    places = [PLACES[name] for name in said]
    return Judged("empty", effect, PLACES.get(effect, ""), trace, True, odds, said, sure, (*places, "")[0], 0.25)


def test_rates_are_those_of_the_cases() -> None:
    empty = [judged("", 0.0, odds) for odds in (-3.0, 1.0)]
    weak = [judged("air_drag", 3.0, 0.5, ("wrench_gain",), 0.95), judged("air_drag", 3.5, 2.0, ("air_drag",), 0.95)]
    strong = [judged("air_drag", 50.0, 90.0, ("air_drag",), 1.0)] * 3
    rates = rates_of([*empty, *weak, *strong])
    assert rates.alarm_level_nats == 1.0 and rates.empty_ledgers == 2 and rates.named_empty == 0.0
    first, last = rates.bins[0], rates.bins[-1]
    assert (first.cases, first.noticed, first.right_name, first.among, first.wrong) == (2, 0.5, 0.5, 0.5, 0.5)
    assert first.right_place is None and first.unknown is None
    assert (last.cases, last.noticed, last.right_name, last.wrong) == (3, 1.0, 1.0, 0.0)
    assert last.score == pytest.approx(np.log(0.99 * 0.25 + 0.01))
    with_another = judged("air_drag", 50.0, 90.0, ("air_drag", "wrench_gain"), 1.0)
    assert rates_of([*empty, with_another]).bins[-1].among == 1.0
    assert rates_of([*empty, with_another]).bins[-1].right_name == 0.0


def test_unknown_in_its_place_is_right_for_what_the_library_lacks() -> None:
    def outside(said: str, place: str) -> Judged:
        return Judged("empty", "air_drag", "environment", 50.0, False, 90.0, (said,), 1.0, place, 0.5)

    there, elsewhere = outside("unknown: environment", "environment"), outside("unknown: robot", "robot")
    named = outside("air_cushion", "environment")
    assert (there.right, elsewhere.right, named.right) == (True, False, False)
    (*_, last) = rates_of([judged("", 0.0, 0.0), there, elsewhere, named]).bins
    assert (last.unknown, last.right_place) == (pytest.approx(1.0 / 3.0), pytest.approx(2.0 / 3.0))


def test_the_table_of_form_errors_has_their_size_and_how_much_there_is(tmp_path: Path) -> None:
    """Of an approximation of which the readings have 0.6: 20 T^2 less the mean that the modulus takes up."""
    shape = 20.0 * T**2
    plain = ledger(noise(7) + 0.6 * shape)
    own = Column("approximation", "mesh", "", "", {}, "mesh", "1", 0.0, 1.0, False, 1.0, 0.3, False, -np.inf, np.inf)
    rows = np.column_stack([*(-c for c in COLUMNS.values()), -shape, noise(7) + 0.6 * shape])
    blocks = blocks_of("run", 1.0, T, np.ones(READINGS, dtype=bool), rows, 6)
    Ledger((*plain.columns, own), tuple(blocks), {}).write(tmp_path / "ledger.npz")
    (tmp_path / "truth.json").write_text(json.dumps({"effects": []}))
    line = form_error_table(tmp_path).splitlines()[1].split()
    assert line[1:3] == ["mesh", "1"]
    size = float(np.linalg.norm(shape - shape.mean()))
    assert float(line[3]) == pytest.approx(size, rel=0.01)
    assert float(line[4]) == pytest.approx(0.6, abs=4.0 / size + 0.005)
    # Without it, the mean is all that takes it up, and the noise has to be the rest.
    assert float(line[7]) > 0.25 * (0.6 * size) ** 2


def test_half_is_seen_between_what_is_not_and_what_is() -> None:
    assert half_seen([2.0, 4.0, 8.0, 16.0], [False, False, True, True]) == pytest.approx(np.sqrt(32.0))
    assert half_seen([2.0, 4.0], [True, True]) == 2.0
    assert half_seen([2.0, 4.0], [False, False]) == 4.0
    # One that is missed far up and one that is seen far down change nothing.
    traces, seen = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0], [True, False, False, False, True, True, False, True]
    assert half_seen(traces, seen) == pytest.approx(np.sqrt(20.0))


def test_a_curve_comes_from_ledgers_that_conceal_nothing(tmp_path: Path) -> None:
    for k, effects in enumerate(([], [], [{"name": "air_drag"}])):
        case = tmp_path / f"case_{k}"
        case.mkdir()
        ledger(noise(k)).write(case / "ledger.npz")
        (case / "truth.json").write_text(json.dumps({"effects": effects}))
    words = make_curve(tmp_path, tmp_path / "out", cases=12, seed=1)
    assert "from 2 empty recordings" in words
    kept = json.loads((tmp_path / "out" / "curve.json").read_text())
    assert len(kept["cases"]) == 14 and {c["ledger"] for c in kept["cases"]} == {"case_0", "case_1"}
    assert kept["numbers"] == {}
    # Each part is judged by what was learnt from the other.
    make_curve(tmp_path, tmp_path / "learnt", cases=4, seed=1, folds=2)
    numbers = json.loads((tmp_path / "learnt" / "curve.json").read_text())["numbers"]
    assert set(numbers) == {"case_0", "case_1"} and numbers["case_0"]["unknown"] != numbers["case_1"]["unknown"]
    with pytest.raises(ConfigError, match=r"2 ledgers.* 3 are needed"):
        make_curve(tmp_path, tmp_path / "again", cases=1, folds=3)
    with pytest.raises(ConfigError, match="0 ledgers"):
        make_curve(tmp_path / "out", tmp_path / "again", cases=1)
