"""What the posterior of a ledger says in words, on linear models with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.comparison.ledger import Column, Ledger, blocks_of
from sysid.diagnosis.one_model import OneModel, one_model

READINGS = 400
T = np.linspace(0.0, 1.0, READINGS)
EFFECTS = {
    "air_drag": ("environment", np.sin(9.0 * T)),
    "wrench_gain": ("wrench", np.exp(-5.0 * T)),
    "wrench_frame": ("wrench", np.exp(-5.05 * T)),
}
CLOSURES = {
    place: np.sin(np.outer(T, first + 7.0 * np.arange(5.0)) + first)
    for place, first in (("environment", 17.0), ("wrench", 19.0), ("robot", 22.0))
}


def said(y: np.ndarray) -> OneModel:
    rest = ("size", "1", 0.0, 1.0, False, 0.0)
    columns = [
        Column("effect", name, place, name, {}, *rest, 5.0, False, -np.inf, np.inf)
        for name, (place, _) in EFFECTS.items()
    ]
    columns += [
        Column("closure", f"{place} of it", place, "off", {}, *rest, 1.0, False, -np.inf, np.inf)
        for place, shapes in CLOSURES.items()
        for _ in shapes.T
    ]
    rows = np.column_stack([*(-d for _, d in EFFECTS.values()), *(-c for c in CLOSURES.values()), y])
    return one_model(Ledger(tuple(columns), tuple(blocks_of("run", 1.0, T, np.ones(READINGS, dtype=bool), rows)), {}))


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(READINGS)


def test_nothing_is_missing_in_noise() -> None:
    found = said(noise(1))
    assert (found.kind, found.answer) == ("nothing_missing", ())
    assert found.nothing > 0.5 and found.sentence.startswith("By the one model: nothing is missing (")
    assert "Most probably" not in found.sentence


def test_an_effect_is_named_with_its_place() -> None:
    found = said(noise(2) + 4.0 * EFFECTS["air_drag"][1])
    assert (found.kind, found.answer) == ("named", ("air_drag",))
    assert next(iter(found.places)) == "environment" and next(iter(found.effects)) == "air_drag"
    assert "Nothing: less than 1 %" in found.sentence
    assert "in what acts on the bodies from outside" in found.sentence


def test_effects_that_recordings_do_not_tell_apart_are_one_answer() -> None:
    found = said(noise(3) + 8.0 * EFFECTS["wrench_gain"][1])
    assert found.kind == "one_of" and set(found.answer) == {"wrench_gain", "wrench_frame"}
    assert "; or " in found.sentence
    assert sum(s.probability for s in found.sets) == pytest.approx(sum(found.effects.values()), abs=0.15)


def test_what_no_effect_describes_is_unknown_in_its_place() -> None:
    found = said(noise(4) + CLOSURES["robot"] @ [1.5, -1.0, 0.8, 1.2, -0.9])
    assert (found.kind, found.answer) == ("unknown", ())
    assert next(iter(found.places)) == "robot" and found.unknown > 0.9
    assert "something that no known effect describes is missing in the motion of the hand" in found.sentence
