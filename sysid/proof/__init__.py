"""Proof on concealed physics: make sealed cases, diagnose them blind, then score the answers.

Only :mod:`sysid.proof.generator` and :mod:`sysid.proof.truths` know how cases are made; they are imported by
:func:`make_cases` and :func:`record_cases` alone.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

__all__ = ["make_cases", "record_cases", "run_cases", "score_cases"]

Progress = Callable[[float, str], None]


def make_cases(out: Path, *, cases: int, seed: int, on_progress: Progress | None = None) -> str:
    """Simulate cases with concealed effects into ``out`` and seal what they conceal."""
    from sysid.proof.generator import make_cases as make

    return make(out, cases=cases, seed=seed, on_progress=on_progress)


def record_cases(
    out: Path, stand: str, *, cases: int, seed: int, fast: bool, noise: str, on_progress: Progress | None = None
) -> str:
    """Record cases of an independent truth that conceal nothing, unsealed, into ``out``."""
    from sysid.proof.truths.make import record_cases as record

    return record(out, stand, cases=cases, seed=seed, fast=fast, noise=noise, on_progress=on_progress)


def run_cases(folder: Path, *, on_progress: Progress | None = None) -> str:
    """Diagnose every case of ``folder`` without the truth at hand; finished ones are kept."""
    from sysid.proof.run import run_cases as run

    return run(folder, on_progress=on_progress)


def score_cases(folder: Path) -> str:
    """Unseal the truth and compare it with the answers."""
    from sysid.proof.score import score_cases as score

    return score(folder)
