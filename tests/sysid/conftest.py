"""A recording of a press, as it is and to be changed."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from recording_files import write


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("bags") / "press")


@pytest.fixture
def bag(healthy: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(healthy, tmp_path / "press"))
