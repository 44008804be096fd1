"""Proof on concealed physics: make sealed cases, diagnose them blind, then score the diagnoses.

Only :mod:`sysid.proof.generator` and :mod:`sysid.proof.truths` know how cases are made; they are imported by
:func:`make_cases` and :func:`record_cases` alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sysid.progress.callback import Progress

__all__ = [
    "concealable",
    "form_error_table",
    "keep_shard",
    "make_cases",
    "make_curve",
    "make_learnt",
    "make_ledgers",
    "record_cases",
    "run_cases",
    "score_cases",
]


def make_cases(
    out: Path,
    *,
    cases: int,
    seed: int,
    rigs: Sequence[str],
    fast: bool = False,
    on_progress: Progress | None = None,
) -> str:
    """Simulate cases with concealed effects on ``rigs`` into ``out`` and seal what they conceal."""
    from sysid.proof.generator import make_cases as make

    return make(out, cases=cases, seed=seed, rigs=rigs, fast=fast, on_progress=on_progress)


def record_cases(
    out: Path,
    stand: str,
    *,
    cases: int,
    seed: int,
    effects: Sequence[str] = (),
    fast: bool = False,
    noise: str = "nasty",
    on_progress: Progress | None = None,
) -> str:
    """Record cases of an independent truth, unsealed, into ``out``; each conceals ``effects``."""
    from sysid.proof.truths.make import record_cases as record

    return record(out, stand, cases=cases, seed=seed, effects=effects, fast=fast, noise=noise, on_progress=on_progress)


def concealable(stand: str) -> tuple[str, ...]:
    """What the cases of a stand may conceal, in the library of effects or outside it."""
    from sysid.proof.truths.conceal import LIBRARY, OUTSIDE

    return (*LIBRARY[stand], *OUTSIDE[stand])


def run_cases(folder: Path, *, on_progress: Progress | None = None) -> str:
    """Diagnose every case of ``folder`` without the truth at hand; finished ones are kept."""
    from sysid.proof.run import run_cases as run

    return run(folder, on_progress=on_progress)


def make_ledgers(folder: Path, *, on_progress: Progress | None = None) -> str:
    """Write the ledger of every case of ``folder`` without the truth at hand; finished ones are kept."""
    from sysid.proof.ledgers import make_ledgers as make

    return make(folder, on_progress=on_progress)


def make_curve(
    folder: Path, out: Path, *, cases: int, seed: int = 0, folds: int = 1, on_progress: Progress | None = None
) -> str:
    """Conceal effects in the ledgers of empty cases of ``folder``, judge them, and write rates by strength."""
    from sysid.proof.curve import make_curve as make

    return make(folder, out, cases=cases, seed=seed, folds=folds, on_progress=on_progress)


def make_learnt(folder: Path, *, cases: int, seed: int = 0) -> str:
    """Learn the numbers of the posterior from the ledgers of empty cases of ``folder``; the returned text has them."""
    from sysid.proof.curve import make_learnt as make

    return make(folder, cases=cases, seed=seed)


def form_error_table(folder: Path) -> str:
    """What the simulator is off in the empty cases of ``folder``, by named approximation, from their ledgers."""
    from sysid.proof.form_error import form_error_table as make

    return make(folder)


def keep_shard(folder: Path, out: Path) -> str:
    """Copy seal, truth, diagnoses and score, without recordings and reports, to be kept with the code."""
    from sysid.proof.keep import keep_shard as keep

    return keep(folder, out)


def score_cases(folder: Path) -> str:
    """Unseal the truth and compare it with the diagnoses."""
    from sysid.proof.score import score_cases as score

    return score(folder)
