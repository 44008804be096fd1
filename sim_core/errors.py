"""Errors that a user can act on. Every one names the thing, the value, the bound and the remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = [
    "ConfigError",
    "ConvergenceError",
    "RecordingError",
    "ThinshellError",
    "WorkerError",
    "nearest_match",
]


class ThinshellError(Exception):
    """Base of all errors caused by input, data or numerics rather than by a defect in the code.

    The command line prints it as one paragraph and exits with code 2; a node reports it on
    ``/diagnostics``. ``remedy`` says what the user can do about it.
    """

    def __init__(self, problem: str, remedy: str = "") -> None:
        self.problem = problem
        self.remedy = remedy
        super().__init__(f"{problem} {remedy}".strip())


class ConfigError(ThinshellError):
    """A rig, experiment or parameter specification that cannot be used."""


class RecordingError(ThinshellError):
    """A bag that cannot be read, or does not hold what is needed."""


class WorkerError(ThinshellError):
    """A process that worked for this one has ended before its work was done."""


class ConvergenceError(ThinshellError):
    """A time step or a fit that did not converge."""


def nearest_match(word: str, known: Iterable[str]) -> str:
    """Return a ``Did you mean ...?`` sentence, or the list of known words when nothing is near."""
    known = sorted(known)
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    if near:
        return f"Did you mean {near[0]!r}?"
    return "Known: " + ", ".join(known) + "."
