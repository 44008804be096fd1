"""``thinshell ledger``: a diagnosis judged again, as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from sysid.cli import app
from sysid.comparison.ledger import Column, Ledger, blocks_of

T = np.linspace(0.0, 1.0, 200)
SHAPES = {"gel_relaxation": np.sin(7.0 * T), "hand_backlash": T**2}
PLACES = {"gel_relaxation": "gel", "hand_backlash": "robot"}
CLOSURES = np.sin(np.outer(T, [11.0, 17.0, 23.0, 29.0]))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Of a diagnosis in which a relaxation of 6 N stands in readings of unit noise."""
    rng = np.random.default_rng(1)
    columns = [
        Column("effect", name, PLACES[name], name, {}, "size", "N", 0.0, 2.0, False, 0.0, 2.0, False, -9.0, 9.0)
        for name in SHAPES
    ]
    columns += [
        Column("closure", "gel pad", "gel", "it is off", {}, f"{k}", "1", 0.0, 1.0, False, 0.0, 1.0, False, -9.0, 9.0)
        for k in range(CLOSURES.shape[1])
    ]
    y = 3.0 * SHAPES["gel_relaxation"] + rng.standard_normal(len(T))
    rows = np.column_stack([*(-d for d in SHAPES.values()), -CLOSURES, y])
    blocks = blocks_of("press", 1.0, T, np.ones(len(T), dtype=bool), rows)
    Ledger(tuple(columns), tuple(blocks), {}).write(tmp_path / "ledger.npz")
    return tmp_path


def test_the_posterior_is_printed_with_sizes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["ledger", str(folder)]) == 0
    shown = capsys.readouterr().out
    assert "200 readings in 12 blocks of 1 recordings" in shown
    assert "gel_relaxation.size = " in shown and "left: mean squared misfit" in shown
    assert app.main(["ledger", str(folder), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["inclusion"]["gel_relaxation"] > 0.8
    low, high = data["models"][0]["amplitudes"][0]["ci95"]
    assert low < 6.0 < high


def test_without_the_effect_the_recordings_say_less(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["ledger", str(folder), "--without", "gel_relaxation", "--json"]
    assert app.main(arguments) == 0
    data = json.loads(capsys.readouterr().out)
    assert "gel_relaxation" not in data["inclusion"] and data["models"][0]["left"] > 2.0


def test_two_diagnoses_are_compared(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["ledger", str(folder), "--compare", str(folder / "ledger.npz")]) == 0
    assert "in the first and in the second" in capsys.readouterr().out


@pytest.mark.parametrize(("words", "said"), [(["--without", "play"], "no columns of play"), ([], "cannot be read")])
def test_what_cannot_be_judged_is_said(
    folder: Path, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder if words else folder / "nowhere"
    assert app.main(["ledger", str(path), *words]) == 2
    assert said in capsys.readouterr().err
