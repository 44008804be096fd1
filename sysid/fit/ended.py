"""What ends a part of a fit before its time, and leaves what was found before."""

from __future__ import annotations

from concurrent.futures.process import BrokenProcessPool

from sim_core.batch import worker_ended
from sim_core.errors import ThinshellError
from sysid.fit.fitted import Fitted

ENDS_EARLY = (KeyboardInterrupt, ThinshellError, BrokenProcessPool)
"""Ctrl-C, what cannot be simulated, and a worker process that has ended."""


def why(error: BaseException) -> str:
    """The error in words."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted."
    if isinstance(error, BrokenProcessPool):
        return str(worker_ended())
    return str(error) if isinstance(error, ThinshellError) else f"{type(error).__name__}: {error}"


def stop(fitted: Fitted, error: BaseException, left: str) -> None:
    """Let a fit stand at what was found, as not converged. ``left``: what was not done for the error, in words."""
    if isinstance(error, KeyboardInterrupt):
        fitted.interrupt()
        fitted.message += f"; {left}"
    else:
        fitted.converged, fitted.message = False, f"{left}. {why(error)}"
