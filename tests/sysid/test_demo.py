"""The demonstration deletes nothing but what an earlier one left in its own folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim_core.errors import ConfigError
from sysid import demo


class Began(Exception):
    """The demonstration got past its checks."""


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def begin(name: str) -> None:
        raise Began

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(demo, "load_rig", begin)


def test_a_folder_with_something_in_it_is_refused() -> None:
    precious = Path("home/thesis.tex")
    precious.parent.mkdir()
    precious.write_text("ten years")
    with pytest.raises(ConfigError, match=r"home already exists and is not empty\. Name a new one"):
        demo.main(precious.parent)
    with pytest.raises(ConfigError, match="already exists"):
        demo.main(precious)
    assert precious.read_text() == "ten years"


def test_new_and_empty_folders_are_used() -> None:
    Path("empty").mkdir()
    for folder in ("empty", "new/deep"):
        with pytest.raises(Began):
            demo.main(Path(folder))
        assert Path(folder).is_dir()


def test_the_default_folder_is_replaced() -> None:
    left = demo.DEFAULT / "old.bag"
    left.mkdir(parents=True)
    with pytest.raises(Began):
        demo.main()
    assert demo.DEFAULT.is_dir() and not left.exists()
