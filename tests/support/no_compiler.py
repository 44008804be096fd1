"""A machine without a C++ compiler, and without libraries of laws that were compiled before."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim_core.core import pointwise


def without_compiler(patch: pytest.MonkeyPatch) -> None:
    """Let laws of effects find none."""
    nowhere = Path("nowhere")
    patch.setattr(pointwise, "compiler", lambda: None)
    patch.setattr(pointwise, "BUILT", nowhere)
    patch.setattr(pointwise, "cache_folder", lambda: nowhere)
    pointwise._warn_of_numpy.cache_clear()
