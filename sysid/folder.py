"""Folders of results that are there whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """A folder to write into that becomes ``out`` when the block ends without an error.

    Where ``out`` exists, the files go into it, each at once. Until then the folder is :func:`unfinished`, which an
    error removes and a killed process leaves behind.
    """
    part = unfinished(out)
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        yield part
        if out.exists():
            for file in part.iterdir():
                os.replace(file, out / file.name)
            part.rmdir()
        else:
            os.replace(part, out)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def unfinished(out: Path) -> Path:
    """Where the results that will be in ``out`` are until all are written."""
    return out.with_name(f".{out.name}.unfinished")
