"""The command that builds the actions with wheels, up to where it begins to build."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = Path(__file__).parents[2] / "interfaces" / "build_with_wheels.py"


@pytest.mark.parametrize(("words", "code"), [(["--help"], 0), (["-h"], 0), ([], 2), (["a", "b"], 2), (["--folder"], 2)])
def test_without_one_folder_it_says_how_it_is_called_and_builds_nothing(
    words: list[str], code: int, tmp_path: Path
) -> None:
    done = subprocess.run(
        [sys.executable, str(COMMAND), *words], cwd=tmp_path, capture_output=True, text=True, timeout=20
    )
    assert done.returncode == code
    assert "python interfaces/build_with_wheels.py FOLDER" in (done.stderr if code else done.stdout)
    assert not list(tmp_path.iterdir())


def test_a_file_in_place_of_the_folder_is_named(tmp_path: Path) -> None:
    there = tmp_path / "file"
    there.touch()
    done = subprocess.run([sys.executable, str(COMMAND), str(there)], capture_output=True, text=True, timeout=20)
    assert done.returncode == 2
    assert done.stderr == f"error: {there} is a file, and a folder is wanted. Name a new folder.\n"
