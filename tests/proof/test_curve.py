"""Effects concealed in ledgers, and rates by strength, on linear models with known answers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sysid.comparison.injection import Injection, injected
from sysid.comparison.ledger import Column, Ledger, blocks_of
from sysid.comparison.posterior import posterior
from sysid.proof.curve import Judged, drawn_case, half_seen, make_curve, rates_of

READINGS = 400
T = np.linspace(0.0, 1.0, READINGS)
COLUMNS = {
    ("parameter", "E", ""): np.ones(READINGS),
    ("effect", "air_drag", "slow"): np.sin(9.0 * T),
    ("effect", "air_drag", "fast"): np.sin(9.2 * T),
    ("effect", "wrench_gain", "wrench_gain"): np.exp(-5.0 * T),
    ("closure", "air strip", "unknown"): np.cos(23.0 * T),
}


def ledger(y: np.ndarray) -> Ledger:
    columns = [
        Column(kind, owner, label, {}, "size", "1", 0.0, 1.0, False, 0.0, 5.0, False, -np.inf, np.inf)  # type: ignore[arg-type]
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
    found = injected(ledger(y), Injection("wrench_gain", "wrench_gain", 12.0), np.random.default_rng(2))
    shape = COLUMNS[("effect", "wrench_gain", "wrench_gain")]
    # What the mean, known to 5, and the narrow closure leave of the effect.
    beside = np.column_stack([5.0 * np.ones(READINGS), 0.1 * COLUMNS[("closure", "air strip", "unknown")]])
    left = shape @ np.linalg.solve(np.eye(READINGS) + beside @ beside.T, shape)
    size = 12.0 / np.sqrt(left)
    changes = [ledger(y + sign * size * shape) for sign in (1.0, -1.0)]
    errors = [max(np.abs(a.gram - b.gram).max() for a, b in zip(found.blocks, c.blocks, strict=True)) for c in changes]
    assert min(errors) < 1e-6 * found.gram[-1, -1]
    assert posterior(found, bags=0).models[0].effects == ("wrench_gain",)


def test_the_shape_that_is_concealed_is_not_looked_at() -> None:
    empty, rng = ledger(noise(3)), np.random.default_rng(4)
    cases = [drawn_case("empty", empty, rng) for _ in range(60)]
    strong = [c for c in cases if c.trace > 20.0]
    assert np.mean([c.right for c in strong if c.inside]) > 0.9
    # What the library does not have is not named rightly.
    assert all(c.effect not in c.said for c in cases if not c.inside)


def judged(effect: str, trace: float, odds: float, said: tuple[str, ...] = (), sure: float = 0.5) -> Judged:
    return Judged("empty", effect, trace, True, odds, said, sure)


def test_rates_are_those_of_the_cases() -> None:
    empty = [judged("", 0.0, odds) for odds in (-3.0, 1.0)]
    weak = [judged("air_drag", 3.0, 0.5, ("wrench_gain",), 0.95), judged("air_drag", 3.5, 2.0, ("air_drag",), 0.95)]
    strong = [judged("air_drag", 50.0, 90.0, ("air_drag",), 1.0)] * 3
    rates = rates_of([*empty, *weak, *strong])
    assert rates.alarm_level_nats == 1.0 and rates.empty_ledgers == 2 and rates.named_empty == 0.0
    first, last = rates.bins[0], rates.bins[-1]
    assert (first.cases, first.noticed, first.right_name, first.among, first.wrong) == (2, 0.5, 0.5, 0.5, 0.5)
    assert (last.cases, last.noticed, last.right_name, last.right_place, last.wrong) == (3, 1.0, 1.0, None, 0.0)
    with_another = judged("air_drag", 50.0, 90.0, ("air_drag", "wrench_gain"), 1.0)
    assert rates_of([*empty, with_another]).bins[-1].among == 1.0
    assert rates_of([*empty, with_another]).bins[-1].right_name == 0.0


def test_unknown_in_its_place_is_right_for_what_the_library_lacks() -> None:
    there = Judged("empty", "air_drag", 50.0, False, 90.0, ("unknown: air strip",), 1.0)
    elsewhere = Judged("empty", "air_drag", 50.0, False, 90.0, ("unknown: robot hand",), 1.0)
    named = Judged("empty", "air_drag", 50.0, False, 90.0, ("air_drag",), 1.0)
    assert (there.right, elsewhere.right, named.right) == (True, False, False)


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
    with pytest.raises(ConfigError, match="0 ledgers"):
        make_curve(tmp_path / "out", tmp_path / "again", cases=1)
