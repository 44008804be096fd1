"""Folders of results that are there whole or not at all."""

from pathlib import Path

import pytest

from sysid.folder import unfinished, whole_folder


def test_a_folder_appears_when_all_is_written(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "fit"
    with whole_folder(out) as folder:
        (folder / "a").write_text("1")
        assert not out.exists()
        assert folder == unfinished(out)
    assert [p.name for p in tmp_path.rglob("*")] == ["deep", "fit", "a"]


def test_an_error_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), whole_folder(tmp_path / "fit") as folder:
        (folder / "a").write_text("1")
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_a_folder_that_exists_keeps_what_it_has_and_what_a_killed_process_left_is_gone(tmp_path: Path) -> None:
    out = tmp_path / "fit"
    out.mkdir()
    (out / "mine").write_text("0")
    unfinished(out).mkdir()
    (unfinished(out) / "old").write_text("0")
    with whole_folder(out) as folder:
        (folder / "a").write_text("1")
    assert sorted(p.name for p in out.iterdir()) == ["a", "mine"]
    assert [p.name for p in tmp_path.iterdir()] == ["fit"]
