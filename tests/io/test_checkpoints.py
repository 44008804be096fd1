"""What a command keeps from stage to stage."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from sim_core.effects import effect_by_name
from sim_core.errors import ConfigError
from sysid.io.checkpoints import CHECKPOINTS, checkpoints, digest_of


@dataclass
class Pair:
    name: str
    values: np.ndarray


def begin(out: Path, notes: list[str], made: list[object], *, fail: bool = True, rig: str = "a") -> list[object]:
    """Two stages, each of which says when it is made, and an interruption."""
    with checkpoints(out, {"rig": rig, "settings": {"a": 1.0}}, notes.append) as kept:
        kept.live("engine", begin)
        found: list[object] = []
        for name in ("first", "second"):
            found.append(kept.stage(name, lambda: made.append(name) or (name, begin, effect_by_name("air_drag")), 1.0))  # noqa: B023
        if fail:
            raise KeyboardInterrupt
    return found


def test_stages_are_made_once_and_refer_to_what_lives(tmp_path: Path) -> None:
    notes: list[str] = []
    made: list[object] = []
    with pytest.raises(KeyboardInterrupt):
        begin(tmp_path / "out", notes, made)
    first, _ = begin(tmp_path / "out", notes, made, fail=False)
    assert made == ["first", "second"] and "It goes on from 2 stages" in notes[0]
    assert first == ("first", begin, effect_by_name("air_drag"))
    assert not (tmp_path / "out" / CHECKPOINTS).exists()


def test_a_damaged_stage_is_made_again(tmp_path: Path) -> None:
    notes: list[str] = []
    made: list[object] = []
    with pytest.raises(KeyboardInterrupt):
        begin(tmp_path, notes, made)
    (damaged,) = (tmp_path / CHECKPOINTS).glob("first-*.stage")
    damaged.write_bytes(damaged.read_bytes()[:20])
    begin(tmp_path, notes, made, fail=False)
    assert made == ["first", "second", "first"]


def test_other_inputs_begin_anew_and_are_named(tmp_path: Path) -> None:
    notes: list[str] = []
    made: list[object] = []
    with pytest.raises(KeyboardInterrupt):
        begin(tmp_path, notes, made)
    begin(tmp_path, notes, made, fail=False, rig="b")
    assert made == ["first", "second"] * 2
    assert notes == [f"{tmp_path} holds what was found with rig of other contents. It begins anew."]


def test_nothing_is_left_where_no_stage_has_ended(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), checkpoints(tmp_path / "a" / "b", {}):
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="Name another place"), checkpoints(tmp_path / "file" / "out", {}):
        pass


@pytest.mark.parametrize(
    "other",
    [
        ("a", Pair("b", np.arange(3.0))),
        ("b", Pair("a", np.arange(3.0))),
        ("a", Pair("a", np.arange(3.0) + 1e-12)),
        ("a", Pair("a", np.arange(3))),
        ("a", Pair("a", np.arange(3.0)), None),
    ],
)
def test_a_digest_tells_values_apart(other: tuple[object, ...]) -> None:
    mine = ("a", Pair("a", np.arange(3.0)))
    assert digest_of(*mine) == digest_of(*mine) != digest_of(*other)
    assert digest_of({"a": 1, "b": 2}) == digest_of({"b": 2, "a": 1}) != digest_of({"a": 2, "b": 1})


def test_what_has_no_value_has_no_digest() -> None:
    with pytest.raises(TypeError, match="has no digest"):
        digest_of(lambda: 0)
